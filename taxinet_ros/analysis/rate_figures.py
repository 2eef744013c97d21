"""Failure rates in bins of each feature, with intervals, and over two features at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import PercentFormatter

from taxinet_ros.analysis.campaign_runs import CampaignRuns, Weighting
from taxinet_ros.analysis.figure_parts import all_rho, network_colours, plain, rho_axis
from taxinet_ros.analysis.group_rates import GroupRate
from taxinet_ros.analysis.rate_bins import Bin, bins
from taxinet_ros.analysis.report_parts import Picture, Theme
from taxinet_ros.analysis.run_features import PLAIN, Feature, Form

_COLUMNS = 2
_DARK_TEXT, _LIGHT_TEXT = '#111111', '#ffffff'
_RUNS_PER_CELL = 12


def rates_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """The failure rate in bins of each feature, a panel for each."""
    rows = math.ceil(len(PLAIN) / _COLUMNS)
    pooled = campaigns[0].frame

    def draw(figure: Figure, theme: Theme) -> None:
        panels = list(figure.subplots(rows, _COLUMNS, sharey=True).flat)
        colours = network_colours(len(campaigns), theme) if len(campaigns) > 1 else [theme.failed]
        for axes, feature in zip(panels, PLAIN, strict=True):
            cut = bins(feature, pooled)
            for number, (runs, colour) in enumerate(zip(campaigns, colours, strict=True)):
                found = [(one, _rate_in(runs, feature, one)) for one in cut]
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
        f'{_meaning(campaigns)}. A bin without a mark has no run.', size_in=(7.6, 2.5 * rows),
    )


def map_picture(runs: CampaignRuns, across: Feature, up: Feature, name: str) -> Picture:
    """The failure rate over two features, as a map with the rate in each cell."""
    cells = max(1, len(runs.frame) // _RUNS_PER_CELL)
    rows = bins(up, runs.frame, min(10, max(1, round(math.sqrt(cells / 2)))))
    columns = bins(across, runs.frame, min(12, max(1, cells // len(rows))))

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
        f'without numbers has no run{_meaning([runs])}.', size_in=(7.6, 1.1 + 0.46 * len(rows)),
    )


def distribution_picture(campaigns: Sequence[CampaignRuns]) -> Picture:
    """The share of runs with at most so much robustness."""

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
        plain(axes)
        axes.legend(frameon=False, fontsize=9, loc='lower right')

    return Picture(
        name='rho_distribution', title='How robust the runs are', draw=draw,
        caption='The share of runs whose robustness is at most that on the axis; at 0 it is the '
        f'share that fails{_meaning(campaigns)}.',
    )


def _rate_in(runs: CampaignRuns, feature: Feature, one: Bin) -> GroupRate:
    """The rate of a campaign in a bin that was cut for another, maybe."""
    if len(one.mask) == len(runs.frame) and bool((one.mask == _within(runs, feature, one)).all()):
        return runs.rate(one.mask)
    return runs.rate(_within(runs, feature, one))


def _within(runs: CampaignRuns, feature: Feature, one: Bin) -> np.ndarray:
    values = runs.frame[feature.name].to_numpy()
    if not feature.numeric:
        return np.asarray(values == one.label)
    closed = one.low == one.high or bool(values.max() <= one.high)
    return (values >= one.low) & ((values <= one.high) if closed else (values < one.high))


def _bars(
    axes: Axes, found: Sequence[tuple[Bin, GroupRate]], colour: str, shift: float, label: str,
    theme: Theme,
) -> None:
    places = np.array([number for number, (_, rate) in enumerate(found) if rate.runs])
    rates = [rate for _, rate in found if rate.runs]
    if not rates:
        return
    share = np.array([rate.rate for rate in rates])
    ends = np.array([(rate.rate - rate.low, rate.high - rate.rate) for rate in rates]).T
    ends = np.clip(np.nan_to_num(ends), 0, None)
    axes.bar(places + shift, share, width=0.3, color=colour, alpha=0.28, linewidth=0)
    axes.errorbar(places + shift, share, yerr=ends, fmt='o', color=colour, markersize=4,
                  capsize=2.5, elinewidth=1.2, label=label, zorder=3)
    plain(axes, grid='y')


def _name_bins(axes: Axes, feature: Feature, cut: Sequence[Bin]) -> None:
    """Words below their bins; of numbers the values between them."""
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
    if not rate.runs:
        return
    colour = colours(rate.rate)
    axes.add_patch(Rectangle((x - 0.48, y - 0.46), 0.96, 0.92, color=colour, linewidth=0))
    light = float(np.dot(np.array(colour[:3]) ** 2.2, (0.2126, 0.7152, 0.0722)))
    text = _DARK_TEXT if light > 0.18 else _LIGHT_TEXT
    axes.text(x, y + 0.13, f'{100 * rate.rate:.0f}', ha='center', va='center', fontsize=9,
              color=text)
    axes.text(x, y - 0.27, f'{rate.runs}', ha='center', va='center', fontsize=6, color=text,
              alpha=0.85)


def _meaning(campaigns: Sequence[CampaignRuns]) -> str:
    kinds = {runs.weighting for runs in campaigns}
    if Weighting.UNKNOWN in kinds:
        return '; of the runs as the sampler chose them, so no rates, and without intervals'
    return '; of the runs that the program itself drew' if Weighting.WEIGHTED in kinds else ''
