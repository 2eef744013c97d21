"""Tables and pictures of a study: networks, hours, runway, pairs, learned distributions, stages.

Shares are fractions 0..1 in the data frames; the column definitions below select the displayed
columns, with titles and units.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from taxinet_ros.analysis.campaign.figures import hour_ticks, network_colours, rho_picture
from taxinet_ros.analysis.report.parts import Column, Picture, Table, Theme, style_axes
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.analysis.runs.features import DISTANCE, TIME_OF_DAY
from taxinet_ros.study.report.paper import LEARNED_EDGES_M, PAPER_LEARNED, PAPER_NETWORKS
from taxinet_ros.study.report.results import Network, Results
from taxinet_ros.study.stages.plan import (
    BEST,
    GENERIC,
    HALTON,
    ITERATIVE,
    ORIGINAL,
    SPECIALISED,
)
from taxinet_ros.study.stages.run import StageRecord, Stages
from taxinet_ros.study.stages.stage import Stage
from taxinet_ros.trials.learned_result import share_of_failures
from taxinet_ros.trials.rates import Rate

PAIRS = (
    (ORIGINAL, GENERIC), (ORIGINAL, HALTON), (ORIGINAL, SPECIALISED), (GENERIC, HALTON),
    (GENERIC, SPECIALISED), (HALTON, SPECIALISED), *((GENERIC, one) for one in ITERATIVE),
    (ITERATIVE[0], ITERATIVE[1]), (ITERATIVE[0], ITERATIVE[2]), (ORIGINAL, BEST),
    (SPECIALISED, BEST),
)
"""Pairs of networks that are compared on common scenes."""
_MEDIANS = {
    'median_rho': 'rho', 'median_settle_s': 'settle_time_s',
    'median_cte_error_m': 'cte_error_mean_abs_m',
}
WEIGHTED = 'ce'
"""The sampler with bounded weights, whose runs therefore allow estimates for the program."""
HOURS = tuple(float(hour) for hour in range(6, 19))
DISTANCES_M = tuple(float(metre) for metre in range(0, 2001, 100))


def networks_frame(results: Results) -> pd.DataFrame:
    """One row per network, with our figures and those of the paper."""
    return pd.DataFrame([_network_line(network) for network in results.networks.values()])


def hours_frame(results: Results) -> pd.DataFrame:
    """One row per network and hour."""
    return _binned(results, 'time_of_day_h', HOURS)


def distances_frame(results: Results) -> pd.DataFrame:
    """One row per network and 100 m of start distance."""
    return _binned(results, 'distance_m', DISTANCES_M)


def pairs_frame(results: Results) -> pd.DataFrame:
    """One row per pair of compared networks."""
    lines = []
    for first, second in PAIRS:
        pair = results.pair(first, second)
        if pair is not None and len(pair.frame):
            lines.append({
                'first': first, 'second': second, 'scenes': len(pair.frame),
                **_pair_columns('satisfied', pair.satisfied()),
                **_pair_columns('off_runway', pair.off_runway()),
            })
    return pd.DataFrame(lines)


def learned_frame(results: Results) -> pd.DataFrame:
    """One row per stretch of runway for which the paper reports a learned probability.

    For each sampler the mean, minimum and maximum of its searches: their variation by chance, not a
    confidence interval of the distribution of failures. The latter is in ``of_failures``, from
    random runs, and in ``weighted``, from the weighted runs of ``ce``, both without smoothing: bins
    without failures have 0.
    """
    choice = results.distances
    if choice is None:
        return pd.DataFrame()
    generic = results.networks.get(GENERIC)
    found = results.searches.get(WEIGHTED, ())
    weighted = bool(found) and all(one.evidence for one in found)
    lines = []
    for (low, high), paper in zip(
        itertools.pairwise(LEARNED_EDGES_M), PAPER_LEARNED, strict=True
    ):
        line = {
            'from_m': low, 'to_m': high, 'program': choice.probability_within(low, high),
            'paper': paper,
        }
        for sampler, searches in results.searches.items():
            shares = [
                choice.probability_within(low, high, one.probabilities[choice.dimension.name])
                for one in searches
            ]
            line |= {sampler: sum(shares) / len(shares), f'{sampler}_least': min(shares),
                     f'{sampler}_greatest': max(shares)}
        if generic is not None:
            there = generic.within('distance_m', low, high)[generic.runs.failed]
            line |= {'failures': int(there.sum()),
                     **_with_interval('of_failures', generic.share(there))}
        if weighted:
            line |= _with_interval('weighted', share_of_failures(found, choice, low, high))
        lines.append(line)
    return pd.DataFrame(lines)


def _network_line(network: Network) -> dict[str, Any]:
    paper, table = PAPER_NETWORKS.get(network.name), network.table
    errors: Mapping[str, Mapping[str, float]] = network.card.get('errors', {})
    return {
        'network': network.name,
        'runs': len(table),
        'without_verdict': network.unjudged,
        'satisfied_runs': int((~network.runs.failed).sum()),
        **_with_interval('satisfied', network.satisfied),
        'paper_satisfied': paper.satisfied if paper else None,
        'off_runway_runs': int(network.off.sum()),
        **_with_interval('off_runway', network.off_runway),
        'paper_off_runway': paper.off_runway if paper else None,
        'paper_source': paper.source if paper else '',
        **{name: _median(table[column].to_numpy(dtype=float)) for name, column in _MEDIANS.items()},
        'median_settled_cte_m': _median(network.settled_m),
        'images': network.card.get('images'),
        'validation_cte_mae_m': errors.get('cte_m', {}).get('mae'),
        'validation_he_mae_deg': errors.get('he_deg', {}).get('mae'),
        'perception': network.runs.perception,
        'perception_sha256': str(network.table['perception_fingerprint'].iloc[0]),
        'program': network.runs.program,
        'seed': int(table['seed'].iloc[0]),
    }


def _binned(results: Results, column: str, edges: tuple[float, ...]) -> pd.DataFrame:
    """One row per network and bin; bins are closed below, the last one also above."""
    unit = column.rpartition('_')[2]
    lines = []
    for network in results.networks.values():
        passed, off = ~network.runs.failed, network.off
        rho = network.runs.frame['rho'].to_numpy(dtype=float)
        for low, high in itertools.pairwise(edges):
            end = np.nextafter(high, np.inf) if high == edges[-1] else high
            inside = network.within(column, low, end)
            lines.append({
                'network': network.name, f'from_{unit}': low, f'to_{unit}': high,
                'runs': int(inside.sum()), 'satisfied_runs': int(passed[inside].sum()),
                **_with_interval('satisfied', network.share(passed[inside])),
                'off_runway_runs': int(off[inside].sum()),
                **_with_interval('off_runway', network.share(off[inside])),
                'median_rho': _median(rho[inside]),
            })
    return pd.DataFrame(lines)


def _pair_columns(name: str, rates: Any) -> dict[str, Any]:
    return {
        f'{name}_first': rates.first,
        f'{name}_second': rates.second,
        f'{name}_only_first': rates.only_first,
        f'{name}_only_second': rates.only_second,
        **_with_interval(f'{name}_difference', rates.difference),
        f'{name}_mcnemar_p': rates.p_value,
    }


def _with_interval(name: str, found: Rate | Any) -> dict[str, float]:
    value, low, high = found
    return {name: value, f'{name}_low': low, f'{name}_high': high}


def _median(values: np.ndarray) -> float:
    """Median of the known values; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else math.nan


