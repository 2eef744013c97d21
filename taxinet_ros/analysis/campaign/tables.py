"""Tables of the findings about a campaign."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from taxinet_ros.analysis.campaign.findings import CAUSE, Findings
from taxinet_ros.analysis.causes.causes import FoundRate
from taxinet_ros.analysis.report.parts import Cell, Column, Table
from taxinet_ros.analysis.runs.bins import bin_rates
from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate
from taxinet_ros.analysis.runs.features import shown_features
from taxinet_ros.core.scenario_fields import clock_words

_RATE = (
    Column(name='runs', title='runs'), Column(name='failures', title='fail'),
    Column(name='rate_percent', title='fail [%]', decimals=1),
    Column(name='rate_low_percent', title='from [%]', decimals=1),
    Column(name='rate_high_percent', title='to [%]', decimals=1),
)
_NUMBERS = ('rain_percent', 'cross_track_m', 'distance_m', 'heading_deg')


def rates_table(findings: Findings) -> Table:
    """How often each network fails and leaves the runway."""
    rows: list[tuple[Cell, ...]] = []
    for runs in findings.campaigns:
        off = runs.off_runway()
        off_cells = _shares(off)[2:] if off is not None else (None, None, None)
        rows.append((runs.label, runs.sampler or 'drawn', *_shares(runs.rate()), *off_cells,
                     _known(runs.rate().effective), sum(runs.others.values()) + runs.undecided))
    return Table(
        name='rates', title='Rates', rows=tuple(rows),
        caption='With 95 % intervals, of the runs drawn by the program itself. Without such runs '
        'there is no interval, and the rate is that of the runs made; the off-runway share is '
        'unknown if runs were stopped early.',
        columns=(
            Column(name='network', title='network'), Column(name='sampler', title='sampler'),
            *_RATE, Column(name='off_runway_percent', title='off the runway [%]', decimals=1),
            Column(name='off_runway_low_percent', title='from [%]', decimals=1),
            Column(name='off_runway_high_percent', title='to [%]', decimals=1),
            Column(name='effective_runs', title='drawn [runs]', decimals=0),
            Column(name='without_verdict', title='without verdict'),
        ),
    )


def bins_table(runs: CampaignRuns) -> Table:
    """Failure rates in bins of each feature."""
    rows: list[tuple[Cell, ...]] = []
    for feature in shown_features(runs.frame):
        for one, rate in bin_rates(runs, feature):
            rho = runs.frame.loc[one.mask, 'rho'].median()
            rows.append((feature.title, one.label, _known(one.low), _known(one.high),
                         *_shares(rate), _known(float(rho))))
    return Table(
        name='rates_by_feature', title='Rates by feature', rows=tuple(rows),
        caption='The failure rate in each bin of the figure above, and the median robustness.',
        columns=(
            Column(name='feature', title='feature'), Column(name='bin', title='values'),
            # As text, with unit and clock times, they are in the column before.
            Column(name='low', title='low', decimals=2, on_page=False),
            Column(name='high', title='high', decimals=2, on_page=False), *_RATE,
            Column(name='median_rho', title='median ρ', decimals=2),
        ),
    )


def causes_table(findings: Findings, failures: pd.DataFrame) -> Table:
    """The causes, with the worst run of each and the rates of the baselines in them."""
    rows: list[tuple[Cell, ...]] = []
    for number, cause in enumerate(findings.causes.found):
        worst = failures[failures[CAUSE] == cause.rank].sort_values('rho')['run_id']
        others = [100 * one.in_causes[number].rate for one in findings.comparisons]
        rows.append((
            cause.rank, cause.region.words(), *_shares(cause.inside),
            100 * cause.outside.rate, 100 * cause.whole.rate, 100 * cause.share,
            *(_known(100 * part) for part in cause.associated), 100 * cause.added,
            *(_known(other) for other in others), _p(cause.p),
            str(worst.iloc[0]) if len(worst) else None,
        ))
    return Table(
        name='causes', title='Causes', rows=tuple(rows), run_id_column='worst_run',
        caption='Fail: of the runs here and in no cause above; all: of all runs here. As regions '
        'are chosen for such rates, these are too high, which the intervals allow for. Contains: '
        'share of all failures; adds: of those in no cause above. Associated: how many fewer '
        'failures there would be if runs here failed like all others. That is no proof: what the '
        'program draws together counts for both, and such shares do not add up.',
        columns=(
            Column(name='rank', title='#'), Column(name='cause', title='cause'), *_RATE,
            Column(name='elsewhere_percent', title='elsewhere [%]', decimals=1),
            Column(name='all_runs_percent', title='all [%]', decimals=1),
            Column(name='share_percent', title='contains [%]', decimals=1),
            Column(name='associated_percent', title='associated [%]', decimals=1),
            Column(name='associated_low_percent', title='from [%]', decimals=1),
            Column(name='associated_high_percent', title='to [%]', decimals=1),
            Column(name='added_percent', title='adds [%]', decimals=1),
            *(Column(name=f'baseline_{number}_percent', title=f'{one.baseline.label} [%]',
                     decimals=1)
              for number, one in enumerate(findings.comparisons, 1)),
            Column(name='p', title='p'), Column(name='worst_run', title='worst run'),
        ),
    )


def ranking_table(findings: Findings) -> Table:
    """Features by their information about failing."""
    return Table(
        name='feature_ranking', title='Features',
        caption='How much each alone tells of whether a run fails (mutual information); p after '
        'Holm.',
        columns=(
            Column(name='feature', title='feature'),
            Column(name='information_bit', title='information [bit]', decimals=4),
            Column(name='explained_percent', title='of all there is to know [%]', decimals=1),
            Column(name='p', title='p', decimals=3),
        ),
        rows=tuple((one.feature.title, one.information_bit, 100 * one.explained, one.p)
                   for one in findings.ranking),
    )


def failures_table(failures: pd.DataFrame, most: int) -> Table:
    """The first failures to inspect."""
    rows = tuple(_failure(run) for run in failures.head(most).to_dict('records'))
    return Table(
        name='counterexamples', title='Counterexamples', rows=rows, run_id_column='run_id',
        caption='The worst of each cause in turn.',
        columns=(
            Column(name='run_id', title='run'), Column(name='rho', title='ρ', decimals=2),
            Column(name='time_of_day', title='time'), Column(name='clouds', title='clouds'),
            Column(name='rain_percent', title='rain [%]', decimals=0),
            Column(name='cross_track_m', title='left of the line [m]', decimals=1),
            Column(name='distance_m', title='along the track [m]', decimals=0),
            Column(name='heading_deg', title='nose left [°]', decimals=0),
            Column(name='left_runway', title='off the runway'),
            Column(name='cause', title='cause'),
        ),
    )


def _failure(run: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    left = float(run['left_runway'])
    return (
        str(run['run_id']), float(run['rho']), clock_words(float(run['time_of_day_h'])),
        str(run['clouds']), *(float(run[name]) for name in _NUMBERS),
        None if math.isnan(left) else bool(left), int(run[CAUSE]) or None,
    )


def _shares(rate: GroupRate | FoundRate) -> tuple[Cell, ...]:
    return (rate.runs, rate.failures, _known(100 * rate.rate), _known(100 * rate.low),
            _known(100 * rate.high))


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _p(value: float) -> str:
    return '< 0.001' if value < 0.001 else f'{value:.3f}'
