"""Picture of the bounds on final robustness during runs: a band that narrows to what comes out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.extras.forecast.forecast import Bound

_HIGH, _LOW = 3.0, -200.0
_LINEAR = 2.0
_TICKS = (-100, -10, -2, -1, 0, 1, 2)


@dataclass(frozen=True, kw_only=True)
class ShownRun:
    """One run.

    Attributes:
        title: above its panel.
        of_run, of_step: bounds at each control step, by both guarantees.
        final: final robustness; None if the run has not ended.
    """

    title: str
    of_run: Sequence[Bound]
    of_step: Sequence[Bound]
    final: float | None


def forecast_picture(
    runs: Sequence[ShownRun], *, confidence: float, spec: str, name: str = 'forecast'
) -> Picture:
    """The band of each run over time, one panel for each.

    Args:
        runs: the runs.
        confidence: of the bounds.
        spec: name of the requirement.
        name: file name of the picture, without its ending.
    """
    percent = f'{100 * confidence:g} %'

    def draw(figure: Figure, theme: Theme) -> None:
        panels = np.asarray(figure.subplots(len(runs), 1, sharex=True, squeeze=False))[:, 0]
        for axes, run in zip(panels, runs, strict=True):
            _draw(axes, theme, run, percent)
            axes.set_ylabel(f'robustness of\n{spec}')
        panels[-1].set_xlabel('time [s]')
        panels[0].legend(loc='upper right', fontsize=8)

    return Picture(
        name=name, title=f'Final robustness, forecast during the run ({percent})', draw=draw,
        size_in=(8.5, 0.6 + 3.0 * len(runs)),
        caption='The band reaches from the conformal lower bound, which holds at all moments of '
                f"the run with a probability of {percent}, to the upper end of the monitor's "
                'interval, which is certain.',
    )


def _draw(axes: Axes, theme: Theme, run: ShownRun, percent: str) -> None:
    t_s = [bound.t_s for bound in run.of_run]
    low, high = (
        np.clip([getattr(bound, name) for bound in run.of_run], 10 * _LOW, 10 * _HIGH)
        for name in ('lower', 'certain_upper')
    )
    of_step = np.clip([bound.lower for bound in run.of_step], 10 * _LOW, 10 * _HIGH)
    ends = run.final is not None
    failed = ends and run.final is not None and run.final <= 0
    colour = theme.failed if failed else theme.passed if ends else theme.others[0]
    axes.fill_between(t_s, low, high, color=colour, alpha=0.25, linewidth=0, step='post')
    axes.step(t_s, low, where='post', color=colour, linewidth=1.8,
              label=f'lower bound, {percent} for the whole run')
    axes.step(t_s, of_step, where='post', color=colour, linewidth=0.9, linestyle='--',
              label=f'lower bound, {percent} for one moment')
    axes.step(t_s, high, where='post', color=theme.ink, linewidth=0.9, alpha=0.6,
              label='monitor: cannot end above')
    if run.final is not None and math.isfinite(run.final):
        axes.axhline(run.final, color=theme.ink, linestyle=':', linewidth=1.3,
                     label='what came out')
    axes.axhline(0.0, color=theme.ink, linewidth=0.8)
    # Failures may be a hundred times deeper than passes are high.
    axes.set_yscale('symlog', linthresh=_LINEAR)
    axes.set_yticks(_TICKS, [f'{tick:g}' for tick in _TICKS])
    axes.set_yticks([], minor=True)
    axes.set_ylim(_LOW, _HIGH)
    axes.margins(x=0.01)
    axes.set_title(run.title, fontsize=10)
