"""Figures of a campaign: failure rates and robustness over the features of the scenes.

Rates in bins of each feature, with intervals; robustness as in the paper's Figures 4 and 6;
causes; and the axes and colours that they share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from taxinet_ros.analysis.campaign.findings import Findings
from taxinet_ros.analysis.causes.causes import FoundRate
from taxinet_ros.analysis.causes.region import Region
from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.runs.bins import Bin, bins, medians
from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate, Weighting
from taxinet_ros.analysis.runs.features import (
    DISTANCE,
    RAIN,
    TIME_OF_DAY,
    Feature,
    Floats,
    Form,
    shown_features,
)
from taxinet_ros.core.scenario_fields import clock_words

_LINEAR = 2.0
_TICKS = (1.0, 2.0, 5.0)
_HOUR_STEPS = (0.25, 0.5, 1.0, 2.0, 3.0, 6.0)
_MOST_TICKS = 13
DOTS_AT_ONCE = 600


def network_colours(networks: int, theme: Theme) -> list[str]:
    """A colour for each network, unlike those of passed and failed runs as long as they suffice."""
    colours = (*theme.others, theme.passed, theme.failed)
    return [colours[number % len(colours)] for number in range(networks)]


def dot_style(runs: int) -> dict[str, Any]:
    """Size and opacity of dots, chosen so that few are visible and many do not hide each other."""
    crowd = min(1.0, DOTS_AT_ONCE / max(runs, 1))
    return {'s': 5 + 13 * crowd, 'alpha': 0.35 + 0.5 * crowd, 'linewidths': 0}


def _rho_axis(axes: Axes, rho: Floats, theme: Theme) -> None:
    """Set up the vertical axis for robustness: linear near zero, logarithmic far from it."""
    known = rho[np.isfinite(rho)]
    low = min(float(known.min(initial=0.0)), 0.0)
    high = max(float(known.max(initial=0.0)), 0.0)
    label = 'robustness ρ'
    if max(-low, high) > _LINEAR:
        axes.set_yscale('symlog', linthresh=_LINEAR, linscale=1.1)
        axes.yaxis.set_major_locator(FixedLocator(_rho_ticks(low, high)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(
            FuncFormatter(lambda value, _: f'{value:g}'.replace('-', '−')))
        label += f'\n(logarithmic beyond ±{_LINEAR:g})'
    pad = 0.12 * max(high - low, 0.5)
    axes.set_ylim(
        low * 1.35 if low < -_LINEAR else min(low - pad, -0.3),
        high * 1.35 if high > _LINEAR else max(high, 0.3) + min(pad, 0.5))
    axes.set_ylabel(label)
    # Runs in the shaded half fail.
    axes.axhspan(axes.get_ylim()[0], 0, color=theme.failed, alpha=0.07, linewidth=0, zorder=0)
    axes.axhline(0, color=theme.ink, linewidth=0.9, zorder=1.5)


def feature_axis(axes: Axes, feature: Feature, values: Floats) -> None:
    """Set up the horizontal axis for a feature in display units."""
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


def _rho_ticks(low: float, high: float) -> list[float]:
    """Round values: every integer near zero, a few in every decade far from it."""
    decades = [part * 10**power for power in range(4) for part in _TICKS]
    far = [value for value in decades if value > _LINEAR]
    values = [-value for value in far if -value >= low * 1.3]
    return sorted([*values, -2.0, -1.0, 0.0, 1.0, *(v for v in (2.0, *far) if v <= high * 1.3)])


_COLUMNS = 2


def rates_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """Failure rates in bins of each feature, one panel per feature."""
    pooled = campaigns[0].frame
    features = shown_features(pooled)
    rows = math.ceil(len(features) / _COLUMNS)

    def draw(figure: Figure, theme: Theme) -> None:
        panels = list(figure.subplots(rows, _COLUMNS, sharey=True).flat)
        colours = network_colours(len(campaigns), theme) if len(campaigns) > 1 else [theme.failed]
        for axes in panels[len(features):]:
            axes.remove()
        for axes, feature in zip(panels, features, strict=False):
            cut = bins(feature, pooled)
            for number, (runs, colour) in enumerate(zip(campaigns, colours, strict=True)):
                values = runs.frame[feature.name].to_numpy()
                found = [(one, runs.rate(one.holds(values))) for one in cut]
                shift = (number - (len(campaigns) - 1) / 2) * 0.8 / len(campaigns)
                _bars(axes, found, colour, shift, runs.label, theme)
            _name_bins(axes, feature, cut)
        panels[0].yaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
        panels[0].set_ylim(-0.02, 1.04)
        for axes in panels[::_COLUMNS]:
            axes.set_ylabel('runs that fail')
        if len(campaigns) > 1:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc='outside upper center', ncols=4, frameon=False)

    return Picture(
        name='rates_by_feature', title='How often runs fail, by feature', draw=draw,
        caption='Share of runs that fail in each bin, with its 95 % interval'
        f'{_meaning(campaigns)}. A bin without a mark has no such run.', size_in=(7.6, 2.5 * rows),
    )


def _bars(
    axes: Axes, found: Sequence[tuple[Bin, GroupRate]], colour: str, shift: float, label: str,
    theme: Theme,
) -> None:
    places = np.array([number for number, (_, rate) in enumerate(found) if rate.rate >= 0])
    rates = [rate for _, rate in found if rate.rate >= 0]
    if not rates:
        return
    share = np.array([rate.rate for rate in rates])
    ends = np.array([(rate.rate - rate.low, rate.high - rate.rate) for rate in rates]).T
    ends = np.clip(np.nan_to_num(ends), 0, None)
    axes.bar(places + shift, share, width=0.3, color=colour, alpha=0.28, linewidth=0)
    axes.errorbar(places + shift, share, yerr=ends, fmt='o', color=colour, markersize=4,
                  capsize=2.5, elinewidth=1.2, label=label, zorder=3)
    style_axes(axes, grid='y')


def _name_bins(axes: Axes, feature: Feature, cut: Sequence[Bin]) -> None:
    """Label the bins: words below them, numbers at their edges."""
    axes.set_xlabel(feature.axis)
    axes.set_xlim(-0.6, len(cut) - 0.4)
    places, labels = _labels(feature, cut)
    turned = len(labels) > 7 or sum(map(len, labels)) > 34
    axes.set_xticks(places, labels, fontsize=8, rotation=40 if turned else 0,
                    ha='right' if turned else 'center', rotation_mode='anchor')


def _labels(feature: Feature, cut: Sequence[Bin]) -> tuple[list[float], list[str]]:
    if not feature.numeric or len(cut) == 1:
        return [float(number) for number in range(len(cut))], [one.label for one in cut]
    places: list[float] = []
    labels: list[str] = []
    for number, one in enumerate(cut):
        if one.low == one.high:
            places, labels = [*places, float(number)], [*labels, one.label]
            continue
        if not places or places[-1] != number - 0.5:
            places, labels = [*places, number - 0.5], [*labels, _edge(feature, one.low)]
        places, labels = [*places, number + 0.5], [*labels, _edge(feature, one.high)]
    return places, labels


def _edge(feature: Feature, value: float) -> str:
    if feature.form is Form.CLOCK:
        return feature.value_words(value)
    return f'{value:,g}'.replace('-', '−')


def _meaning(campaigns: Sequence[CampaignRuns]) -> str:
    kinds = {runs.weighting for runs in campaigns}
    if Weighting.UNKNOWN in kinds:
        return '; shares of the runs made, without intervals'
    if Weighting.UNDECIDED in kinds:
        return '; shares of the decided runs, without intervals'
    return '; of the runs drawn by the program itself' if Weighting.WEIGHTED in kinds else ''


_WIDTHS = {TIME_OF_DAY: 0.5, DISTANCE: 50.0}
_BIN_WORDS = {TIME_OF_DAY: '30 minutes', DISTANCE: '50 m'}


def rho_picture(campaigns: Sequence[CampaignRuns], feature: Feature, name: str) -> Picture:
    """Runs as dots over a feature, with medians; for several networks, before and after.

    Args:
        campaigns: the analysed campaign, then its baselines.
        feature: a numeric feature.
        name: name of the file.
    """
    caption = f'A dot for each run; lines are medians of {_BIN_WORDS[feature]}. '
    caption += 'Runs in the shaded half violate the formula.'
    raining = any(_rain(runs).any() and not _rain(runs).all() for runs in campaigns)
    if len(campaigns) == 1 and raining:
        caption += ' The dashed line is the median of the runs without rain.'
    if any(runs.stopped for runs in campaigns):
        caption += ' For a run stopped early, ρ is the bound known at that time.'

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        if len(campaigns) == 1:
            _one(axes, campaigns[0], feature, theme)
        else:
            _several(axes, campaigns, feature, theme)
        rho = [runs.frame['rho'].to_numpy(dtype=np.float64) for runs in campaigns]
        _rho_axis(axes, np.concatenate(rho), theme)
        values = np.concatenate([runs.frame[feature.name].to_numpy() for runs in campaigns])
        feature_axis(axes, feature, values)
        style_axes(axes)

    return Picture(
        name=name, title=f'Robustness over {feature.title}', caption=caption, draw=draw,
    )


def _one(axes: Axes, runs: CampaignRuns, feature: Feature, theme: Theme) -> None:
    x, rho = _values(runs, feature)
    failed, rain = runs.failed, _rain(runs)
    style = dot_style(len(x))
    for among, colour in ((~failed, theme.passed), (failed, theme.failed)):
        axes.scatter(x[among], rho[among], color=colour, **style)
    handles = [
        Line2D([], [], marker='o', linestyle='', markersize=5, color=theme.passed,
               label=f'satisfied ({int((~failed).sum()):,})'),
        Line2D([], [], marker='o', linestyle='', markersize=5, color=theme.failed,
               label=f'violated ({int(failed.sum()):,})'),
    ]
    handles += _median_line(axes, x, rho, feature, theme.ink, 'median', theme)
    if rain.any() and not rain.all():
        handles += _median_line(axes, x[~rain], rho[~rain], feature, theme.ink,
                                'median without rain', theme, dashed=True)
    _legend(axes, handles)


def _several(
    axes: Axes, campaigns: Sequence[CampaignRuns], feature: Feature, theme: Theme
) -> None:
    handles: list[Line2D] = []
    colours = network_colours(len(campaigns), theme)
    for runs, colour in reversed(list(zip(campaigns, colours, strict=True))):
        x, rho = _values(runs, feature)
        style = dot_style(len(x))
        axes.scatter(x, rho, color=colour, **{**style, 'alpha': 0.6 * style['alpha']})
        label = f'{runs.label} ({len(x):,} runs)'
        line = _median_line(axes, x, rho, feature, colour, label, theme)
        handles += line or [Line2D([], [], marker='o', linestyle='', color=colour, label=label)]
    _legend(axes, handles[::-1])


def _median_line(
    axes: Axes, x: Floats, rho: Floats, feature: Feature, colour: str, label: str, theme: Theme,
    *, dashed: bool = False,
) -> list[Line2D]:
    middles, values, _ = medians(x, rho, _WIDTHS[feature])
    if np.isfinite(values).sum() < 1 or len(x) < 4:
        return []
    style = (0, (3, 1.4)) if dashed else 'solid'
    # An outline in the background colour separates the line from the dots below it.
    axes.plot(middles, values, color=theme.paper, linewidth=4.2, alpha=0.8, zorder=3,
              solid_capstyle='round')
    return axes.plot(middles, values, color=colour, linewidth=2.0, linestyle=style, label=label,
                     marker='o' if len(values) < 2 else '', markersize=4, zorder=4)


def _values(runs: CampaignRuns, feature: Feature) -> tuple[Floats, Floats]:
    return (runs.frame[feature.name].to_numpy(dtype=np.float64),
            runs.frame['rho'].to_numpy(dtype=np.float64))


def _rain(runs: CampaignRuns) -> np.ndarray:
    return runs.frame[RAIN.name].to_numpy() > 0


def _legend(axes: Axes, handles: list[Line2D]) -> None:
    axes.legend(handles=handles, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=4,
                frameon=False, fontsize=9, columnspacing=1.4, handlelength=1.8)


_LONGEST = 44
"""Characters of a region on one line."""


def causes_picture(findings: Findings) -> Picture:
    """The failure rate in each cause and outside, for each network."""
    causes, several = findings.causes.found, len(findings.campaigns) > 1
    rows = [f'{cause.rank}  {_wrapped(cause.region)}' for cause in causes]
    rows.append('outside all of them')
    rates: list[list[GroupRate | FoundRate]] = [
        [*(cause.whole if several else cause.inside for cause in causes), findings.causes.rest]]
    rates += [[*one.in_causes, one.off_causes] for one in findings.comparisons]

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        colours = network_colours(len(rates), theme) if several else [theme.failed]
        for number, (found, colour) in enumerate(zip(rates, colours, strict=True)):
            shift = (number - (len(rates) - 1) / 2) * 0.5 / len(rates)
            _forest(axes, found, colour, shift, findings.campaigns[number].label)
        axes.set_yticks(range(len(rows)), rows, fontsize=9)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlim(-0.02, 1.02)
        axes.xaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
        axes.set_xlabel('runs that fail')
        style_axes(axes, grid='x')
        if several:
            axes.legend(loc='lower center', bbox_to_anchor=(0.4, 1.0), ncols=3, frameon=False,
                        fontsize=9)

    which = 'all runs in it' if several else 'its runs not in causes above it'
    lines = sum(1 + row.count('\n') for row in rows)
    return Picture(
        name='causes', title='Where runs fail', draw=draw,
        caption=f'How often runs fail in each cause: of {which}. For the campaign in which the '
        'causes were found, the 95 % intervals account for their selection.',
        size_in=(7.6, 1.1 + 0.17 * lines + 0.22 * len(rows)),
    )


def _forest(
    axes: Axes, rates: list[GroupRate | FoundRate], colour: str, shift: float, label: str
) -> None:
    shown = [(place, rate) for place, rate in enumerate(rates) if rate.runs]
    if not shown:
        return
    share = np.array([rate.rate for _, rate in shown])
    ends = np.array([(rate.rate - rate.low, rate.high - rate.rate) for _, rate in shown]).T
    places = np.array([place for place, _ in shown]) + shift
    axes.errorbar(share, places, xerr=np.clip(np.nan_to_num(ends), 0, None), fmt='o', color=colour,
                  markersize=5.5, capsize=3, elinewidth=1.4, label=label, zorder=3)


def _wrapped(region: Region) -> str:
    """Display text of a region, broken into two lines if long."""
    first, *others = [part.words() for part in region.parts]
    whole = ', '.join([first, *others])
    return whole if len(whole) <= _LONGEST else f'{first},\n{", ".join(others)}'.rstrip(',\n')
