"""Figures of a system's runs: rates with intervals, robustness, ODD cells, causes.

Every rate is one of :mod:`taxinet_ros.trials.rates`: of the runs that the program itself drew. A
campaign whose scenes were all chosen by a sampler gives counts, and no rate. Several campaigns of
one system are added up in the open, beside their own figures; as somebody decided to run another
one after the first, their interval is the one that is valid at any time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.extras.evidence.inputs import CampaignInput
from taxinet_ros.trials.rates import (
    ProgramRate,
    count_kinds,
    off_runway_rate,
    rate,
    rate_of,
    without_gaps,
)
from taxinet_ros.trials.record.row import RunRow

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Of the robustness."""


class Verdict(StrEnum):
    """What figures say of a goal."""

    SUPPORTED = 'supported'
    """The whole interval, or a count without any error, meets the target."""
    REFUTED = 'refuted'
    """The whole interval, or a count without any error, misses it."""
    UNDETERMINED = 'undetermined'
    """The interval contains the target, or there is none."""


def pooled(rates: Sequence[ProgramRate]) -> ProgramRate:
    """The sum of the same rate of several campaigns; its interval is valid at any time."""
    if len(rates) == 1:
        return rates[0]
    samplers = dict.fromkeys(one.sampler for one in rates if one.sampler)
    return ProgramRate(
        runs=sum(one.runs for one in rates), hits=sum(one.hits for one in rates),
        drawn=sum(one.drawn for one in rates), drawn_hits=sum(one.drawn_hits for one in rates),
        anytime=True, sampler=', '.join(samplers),
    )


def claim_verdict(formula: Mapping[str, Any], target: float) -> tuple[Verdict, str]:
    """What the figures of a formula say of "satisfied in at least ``target`` of the runs"."""
    low, high = formula['satisfied_at_least'], formula['satisfied_at_most']
    if low is None:
        return Verdict.UNDETERMINED, formula['why_no_rate']
    # A claim of 99.99999 % is not one of 100 %.
    words = f'95 % interval {interval_words(low, high)}, claim at least {100 * target:.12g} %'
    if low >= target:
        return Verdict.SUPPORTED, f'{words}: all of it meets the claim'
    if high < target:
        return Verdict.REFUTED, f'{words}: all of it misses the claim'
    return Verdict.UNDETERMINED, f'{words}: the interval contains the claim'


def interval_words(low: float, high: float) -> str:
    """Ends of an interval in percent with two decimals, rounded outwards."""
    return f'{math.floor(1e4 * low + 1e-6) / 100:.2f}–{math.ceil(1e4 * high - 1e-6) / 100:.2f} %'


def share_json(found: ProgramRate, *, rated: bool = True) -> dict[str, Any]:
    """Counts of a kind of run and its rate; null where there is none.

    Not ``rated``: it has no interval, as runs were stopped before it was decided.
    """
    known = found.rate if rated else None
    return {
        'runs': found.runs, 'hits': found.hits, 'drawn': found.drawn,
        'drawn_hits': found.drawn_hits, 'any_time': found.anytime,
        'rate': known.rate if known else None, 'low': known.low if known else None,
        'high': known.high if known else None,
    }


def _counted(one: CampaignInput) -> list[RunRow]:
    """The runs that the program drew and that count, judged or not."""
    outcomes = {row.index: row.outcome for row in one.rows}
    end = without_gaps(outcomes, one.planned)
    return [row for row in one.rows if row.index < end and row.from_program]


def infra_json(campaigns: Sequence[CampaignInput]) -> dict[str, Any]:
    """Runs that the test bench could not carry out, of those that it tried."""
    rows = [row for one in campaigns for row in one.rows]
    broken = [row for row in rows if row.outcome is Outcome.INFRA_ERROR]
    drawn = [
        row.outcome is Outcome.INFRA_ERROR for one in campaigns for row in _counted(one)
        if row.outcome.judged or row.outcome is Outcome.INFRA_ERROR
    ]
    anytime = len(campaigns) > 1 or any(
        rate_of(one.rows, lambda row: True, one.planned).anytime for one in campaigns
    )
    found = ProgramRate(
        runs=sum(row.outcome.judged for row in rows) + len(broken), hits=len(broken),
        drawn=len(drawn), drawn_hits=sum(drawn), anytime=anytime,
    )
    return share_json(found) | {'kinds': count_kinds(row.kind for row in broken if row.kind)}


def rho_json(campaigns: Sequence[CampaignInput], spec: str) -> dict[str, Any]:
    """Quantiles of the robustness of the runs that the program drew; null without any."""
    values: list[float] = []
    unknown = 0
    for one in campaigns:
        for row in _counted(one):
            if not row.outcome.judged:
                continue
            value = row.rho.get(spec)
            if value is None or not math.isfinite(value):
                unknown += 1
            else:
                values.append(value)
    found = np.quantile(np.array(values), QUANTILES).tolist() if values else []
    return {
        'runs': len(values), 'not_exact': unknown,
        'quantiles': [
            {'share': share, 'rho': value} for share, value in zip(QUANTILES, found, strict=False)
        ],
    }


def formula_json(campaigns: Sequence[CampaignInput], spec: str) -> dict[str, Any]:
    """All figures of one formula; a run is undecided if it was stopped before the formula was.

    Undecided runs count as violated for the lower bound of the satisfied share and as satisfied for
    the upper one, since their results decided which were stopped.
    """
    def of(kind: str) -> ProgramRate:
        return pooled([
            rate_of(one.rows, lambda row: _decided(row, spec) == kind, one.planned)
            for one in campaigns
        ])

    satisfied, violated, undecided = map(of, ('satisfied', 'violated', 'undecided'))
    runs, hits, open_hits = satisfied.drawn, satisfied.drawn_hits, undecided.drawn_hits
    low, high = (
        rate(number, runs, anytime=satisfied.anytime) for number in (hits, hits + open_hits)
    )
    return {
        'formula': spec,
        'satisfied': share_json(satisfied, rated=not open_hits),
        'violated': share_json(violated, rated=not open_hits),
        'undecided': share_json(undecided),
        'satisfied_at_least': low.low if runs else None,
        'satisfied_at_most': high.high if runs else None,
        'why_no_rate': '' if runs and not open_hits else (
            satisfied.why_not or 'runs were stopped before the formula was decided, which '
            'depends on their results: the bounds count them as violated, and as satisfied'
        ),
        'rho': rho_json(campaigns, spec),
    }


def _decided(row: RunRow, spec: str) -> str:
    known = row.robustness.get(spec)
    if known is None or not (known.satisfied or known.failed):
        return 'undecided'
    return 'satisfied' if known.satisfied else 'violated'


def counts_json(campaigns: Sequence[CampaignInput], specs: Sequence[str]) -> dict[str, Any]:
    """Counts, rates and robustness of one campaign, or of several of one system."""
    rows = [row for one in campaigns for row in one.rows]
    counts = Counter(row.outcome.value for row in rows)
    off = [off_runway_rate(one.rows, one.planned) for one in campaigns]
    known = [one for one in off if one is not None]
    return {
        'runs': len(rows),
        'outcomes': {one.value: counts[one.value] for one in Outcome if counts[one.value]},
        'samplers': sorted({row.sampler for row in rows if row.sampler}),
        'formulas': [formula_json(campaigns, spec) for spec in specs],
        'off_runway': share_json(pooled(known)) if known and len(known) == len(off) else None,
        'infra': infra_json(campaigns),
    }
