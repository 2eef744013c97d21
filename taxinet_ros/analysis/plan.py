"""Plan a campaign for a claim: how many runs, from the start or after those there are.

The numbers are those of :mod:`taxinet_ros.trials.sample_size` (a fixed number, or more after a
look) and :mod:`taxinet_ros.trials.sequential` (a test that stops by itself). Further runs are
those that ``gate`` takes, which spends half of its error on looks after the planned one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.gate.criteria import further_runs as runs_to_decide
from taxinet_ros.analysis.gate.criteria import further_words
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.rates import CONFIDENCE, ProgramRate, rate_of
from taxinet_ros.trials.sample_size import (
    MOST_FURTHER,
    Plan,
    chance,
    check_claim,
    fewest_runs,
    further_plan,
    further_runs,
    plan_with_power,
)
from taxinet_ros.trials.sequential import (
    MAX_OFF_RUNWAY,
    MIN_SATISFACTION,
    Operating,
    SequentialTest,
    operating,
    sequential_test,
)

_SHOWN_FAILURES = 3
_MOST_SEQUENTIAL = 50_000
"""Longest sequential test whose ends are computed; seconds of processor time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Claim:
    """A claim about a share of runs.

    Attributes:
        criterion: ``min-satisfaction`` or ``max-off-runway``.
        threshold: share of satisfied runs, at least; or of those off the runway, at most.
        confidence: of the claim.
        if_true: assumed true share, in the words of the threshold; or None.
        power: wanted chance of success at that share.
        failures: largest number of allowed failures to plan for, or None for the usual few.
    """

    criterion: str
    threshold: float
    confidence: float = CONFIDENCE
    if_true: float | None = None
    power: float = 0.9
    failures: int | None = None

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            UsageError: one is out of range, or of no effect.
        """
        if not 0 <= self.threshold <= 1:
            name = self.criterion.replace('-', '_')
            raise UsageError(f'{name} {self.threshold:g}: needs to be within 0..1')
        check_claim(self.limit, self.confidence)
        if self.failures is not None and not 0 <= self.failures <= 1000:
            raise UsageError(f'failures {self.failures}: needs to be within 0..1000')
        if self.if_true is not None and not 0 <= self.if_true <= 1:
            raise UsageError(f'if_true {self.if_true:g}: needs to be within 0..1')

    @property
    def off(self) -> bool:
        """Whether it is about runs off the runway."""
        return self.criterion == MAX_OFF_RUNWAY

    def bad(self, share: float) -> float:
        """Share of bad runs of a share in the words of the threshold."""
        return share if self.off else round(1 - share, 12)

    @property
    def limit(self) -> float:
        """Largest share of bad runs."""
        return self.bad(self.threshold)

    @property
    def any_look(self) -> float:
        """Confidence of each of the two kinds of looks of a gate."""
        return (1 + self.confidence) / 2

    @property
    def truth(self) -> float | None:
        """Assumed true share of bad runs."""
        return None if self.if_true is None else self.bad(self.if_true)


@dataclass(frozen=True, kw_only=True, slots=True)
class Further:
    """Further runs after those there are.

    Attributes:
        failures: allowed failures among them.
        drawn: number of further runs that the program itself has to draw; None if too many.
        runs: the same in runs of this search, of which a sampler may choose others.
        chance: probability of no more failures at the assumed true share, or None.
    """

    failures: int
    drawn: int | None
    runs: int | None
    chance: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Sequential:
    """What a sequential test would take.

    Attributes:
        test: the test.
        at_truth, at_limit: its ends at the assumed true share, and at the limit.
        most: number of runs at which it is given up.
    """

    test: SequentialTest
    at_truth: Operating
    at_limit: Operating
    most: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Planned:
    """The answer.

    Attributes:
        claim: the claim.
        fixed: plans with a fixed number of runs, by allowed failures.
        powered: the shortest plan with the wanted chance, if a true share is assumed.
        any_look: runs without failure of a new campaign, their number fixed beforehand, that
            ``gate`` takes without ``--planned``, as it keeps half of its error for other looks.
        by_sequential: further runs without a failure that ``gate --sequential`` takes.
        sequential: a test designed for the assumed share; None without one, or if it takes too
            long to compute.
        found: rate of bad runs of the campaign, if there is one.
        further: further runs after the campaign.
        likely: further runs with the wanted chance at the assumed true share, or at that of the
            campaign; None if neither meets the claim.
    """

    claim: Claim
    fixed: tuple[Plan, ...]
    powered: Plan | None
    any_look: int
    sequential: Sequential | None
    found: ProgramRate | None = None
    further: tuple[Further, ...] = ()
    likely: Further | None = None
    by_sequential: int | None = None

    @property
    def plans(self) -> list[Plan]:
        """All plans with a fixed number of runs, the shortest first."""
        found = {(one.runs, one.failures): one for one in (*self.fixed, self.powered) if one}
        return [found[key] for key in sorted(found)]


def parse_so_far(text: str) -> ProgramRate:
    """Parse ``RUNS:FAILURES``, runs drawn by the program itself.

    Raises:
        UsageError: it has another form.
    """
    parts = text.split(':')
    if len(parts) != 2 or not all(part.strip().isdecimal() for part in parts):
        raise UsageError(f'so_far {text}: expected RUNS:FAILURES, as in 4000:6')
    runs, bad = map(int, parts)
    if not 0 <= bad <= runs <= MOST_FURTHER or not runs:
        raise UsageError(
            f'so_far {text}: expected 1 to {MOST_FURTHER:,} runs, and no more failures'
        )
    return ProgramRate(runs=runs, hits=bad, drawn=runs, drawn_hits=bad, anytime=True)


def plan_claim(
    claim: Claim, campaign: RecordedCampaign | None = None, so_far: ProgramRate | None = None
) -> Planned:
    """Plan the runs for a claim.

    Args:
        claim: the claim.
        campaign: runs there are already, or None.
        so_far: their number instead, or None.

    Raises:
        UsageError: the claim cannot be shown, or the campaign has no runs that may count.
    """
    truth = claim.truth
    powered = None
    if truth is not None:
        powered = plan_with_power(claim.limit, claim.confidence, truth, claim.power)
    elif claim.power != 0.9 and campaign is None and so_far is None:
        raise UsageError(
            f'power {claim.power:g}: only with if_true, the share it is of, or a campaign'
        )
    most = _SHOWN_FAILURES if claim.failures is None else claim.failures
    allowed = range(most + 1) if claim.failures is None else _allowed(most)
    found = so_far if campaign is None else _found(claim, campaign)
    return Planned(
        claim=claim,
        fixed=tuple(_plan(claim, failures) for failures in allowed),
        powered=powered,
        any_look=fewest_runs(claim.limit, claim.any_look),
        sequential=_sequential(claim, powered),
        found=found,
        further=() if found is None else tuple(
            _further(claim, found, failures) for failures in allowed
        ),
        likely=None if found is None else _likely(claim, found),
        by_sequential=None if found is None else further_runs(
            found.drawn, found.drawn_hits, claim.limit, claim.confidence, 0),
    )


def _allowed(most: int) -> Sequence[int]:
    """A few numbers of failures up to the one asked for, which is always the last."""
    return sorted({round(most * part / 4) for part in range(5)})


def _plan(claim: Claim, failures: int) -> Plan:
    plan = Plan(runs=fewest_runs(claim.limit, claim.confidence, failures), failures=failures)
    if claim.truth is None:
        return plan
    return Plan(runs=plan.runs, failures=failures, chance=chance(plan, claim.truth))


def _sequential(claim: Claim, powered: Plan | None) -> Sequential | None:
    if claim.truth is None or powered is None or claim.if_true is None or not claim.truth:
        return None
    most = 4 * powered.runs
    if most > _MOST_SEQUENTIAL:
        return None
    test = sequential_test(claim.criterion, claim.threshold, claim.if_true, claim.confidence)
    return Sequential(
        test=test, most=most, at_truth=operating(test, claim.truth, most),
        at_limit=operating(test, claim.limit, most),
    )


def _found(claim: Claim, campaign: RecordedCampaign) -> ProgramRate:
    if claim.criterion == MIN_SATISFACTION:
        found = rate_of(
            campaign.rows, lambda row: row.outcome is Outcome.FAIL, campaign.planned_runs
        )
    else:
        unknown = sum(row.left_runway is None for row in campaign.judged)
        if unknown:
            raise UsageError(
                f'{campaign.folder}: {unknown} of {len(campaign.judged)} runs were stopped too '
                'early to know whether they leave the runway; run it without stop_on'
            )
        found = rate_of(campaign.rows, lambda row: bool(row.left_runway), campaign.planned_runs)
    if found.why_not:
        raise UsageError(f'{campaign.folder}: {found.why_not}')
    return found


def _further(claim: Claim, found: ProgramRate, failures: int) -> Further:
    shown = not failures and found.bounds(1 - claim.any_look)[1] <= claim.limit
    drawn = 0 if shown else further_runs(
        found.drawn, found.drawn_hits, claim.limit, claim.any_look, failures
    )
    if drawn is None:
        return Further(failures=failures, drawn=None, runs=None, chance=None)
    chosen = found.runs / found.drawn
    truth = claim.truth
    return Further(
        failures=failures, drawn=drawn, runs=math.ceil(drawn * chosen),
        chance=None if truth is None else chance(Plan(runs=drawn, failures=failures), truth),
    )


def _likely(claim: Claim, found: ProgramRate) -> Further | None:
    truth = found.drawn_hits / found.drawn if claim.truth is None else claim.truth
    plan = further_plan(
        found.drawn, found.drawn_hits, claim.limit, claim.any_look, truth=truth,
        power=claim.power,
    )
    return None if plan is None else Further(
        failures=plan.failures, drawn=plan.runs, chance=plan.chance,
        runs=math.ceil(plan.runs * found.runs / found.drawn),
    )


def two_sided(found: ProgramRate) -> tuple[float, float]:
    """95 % interval of the campaign's share of bad runs."""
    rate = found.rate
    return (0.0, 1.0) if rate is None else (rate.low, rate.high)