def stages_frame(found: Sequence[Stage], records: Stages) -> pd.DataFrame:
    """One row per stage; ``done`` is False if the log has no end event of it."""
    lines = []
    for stage in found:
        record = records.get(stage.name, StageRecord())
        facts = record.facts if record.key else {}
        lines.append({
            'stage': stage.name, 'done': bool(record.key), 'runs': stage.runs,
            'wall_s': record.wall_s if record.sittings else None, 'sittings': record.sittings,
            'at_least': record.killed, 'cores': facts.get('cores'), 'workers': facts.get('workers'),
            'date': facts.get('date', ''), 'version': facts.get('version', ''),
            'skipped': record.skipped, 'command': shlex.join(['taxinet', *stage.words()]),
        })
    return pd.DataFrame(lines)


_PERCENT = 100
Columns = tuple[tuple[str, str, int | None, bool], ...]
"""Name in the data frame, title, digits, and whether it is a share displayed in percent."""


def _share_columns(
    name: str, title: str, ends: tuple[str, str] = ('low', 'high'),
    words: tuple[str, str] = ('from', 'to'),
) -> Columns:
    """A share and the ends of its interval."""
    return (
        (name, title, 1, True), (f'{name}_{ends[0]}', words[0], 1, True),
        (f'{name}_{ends[1]}', words[1], 1, True),
    )


