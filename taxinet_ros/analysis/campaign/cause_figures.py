"""Pictures of causes, features and clusters of failures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from taxinet_ros.analysis.campaign.figures import feature_axis, network_colours
from taxinet_ros.analysis.campaign.findings import Findings
from taxinet_ros.analysis.causes.causes import FoundRate
from taxinet_ros.analysis.causes.clusters import Clusters
from taxinet_ros.analysis.causes.predictors import RankedFeature
from taxinet_ros.analysis.causes.region import Region
from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.runs.campaign import GroupRate
from taxinet_ros.analysis.runs.features import DISTANCE, TIME_OF_DAY

_MARKS = ('o', 's', '^', 'v', 'D', 'P', 'X', '*')
_LONGEST = 44
_MOST_COLUMNS = 4


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


def ranking_picture(ranking: tuple[RankedFeature, ...]) -> Picture:
    """Information of each feature about failing, as bars."""

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        shares = [one.explained for one in ranking]
        colours = [theme.failed if one.p <= 0.05 else theme.faint for one in ranking]
        axes.barh(range(len(ranking)), shares, color=colours, height=0.62)
        for place, one in enumerate(ranking):
            sure = 'p < 0.01' if one.p < 0.01 else f'p = {one.p:.2f}'
            text = f'{100 * one.explained:.1f} %, {sure}'
            axes.annotate(text, (one.explained, place), xytext=(5, 0), va='center', fontsize=8,
                          textcoords='offset points')
        axes.set_yticks(range(len(ranking)), [one.feature.title for one in ranking], fontsize=9)
        axes.set_ylim(len(ranking) - 0.4, -0.6)
        axes.set_xlim(0, max([*shares, 0.02]) * 1.25)
        axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=' %'))
        axes.set_xlabel('explained share of the entropy of failing')
        style_axes(axes, grid='x')

    return Picture(
        name='feature_ranking', title='Information of each feature about failure', draw=draw,
        caption='Mutual information of a feature and of failing, as a share of the entropy of '
        'failing, minus its value by chance. Grey bars may be chance (p > 0.05 after Holm).',
        size_in=(7.0, 0.9 + 0.3 * max(len(ranking), 1)),
    )


def clusters_picture(findings: Findings) -> Picture:
    """The failures over time of day and distance, by cluster; at least one cluster is needed."""
    clusters = findings.clusters
    columns = min(len(clusters.found), _MOST_COLUMNS)
    rows = math.ceil(len(clusters.found) / columns)

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        _scatter(axes, findings, clusters, theme)
        frame = findings.runs.frame
        feature_axis(axes, TIME_OF_DAY, frame[TIME_OF_DAY.name].to_numpy(dtype=np.float64))
        axes.set_ylabel(DISTANCE.axis)
        style_axes(axes)
        axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=columns,
                    frameon=False, fontsize=9, markerscale=2.2)

    return Picture(
        name='clusters', title='Groups of failures', draw=draw,
        size_in=(7.0, 3.8 + 0.22 * rows),
        caption='Each failure that was compared, by its group; the large outlined mark is its most '
        'typical run.',
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


def _scatter(axes: Axes, findings: Findings, clusters: Clusters, theme: Theme) -> None:
    frame = findings.runs.frame
    size = 6 + 16 * min(1.0, 300 / max(clusters.compared, 1))
    colours = (theme.passed, theme.failed, *theme.others)
    for one in clusters.found:
        style: dict[str, Any] = {'color': colours[(one.number - 1) % len(colours)],
                                 'marker': _MARKS[(one.number - 1) % len(_MARKS)]}
        runs = frame[frame['run_id'].isin(one.runs)]
        typical = frame[frame['run_id'] == one.typical]
        axes.scatter(runs[TIME_OF_DAY.name], runs[DISTANCE.name], s=size, alpha=0.6, linewidths=0,
                     label=f'group {one.number} ({one.failures:,})', **style)
        axes.scatter(typical[TIME_OF_DAY.name], typical[DISTANCE.name], s=110,
                     edgecolors=theme.ink, linewidths=1.6, zorder=4, **style)


def _wrapped(region: Region) -> str:
    """Display text of a region, broken into two lines if long."""
    first, *others = [part.words() for part in region.parts]
    whole = ', '.join([first, *others])
    return whole if len(whole) <= _LONGEST else f'{first},\n{", ".join(others)}'.rstrip(',\n')
