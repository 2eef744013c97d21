"""Figures of a campaign: failure rates and robustness over the features of the scenes.

Rates in bins of each feature, with intervals, and over two features at once; robustness as in the
paper's Figures 4 to 7; and the axes and colours that they share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.runs.bins import Bin, bins, medians
from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate, Weighting
from taxinet_ros.analysis.runs.features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    PAPER_FEATURES,
    RAIN,
    TIME_OF_DAY,
    Feature,
    Floats,
    Form,
    kinds_present,
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


def rho_axis(axis_of: Axes, rho: Floats, theme: Theme, *, vertical: bool = True) -> None:
    """Set up an axis for robustness: linear near zero, logarithmic far from it.

    Args:
        axis_of: the plot.
        rho: all values shown.
        theme: colours.
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


def all_rho(campaigns: Sequence[CampaignRuns]) -> Floats:
    """Robustness of all runs of all campaigns."""
    return np.concatenate([runs.frame['rho'].to_numpy(dtype=np.float64) for runs in campaigns])


def _rho_ticks(low: float, high: float) -> list[float]:
    """Round values: every integer near zero, a few in every decade far from it."""
    decades = [part * 10**power for power in range(4) for part in _TICKS]
    far = [value for value in decades if value > _LINEAR]
    values = [-value for value in far if -value >= low * 1.3]
    return sorted([*values, -2.0, -1.0, 0.0, 1.0, *(v for v in (2.0, *far) if v <= high * 1.3)])


def _shade_failures(axes: Axes, theme: Theme, *, vertical: bool) -> None:
    low = (axes.get_ylim() if vertical else axes.get_xlim())[0]
    span, line = (axes.axhspan, axes.axhline) if vertical else (axes.axvspan, axes.axvline)
    span(low, 0, color=theme.failed, alpha=0.07, linewidth=0, zorder=0)
    line(0, color=theme.ink, linewidth=0.9, zorder=1.5)


_COLUMNS = 2
_DARK_TEXT, _LIGHT_TEXT = '#111111', '#ffffff'
_RUNS_PER_CELL = 12


def rates_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """Failure rates in bins of each feature, one panel per feature."""
    rows = math.ceil(len(PAPER_FEATURES) / _COLUMNS)
    pooled = campaigns[0].frame

    def draw(figure: Figure, theme: Theme) -> None:
        panels = list(figure.subplots(rows, _COLUMNS, sharey=True).flat)
        colours = network_colours(len(campaigns), theme) if len(campaigns) > 1 else [theme.failed]
        for axes, feature in zip(panels, PAPER_FEATURES, strict=True):
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


