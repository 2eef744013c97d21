"""What the figures of a campaign share: axes for robustness, hours and features, and colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.group_rates import Floats
from taxinet_ros.analysis.report_parts import Theme
from taxinet_ros.analysis.run_features import Feature, Form, clock_words

_LINEAR = 2.0
_TICKS = (1.0, 2.0, 5.0)
_HOUR_STEPS = (0.25, 0.5, 1.0, 2.0, 3.0, 6.0)
_MOST_TICKS = 13
DOTS_AT_ONCE = 600


def network_colours(networks: int, theme: Theme) -> list[str]:
    """A colour for each network, different from those of passed and failed runs while they last."""
    colours = (*theme.others, theme.passed, theme.failed)
    return [colours[number % len(colours)] for number in range(networks)]


def dot_style(runs: int) -> dict[str, Any]:
    """Size and opacity of dots, so that few can be seen and many do not hide each other."""
    crowd = min(1.0, DOTS_AT_ONCE / max(runs, 1))
    return {'s': 5 + 13 * crowd, 'alpha': 0.35 + 0.5 * crowd, 'linewidths': 0}


def rho_axis(axis_of: Axes, rho: Floats, theme: Theme, *, vertical: bool = True) -> None:
    """Make an axis that shows robustness: linear near zero, logarithmic far from it.

    Args:
        axis_of: the plot.
        rho: all values that it shows.
        theme: its colours.
        vertical: whether it is the vertical axis.
    """
    known = rho[np.isfinite(rho)]
    low = min(float(known.min(initial=0.0)), 0.0)
    high = max(float(known.max(initial=0.0)), 0.0)
    axis = axis_of.yaxis if vertical else axis_of.xaxis
    far = max(-low, high) > _LINEAR
    label = 'robustness ρ'
    if far:
        scale = axis_of.set_yscale if vertical else axis_of.set_xscale
        scale('symlog', linthresh=_LINEAR, linscale=1.1)
        axis.set_major_locator(FixedLocator(_rho_ticks(low, high)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'.replace('-', '−')))
        label += f'\n(logarithmic beyond ±{_LINEAR:g})' if vertical else (
            f' (logarithmic beyond ±{_LINEAR:g})')
    limits = axis_of.set_ylim if vertical else axis_of.set_xlim
    pad = 0.12 * max(high - low, 0.5)
    limits(low * 1.35 if low < -_LINEAR else min(low - pad, -0.3),
           high * 1.35 if high > _LINEAR else max(high, 0.3) + min(pad, 0.5))
    axis.set_label_text(label)
    _shade_failures(axis_of, theme, vertical=vertical)


def feature_axis(axes: Axes, feature: Feature, values: Floats) -> None:
    """Make the horizontal axis show a feature in people's units."""
    axes.set_xlabel(feature.axis)
    low, high = float(values.min()), float(values.max())
    pad = 0.02 * (high - low) or 0.5
    axes.set_xlim(low - pad, high + pad)
    if feature.form is Form.CLOCK:
        hour_ticks(axes, low - pad, high + pad)
    else:
        axes.xaxis.set_major_formatter(
            FuncFormatter(lambda value, _: f'{value:,g}'.replace('-', '−')))


def hour_ticks(axes: Axes, low: float, high: float) -> None:
    """Ticks on the horizontal axis at round times of day."""
    step = next((step for step in _HOUR_STEPS if (high - low) / step < _MOST_TICKS), 6.0)
    ticks = [number * step for number in range(math.ceil(low / step), math.floor(high / step) + 1)]
    axes.set_xticks(ticks, [clock_words(tick) for tick in ticks])


def plain(axes: Axes, *, grid: str = 'both') -> None:
    """A grid behind the drawing, and no frame where no scale is."""
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)
    if grid != 'none':
        axes.grid(visible=True, axis='x' if grid == 'x' else 'y' if grid == 'y' else 'both',
                  linewidth=0.6)
    axes.set_axisbelow(True)


def all_rho(campaigns: Sequence[CampaignRuns]) -> Floats:
    """Robustness of all runs of all campaigns."""
    return np.concatenate([runs.frame['rho'].to_numpy(dtype=np.float64) for runs in campaigns])


def _rho_ticks(low: float, high: float) -> list[float]:
    """Round values: every whole one near zero, a few in every decade far from it."""
    decades = [part * 10**power for power in range(4) for part in _TICKS]
    far = [value for value in decades if value > _LINEAR]
    values = [-value for value in far if -value >= low * 1.3]
    return sorted([*values, -2.0, -1.0, 0.0, 1.0, *(v for v in (2.0, *far) if v <= high * 1.3)])


def _shade_failures(axes: Axes, theme: Theme, *, vertical: bool) -> None:
    low = (axes.get_ylim() if vertical else axes.get_xlim())[0]
    span, line = (axes.axhspan, axes.axhline) if vertical else (axes.axvspan, axes.axvline)
    span(low, 0, color=theme.failed, alpha=0.07, linewidth=0, zorder=0)
    line(0, color=theme.ink, linewidth=0.9, zorder=1.5)
