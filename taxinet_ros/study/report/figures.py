"""Pictures of a study: its networks and the paper's, over the day and along the runway."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from taxinet_ros.analysis.campaign.figures import hour_ticks, network_colours, rho_picture
from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.analysis.runs.features import DISTANCE, TIME_OF_DAY
from taxinet_ros.study.report.results import Results
from taxinet_ros.study.stages.plan import BEST, GENERIC, HALTON, ORIGINAL, SPECIALISED

_SHOWN = (ORIGINAL, HALTON, SPECIALISED, GENERIC, BEST)
"""Networks in the order of all pictures, so that each keeps its colour."""

_DAY, _RUNWAY = (ORIGINAL, HALTON), (ORIGINAL, HALTON, SPECIALISED)
"""The networks in the paper's Figures 4 and 6."""

_NO_PAPER = float('nan')


def rates_picture(networks: pd.DataFrame) -> Picture:
    """Both rates of every network with intervals, and those of the paper.

    Args:
        networks: table of :func:`.tables.networks_frame`.
    """

    def draw(figure: Figure, theme: Theme) -> None:
        panels = figure.subplots(1, 2, sharey=True, gridspec_kw={'wspace': 0.1})
        for axes, name, title in zip(
            panels, ('satisfied', 'off_runway'), ('satisfy the formula', 'leave the runway'),
            strict=True,
        ):
            _rates(axes, networks, name, theme)
            axes.set_xlabel(f'runs that {title}')
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside upper center', ncols=2, frameon=False)

    return Picture(
        name='networks', title="The networks, beside the paper's", draw=draw,
        caption="Dots with 95 % Clopper-Pearson intervals are ours, diamonds the paper's. Its "
        'world is another, so they need not fall together.',
        size_in=(7.6, 1.4 + 0.42 * len(networks)),
    )


def day_pictures(results: Results, hours: pd.DataFrame) -> tuple[Picture, ...]:
    """Robustness over the day as in the paper's Fig. 4, and failure rates by hour."""
    campaigns = _campaigns(results, _DAY)
    first = [rho_picture(campaigns, TIME_OF_DAY, 'rho_by_hour')] if campaigns else []
    return (*first, _share_picture(
        hours, ('from_h', 'to_h'), 'failing_by_hour', 'How often runs fail, over the day',
        'time of day', lambda axes: hour_ticks(axes, 6, 18),
    ))


def runway_pictures(results: Results, distances: pd.DataFrame) -> tuple[Picture, ...]:
    """Robustness along the runway as in Fig. 6, and failure rates by 100 m."""
    campaigns = _campaigns(results, _RUNWAY)
    first = [rho_picture(campaigns, DISTANCE, 'rho_by_distance')] if campaigns else []
    return (*first, _share_picture(
        distances, ('from_m', 'to_m'), 'failing_by_distance',
        'How often runs fail, along the runway', 'start distance along the runway [m]',
        lambda axes: None,
    ))


def learned_picture(learned: pd.DataFrame) -> Picture:
    """Distribution of failures along the runway: learned, in random runs, and in the paper.

    Args:
        learned: table of :func:`.tables.learned_frame`.
    """

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        places = np.arange(len(learned))
        kinds = [('program', theme.faint, 'the program', ('', ''))]
        samplers = [
            name.removesuffix('_least') for name in map(str, learned) if name.endswith('_least')
        ]
        kinds += [
            (name, colour, f'learned by {name}', ('_least', '_greatest'))
            for name, colour in zip(samplers, (theme.passed, *theme.others[1:]), strict=False)
        ]
        if 'of_failures' in learned:
            kinds.append(('of_failures', theme.others[0], 'failures of random runs',
                          ('_low', '_high')))
        width = 0.84 / len(kinds)
        for number, (name, colour, label, ends) in enumerate(kinds):
            values = learned[name].to_numpy(dtype=float)
            where = places + (number - (len(kinds) - 1) / 2) * width
            axes.bar(where, values, width=0.92 * width, color=colour, label=label)
            if ends[0]:
                axes.errorbar(where, values, yerr=_ends(learned, name, ends), fmt='none',
                              ecolor=theme.ink, capsize=3, elinewidth=1)
        axes.plot(places, learned['paper'].to_numpy(dtype=float), 'D', color=theme.failed,
                  markersize=7, label='learned in the paper', clip_on=False)
        words = [f'{low:,.0f}-{high:,.0f}' for low, high in
                 zip(learned['from_m'], learned['to_m'], strict=True)]
        axes.set_xticks(places, words)
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
        axes.set_xlabel('start distance along the runway [m]')
        axes.set_ylabel('probability')
        style_axes(axes, grid='y')
        axes.legend(frameon=False, fontsize=9, ncols=4, loc='lower center',
                    bbox_to_anchor=(0.5, 1.0), columnspacing=1.2, handlelength=1.4)

    return Picture(
        name='learned', title="Where the generic network's failures start", draw=draw,
        caption='What cross-entropy has learned: the mean over searches that differ in their seed, '
        "and the least and greatest of them. Beside it the program's own distribution, the "
        "failures among random runs with 95 % intervals, and what the paper's search learned; of "
        'the stretches without a diamond it says about 1 % in all.',
    )