NETWORK_COLUMNS: Columns = (
    ('network', 'network', None, False), ('runs', 'runs', None, False),
    *_share_columns('satisfied', 'satisfied [%]'),
    ('paper_satisfied', 'the paper [%]', 1, True),
    *_share_columns('off_runway', 'off the runway [%]'),
    ('paper_off_runway', 'the paper [%]', 1, True),
)
MORE_COLUMNS: Columns = (
    ('network', 'network', None, False), ('median_rho', 'median ρ [m]', 2, False),
    ('median_settle_s', 'median time to settle [s]', 1, False),
    ('median_settled_cte_m', 'median |CTE| after 10 s [m]', 3, False),
    ('median_cte_error_m', 'median error of CTE in a run [m]', 2, False),
    ('validation_cte_mae_m', 'error of CTE on pictures [m]', 3, False),
    ('validation_he_mae_deg', 'error of heading on pictures [°]', 3, False),
    ('without_verdict', 'runs without a verdict', None, False),
    ('perception', 'weights', None, False),
)
LEARNED_COLUMNS: Columns = (
    ('from_m', 'from [m]', 0, False), ('to_m', 'to [m]', 0, False),
    ('program', 'the program', 1, True),
    *(
        column for sampler in ('ce', 'ce-verifai', 'mab') for column in _share_columns(
            sampler, f'learned by {sampler}', *2 * (('least', 'greatest'),))
    ),
    *_share_columns('of_failures', 'failures of random runs'),
    *_share_columns('weighted', 'failures that ce found, weighted'),
    ('paper', 'learned in the paper', 1, True),
)
PAIR_COLUMNS: Columns = (
    ('first', 'first', None, False), ('second', 'second', None, False),
    ('scenes', 'scenes', None, False),
    *_share_columns('satisfied_difference', 'satisfied'), ('satisfied_mcnemar_p', 'p', None, False),
    *_share_columns('off_runway_difference', 'off the runway'),
    ('off_runway_mcnemar_p', 'p', None, False),
)


def binned_columns(unit: str, digits: int) -> Columns:
    """Columns of a table by hour, or by metre."""
    return (
        ('network', 'network', None, False), (f'from_{unit}', f'from [{unit}]', digits, False),
        (f'to_{unit}', f'to [{unit}]', digits, False), ('runs', 'runs', None, False),
        *_share_columns('satisfied', 'satisfied [%]'),
        ('off_runway', 'off the runway [%]', 1, True),
        ('median_rho', 'median ρ [m]', 2, False),
    )


def table_of(
    frame: pd.DataFrame, name: str, title: str, caption: str, columns: Columns
) -> Table:
    """A data frame as a display table; missing columns are omitted."""
    present = [column for column in columns if column[0] in frame]
    return Table(
        name=name, title=title, caption=caption,
        columns=tuple(Column(name=key, title=words, decimals=digits)
                      for key, words, digits, _ in present),
        rows=tuple(
            tuple(_cell(line[key], share=share) for key, _, _, share in present)
            for line in frame.to_dict('records')
        ),
    )


def _cell(value: object, *, share: bool) -> str | int | float | None:
    if isinstance(value, str):
        return value
    if value is None or pd.isna(value):  # type: ignore[call-overload]  # a cell is no array
        return None
    assert isinstance(value, int | float)
    return _PERCENT * value if share else value


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
