"""Tables of a study: networks, hours, runway, pairs, learned distributions, stages.

Shares are fractions 0..1 in the data frames; the column definitions below select the displayed
columns, with titles and units.
"""

from __future__ import annotations

import itertools
import math
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from taxinet_ros.analysis.report.parts import Column, Table
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
from taxinet_ros.study.stages.record import StageRecord, Stages
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
    return pd.DataFrame([
        _stage_line(stage, records.get(stage.name, StageRecord())) for stage in found
    ])


def _stage_line(stage: Stage, record: StageRecord) -> dict[str, Any]:
    facts = record.facts if record.key else {}
    return {
        'stage': stage.name, 'done': bool(record.key), 'runs': stage.runs,
        'wall_s': record.wall_s if record.sittings else None, 'sittings': record.sittings,
        'at_least': record.killed, 'cores': facts.get('cores'), 'workers': facts.get('workers'),
        'date': facts.get('date', ''), 'version': facts.get('version', ''),
        'skipped': record.skipped, 'command': shlex.join(['taxinet', *stage.words()]),
    }


_PERCENT = 100
Columns = tuple[tuple[str, str, int | None, bool], ...]
"""Name in the data frame, title, digits, and whether it is a share displayed in percent."""
NETWORK_COLUMNS: Columns = (
    ('network', 'network', None, False), ('runs', 'runs', None, False),
    ('satisfied', 'satisfied [%]', 1, True), ('satisfied_low', 'from', 1, True),
    ('satisfied_high', 'to', 1, True), ('paper_satisfied', 'the paper [%]', 1, True),
    ('off_runway', 'off the runway [%]', 1, True), ('off_runway_low', 'from', 1, True),
    ('off_runway_high', 'to', 1, True), ('paper_off_runway', 'the paper [%]', 1, True),
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
        column for sampler in ('ce', 'ce-verifai', 'mab') for column in (
            (sampler, f'learned by {sampler}', 1, True), (f'{sampler}_least', 'least', 1, True),
            (f'{sampler}_greatest', 'greatest', 1, True),
        )
    ),
    ('of_failures', 'failures of random runs', 1, True), ('of_failures_low', 'from', 1, True),
    ('of_failures_high', 'to', 1, True), ('weighted', 'failures that ce found, weighted', 1, True),
    ('weighted_low', 'from', 1, True), ('weighted_high', 'to', 1, True),
    ('paper', 'learned in the paper', 1, True),
)
PAIR_COLUMNS: Columns = (
    ('first', 'first', None, False), ('second', 'second', None, False),
    ('scenes', 'scenes', None, False),
    ('satisfied_difference', 'satisfied', 1, True),
    ('satisfied_difference_low', 'from', 1, True), ('satisfied_difference_high', 'to', 1, True),
    ('satisfied_mcnemar_p', 'p', None, False),
    ('off_runway_difference', 'off the runway', 1, True),
    ('off_runway_difference_low', 'from', 1, True), ('off_runway_difference_high', 'to', 1, True),
    ('off_runway_mcnemar_p', 'p', None, False),
)


def binned_columns(unit: str, digits: int) -> Columns:
    """Columns of a table by hour, or by metre."""
    return (
        ('network', 'network', None, False), (f'from_{unit}', f'from [{unit}]', digits, False),
        (f'to_{unit}', f'to [{unit}]', digits, False), ('runs', 'runs', None, False),
        ('satisfied', 'satisfied [%]', 1, True), ('satisfied_low', 'from', 1, True),
        ('satisfied_high', 'to', 1, True), ('off_runway', 'off the runway [%]', 1, True),
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