def _rates(axes: Axes, networks: pd.DataFrame, name: str, theme: Theme) -> None:
    places = np.arange(len(networks))
    axes.errorbar(networks[name], places, xerr=_ends(networks, name), fmt='o', color=theme.passed,
                  markersize=5, capsize=3, label='here')
    paper = networks[f'paper_{name}'].to_numpy(dtype=float, na_value=_NO_PAPER)
    axes.plot(paper, places, 'D', color=theme.failed, fillstyle='none', markersize=6,
              markeredgewidth=1.5, label='the paper')
    axes.set_yticks(places, networks['network'])
    axes.set_ylim(len(networks) - 0.5, -0.5)
    shown = np.nanmax([*networks[f'{name}_high'], *paper[~np.isnan(paper)]])
    axes.set_xlim(-0.02 * shown, min(1.05 * shown, 1.02))
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=' %'))
    style_axes(axes)


def _share_picture(
    frame: pd.DataFrame, columns: tuple[str, str], name: str, title: str, label: str,
    ticks: Callable[[Axes], None],
) -> Picture:
    present = [one for one in _SHOWN if one in set(frame.get('network', ()))]

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        colours = dict(zip(_SHOWN, network_colours(len(_SHOWN), theme), strict=True))
        for one in present:
            part = frame[(frame['network'] == one) & (frame['runs'] > 0)]
            middle = (part[columns[0]] + part[columns[1]]) / 2
            axes.plot(middle, 1 - part['satisfied'], color=colours[one], linewidth=1.8, marker='o',
                      markersize=3.5, label=one, zorder=3)
            axes.fill_between(middle, 1 - part['satisfied_high'], 1 - part['satisfied_low'],
                              color=colours[one], alpha=0.14, linewidth=0)
        ticks(axes)
        axes.set_xlabel(label)
        axes.set_ylabel('runs that fail')
        axes.set_ylim(-0.01, 1.01)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
        style_axes(axes)
        axes.legend(frameon=False, fontsize=9, ncols=5, loc='lower center',
                    bbox_to_anchor=(0.5, 1.0), columnspacing=1.2, handlelength=1.6)

    return Picture(
        name=name, title=title, draw=draw,
        caption='The share of runs that fail; the shaded bands are 95 % Clopper-Pearson '
        'intervals, one by one. All networks had the same scenes.',
    )


def _campaigns(results: Results, names: Sequence[str]) -> list[CampaignRuns]:
    return [
        dataclasses.replace(results.networks[name].runs, label=name)
        for name in names if name in results.networks
    ]


def _ends(
    frame: pd.DataFrame, name: str, ends: tuple[str, str] = ('_low', '_high')
) -> np.ndarray:
    """Lengths of the error bars, below and above."""
    value = frame[name].to_numpy(dtype=float)
    lengths = [value - frame[f'{name}{ends[0]}'].to_numpy(dtype=float),
               frame[f'{name}{ends[1]}'].to_numpy(dtype=float) - value]
    return np.clip(np.nan_to_num(np.array(lengths)), 0, None)