def map_picture(runs: CampaignRuns, across: Feature, up: Feature, name: str) -> Picture:
    """Failure rate over two features, as a map with the rate in each cell."""
    cells = max(1, len(runs.frame) // _RUNS_PER_CELL)
    rows = bins(up, runs.frame, min(10, max(1, round(math.sqrt(cells / 2)))))
    columns = bins(across, runs.frame, min(12, max(2, cells // len(rows))))

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        ground, full = np.array(to_rgb(theme.paper)), np.array(to_rgb(theme.failed))
        colours = LinearSegmentedColormap.from_list('rate', [0.94 * ground + 0.06 * full, full])
        for y, row in enumerate(rows):
            for x, column in enumerate(columns):
                _cell(axes, x, y, runs.rate(row.mask & column.mask), colours, theme)
        axes.set_xlim(-0.5, len(columns) - 0.5)
        axes.set_ylim(-0.5, len(rows) - 0.5)
        _name_bins(axes, across, columns)
        _name_rows(axes, up, rows)
        axes.tick_params(length=0)
        for spine in axes.spines.values():
            spine.set_visible(False)

    return Picture(
        name=name, title=f'How often runs fail, by {across.title} and {up.title}', draw=draw,
        caption='The share of runs that fail [%] in each cell, below it the number of runs; a cell '
        f'without numbers has no such run{_meaning([runs])}.',
        size_in=(7.6, 1.1 + 0.46 * len(rows)),
    )


def distribution_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """Cumulative distribution of robustness."""

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        colours = network_colours(len(campaigns), theme) if len(campaigns) > 1 else [theme.ink]
        for runs, colour in zip(campaigns, colours, strict=True):
            rho, weight = runs.frame['rho'].to_numpy(), runs.weight
            order = np.argsort(rho, kind='stable')
            shares = np.nan_to_num(weight, nan=1.0)[order].cumsum()
            shares /= shares[-1]
            axes.step(rho[order], shares, where='post', color=colour, linewidth=1.8,
                      label=f'{runs.label}: {100 * runs.rate().rate:.1f} % fail', zorder=3)
            axes.plot([0], [runs.rate().rate], marker='o', color=colour, markersize=5, zorder=4)
        rho_axis(axes, all_rho(campaigns), theme, vertical=False)
        axes.set_ylim(0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
        axes.set_ylabel('runs with at most this ρ')
        style_axes(axes)
        axes.legend(frameon=False, fontsize=9, loc='lower right')

    return Picture(
        name='rho_distribution', title='How robust the runs are', draw=draw,
        caption='The share of runs whose robustness is at most that on the axis; at 0 it is the '
        f'share that fails{_meaning(campaigns)}.',
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


def _name_rows(axes: Axes, feature: Feature, cut: Sequence[Bin]) -> None:
    places, labels = _labels(feature, cut)
    axes.set_yticks(places, labels, fontsize=8)
    axes.set_ylabel(feature.axis)


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


def _cell(
    axes: Axes, x: int, y: int, rate: GroupRate, colours: LinearSegmentedColormap, theme: Theme
) -> None:
    if math.isnan(rate.rate):
        return
    colour = colours(rate.rate)
    axes.add_patch(Rectangle((x - 0.48, y - 0.46), 0.96, 0.92, color=colour, linewidth=0))
    light = float(np.dot(np.array(colour[:3]) ** 2.2, (0.2126, 0.7152, 0.0722)))
    text = _DARK_TEXT if light > 0.18 else _LIGHT_TEXT
    axes.text(x, y + 0.13, f'{100 * rate.rate:.0f}', ha='center', va='center', fontsize=9,
              color=text)
    number = rate.runs if math.isnan(rate.effective) else int(rate.effective)
    axes.text(x, y - 0.27, f'{number}', ha='center', va='center', fontsize=6, color=text,
              alpha=0.85)


def _meaning(campaigns: Sequence[CampaignRuns]) -> str:
    kinds = {runs.weighting for runs in campaigns}
    if Weighting.UNKNOWN in kinds:
        return '; shares of the runs made, without intervals'
    if Weighting.UNDECIDED in kinds:
        return '; shares of the decided runs, without intervals'
    return '; of the runs drawn by the program itself' if Weighting.WEIGHTED in kinds else ''


_WIDTHS = {TIME_OF_DAY: 0.5, DISTANCE: 50.0, HEADING: 5.0, CROSS_TRACK: 1.0}
_BIN_WORDS = {TIME_OF_DAY: '30 minutes', DISTANCE: '50 m', HEADING: '5°', CROSS_TRACK: '1 m'}
_MARKS = ('o', 's', '^', 'v', 'D', 'P')


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
        rho_axis(axes, all_rho(campaigns), theme)
        values = np.concatenate([runs.frame[feature.name].to_numpy() for runs in campaigns])
        feature_axis(axes, feature, values)
        style_axes(axes)

    return Picture(
        name=name, title=f'Robustness over {feature.title}', caption=caption, draw=draw,
    )


def clouds_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """Medians over the time of day, for each kind of clouds; one panel per network."""
    dry = any(not _rain(runs).all() for runs in campaigns)

    def draw(figure: Figure, theme: Theme) -> None:
        panels = figure.subplots(len(campaigns), 1, sharex=True, squeeze=False)[:, 0]
        for axes, runs in zip(panels, campaigns, strict=True):
            _clouds(axes, runs, theme, dry=dry)
            rho_axis(axes, all_rho(campaigns), theme)
            style_axes(axes)
            if len(campaigns) > 1:
                axes.set_title(runs.label, fontsize=10, loc='left')
        hours = np.concatenate([runs.frame[TIME_OF_DAY.name].to_numpy() for runs in campaigns])
        feature_axis(panels[-1], TIME_OF_DAY, hours)
        handles = {label: line for axes in panels
                   for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        kinds = [kind for kind in CLOUDS_KIND.kinds if kind in handles]
        figure.legend([handles[kind] for kind in kinds], kinds, loc='outside upper center',
                      ncols=6, frameon=False, fontsize=9, columnspacing=1.2, handlelength=1.6)

    among = 'without rain ' if dry else ''
    return Picture(
        name='rho_by_hour_and_clouds', title='Median robustness by kind of clouds',
        caption=f'Medians of the runs {among}in 30 minutes each. A line that drops alone shows an '
        'hour that is difficult only under that sky.',
        draw=draw, size_in=(7.0, 0.8 + 2.9 * len(campaigns)),
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


def _clouds(axes: Axes, runs: CampaignRuns, theme: Theme, *, dry: bool) -> None:
    colours = (theme.passed, *theme.others, theme.failed)
    frame = runs.frame[~_rain(runs)] if dry else runs.frame
    for kind in kinds_present(CLOUDS_KIND, frame):
        number = CLOUDS_KIND.kinds.index(kind) if kind in CLOUDS_KIND.kinds else 0
        some = frame[frame[CLOUDS_KIND.name] == kind]
        middles, values, _ = medians(
            some[TIME_OF_DAY.name].to_numpy(), some['rho'].to_numpy(), _WIDTHS[TIME_OF_DAY])
        axes.plot(middles, values, color=colours[number], marker=_MARKS[number], markersize=4,
                  linewidth=1.6, label=kind, zorder=3)


def _values(runs: CampaignRuns, feature: Feature) -> tuple[Floats, Floats]:
    return (runs.frame[feature.name].to_numpy(dtype=np.float64),
            runs.frame['rho'].to_numpy(dtype=np.float64))


def _rain(runs: CampaignRuns) -> np.ndarray:
    return runs.frame[RAIN.name].to_numpy() > 0


def _legend(axes: Axes, handles: list[Line2D]) -> None:
    axes.legend(handles=handles, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=4,
                frameon=False, fontsize=9, columnspacing=1.4, handlelength=1.8)