def hopeless(planned: Planned) -> bool:
    """Whether the campaign shows that the claim is false, at the claim's confidence."""
    found, claim = planned.found, planned.claim
    return found is not None and found.bounds(1 - claim.any_look)[0] > claim.limit


def plan_lines(planned: Planned, rules: Sequence[str] = ()) -> tuple[str, str]:
    """What the command prints before and after the table of plans.

    Args:
        planned: the plan.
        rules: stop rules by which the campaign may have ended.
    """
    found, claim = planned.found, planned.claim
    after = _text('looks', p=planned)
    if found is not None:
        decide = ''
        if found.drawn_hits:
            good = replace(
                found, hits=found.runs - found.hits, drawn_hits=found.drawn - found.drawn_hits)
            decide = further_words(good, runs_to_decide(good, 1 - claim.limit, claim.confidence))
        low, high = two_sided(found)
        after += '\n' + _text(
            'further', p=planned, low=low, high=high, rules=rules, hopeless=hopeless(planned),
            decide=decide,
        )
    return _text('claim', p=planned), after


def _text(macro: str, **values: Any) -> str:
    return macro_text(Path(__file__).with_suffix('.j2'), macro, **values)


def plan_json(planned: Planned) -> dict[str, Any]:
    """The plan as plain values."""
    found, test = planned.found, planned.sequential
    values: dict[str, Any] = {
        'claim': planned.claim, 'fixed': planned.fixed, 'with_power': planned.powered,
        'gate_at_any_look_without_failure': planned.any_look,
        'sequential': test and {
            'test': str(test.test), 'most_runs': test.most, 'if_true': test.at_truth,
            'at_limit': test.at_limit,
        },
    }
    if found is not None:
        low, high = two_sided(found)
        values['campaign'] = {
            'runs': found.runs, 'drawn': found.drawn, 'bad': found.drawn_hits, 'low': low,
            'high': high, 'number_fixed': not found.anytime, 'claim_is_false': hopeless(planned),
            'further': planned.further, 'further_by_sequential': planned.by_sequential,
            'likely': planned.likely,
        }
    return plain(values)
