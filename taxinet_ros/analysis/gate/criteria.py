"""Acceptance thresholds on a campaign's runs: criteria, verdicts, and why.

A share of runs is only known within an interval, so there are three verdicts. PASS: the relevant
bound of the interval clears the threshold. FAIL: the whole interval is beyond it. INCONCLUSIVE: the
threshold lies within it, and more runs would decide; or the runs give no rate.
Both bounds are one-sided, each at the stated confidence: a system exactly at the threshold passes,
or fails, with a probability of at most 1 - confidence each. With several criteria, that holds for
each; the gate passes if all do and fails if any does. Runs broken by the bench violate nothing, so
they keep it from passing and do not fail it.

By default that probability covers all looks at a campaign together, so it may be monitored while
running, and an inconclusive one may be extended. Half of it is spent on the look at the number of
runs planned before the first one, with exact binomial bounds; the other half on all other looks,
with bounds valid at any number of runs. :mod:`taxinet_ros.trials.rates` defines both, and which
runs count.
``Look.PLANNED`` spends all of it on the planned number of runs, and says nothing at any other;
``Look.SEQUENTIAL`` follows the runs in their order and stands by the first decision of a sequential
test (:mod:`taxinet_ros.trials.sequential`), which ``falsify --until`` may have stopped at.
"""

from __future__ import annotations

import enum
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import (
    CONFIDENCE,
    Planned,
    ProgramRate,
    anytime_bounds,
    count_kinds,
    kind_words,
    off_runway_rate,
    rate_of,
    share_bounds,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sequential import (
    MAX_OFF_RUNWAY,
    MIN_SATISFACTION,
    Course,
    Decision,
    SequentialTest,
    course,
    sequential_test,
)

if TYPE_CHECKING:
    from taxinet_ros.analysis.gate.baseline import AgainstBaseline

TEXT = Path(__file__).with_name('gate.j2')
_SATISFIED = 'satisfied'
MOST_RUNS = 10**7
"""Maximum number of additional runs suggested."""


class Bounds(NamedTuple):
    """A share of runs with its one-sided bounds, as fractions; NaN, 0 and 1 without runs."""

    share: float
    low: float
    high: float


class Look(enum.StrEnum):
    """Looks at a campaign that its confidence covers."""

    ANY = 'any'
    """The planned number of runs, and any other."""
    PLANNED = 'planned'
    """The planned number of runs alone."""
    SEQUENTIAL = 'sequential'
    """Every run in turn, up to the first decision."""

    @classmethod
    def of(cls, *, planned: bool, sequential: bool) -> Self:
        """The one that the options of the command ask for.

        Raises:
            UsageError: both do.
        """
        if planned and sequential:
            raise UsageError('gate: planned and sequential do not go together; leave one out')
        return cls('planned' if planned else 'sequential' if sequential else 'any')


class Verdict(enum.StrEnum):
    """The verdict of a gate, or of one of its criteria."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    INCONCLUSIVE = 'INCONCLUSIVE'


class Kind(enum.Enum):
    """What a criterion limits."""

    SATISFACTION = enum.auto()
    OFF_RUNWAY = enum.auto()
    BASELINE = enum.auto()
    BROKEN = enum.auto()


@dataclass(frozen=True, kw_only=True, slots=True)
class GateOptions:
    """Acceptance criteria of a campaign.

    Attributes:
        min_satisfaction: minimum share of runs that satisfy their formulas, or None.
        max_off_runway: maximum share of runs that leave the runway, or None.
        confidence: confidence of each one-sided bound, or of each answer of a sequential test.
        look: the looks that the confidence covers.
        design: with a sequential test and one threshold, the share that the system is designed
            for, in the words of the threshold; or None.
        margin: with a baseline, the loss against it up to which a system counts as no worse, as a
            share of scenes (:mod:`taxinet_ros.analysis.gate.baseline`); None: no baseline.
    """

    min_satisfaction: float | None = None
    max_off_runway: float | None = None
    confidence: float = CONFIDENCE
    look: Look = Look.ANY
    design: float | None = None
    margin: float | None = None

    def __post_init__(self) -> None:
        """Check the criteria.

        Raises:
            UsageError: a share is not within 0..1, there is no criterion, or a test cannot be made.
        """
        self._check_values()
        if self.design is not None and self.look is not Look.SEQUENTIAL:
            raise UsageError('design: only with sequential')
        if self.design is not None and None not in (self.min_satisfaction, self.max_off_runway):
            raise UsageError(
                'design: with one threshold only; it is unclear which of the two it belongs to'
            )
        if self.look is Look.SEQUENTIAL:
            if self.margin is not None:
                raise UsageError(
                    'baseline: not with sequential, which may end anywhere; the paired test is '
                    'for scenes whose number was fixed beforehand'
                )
            for criterion in (MIN_SATISFACTION, MAX_OFF_RUNWAY):
                self.test(criterion)

    def test(self, criterion: str) -> SequentialTest | None:
        """The sequential test of a criterion; None if the gate has no such threshold.

        Raises:
            UsageError: no such test can be made.
        """
        threshold = (
            self.max_off_runway if criterion == MAX_OFF_RUNWAY else self.min_satisfaction
        )
        if threshold is None:
            return None
        return sequential_test(criterion, threshold, self.design, self.confidence)

    def _check_values(self) -> None:
        for name, value in (
            ('min_satisfaction', self.min_satisfaction),
            ('max_off_runway', self.max_off_runway),
            ('margin', self.margin),
        ):
            if value is not None and not 0 <= value <= 1:
                raise UsageError(f'{name} {value:g}: a share, so it needs to be within 0..1')
        if (self.min_satisfaction, self.max_off_runway, self.margin) == (None, None, None):
            raise UsageError(
                'gate: give a threshold: min_satisfaction, max_off_runway or baseline'
            )
        if not 0.5 <= self.confidence < 1:
            raise UsageError(f'confidence {self.confidence:g}: needs to be within 0.5..1')


@dataclass(frozen=True, kw_only=True, slots=True)
class Criterion:
    """One criterion and its verdict.

    Attributes:
        kind: what it limits.
        name: such as ``satisfied >= 0.86``.
        verdict: the answer.
        sentence: explanation with figures.
        bounds: share and bounds; None for a mere count.
        more_runs: approximate number of further runs for a conclusive verdict if the share stays
            the same; None if no number suffices, or none is needed.
        course: how far a sequential test has come, or None.
        test: that test, or None.
        against: of a comparison with a baseline, the runs that got worse.
        next: the command to go on with where it has not passed, or ''.
    """

    kind: Kind
    name: str
    verdict: Verdict
    sentence: str
    bounds: Bounds | None = None
    more_runs: int | None = None
    course: Course | None = None
    test: SequentialTest | None = None
    against: frozenset[str] = frozenset()
    next: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class GateResult:
    """The result of a gate on a campaign.

    Attributes:
        verdict: FAIL if a share or the comparison fails, else INCONCLUSIVE if one is or the bench
            broke, else PASS.
        criteria: all criteria.
        counts: runs by outcome, all five of them.
        judged: runs with a verdict.
        effective: runs drawn by the program itself, from which shares are estimated.
        notes: further remarks.
        baseline: the comparison with a baseline, or None.
    """

    verdict: Verdict
    criteria: tuple[Criterion, ...]
    counts: Mapping[Outcome, int]
    judged: int
    effective: int
    notes: tuple[str, ...]
    baseline: AgainstBaseline | None = None


def gate_result(
    rows: Sequence[RunRow], options: GateOptions, *, planned: int | range = 0,
    rules: Sequence[str] = (), compared: Criterion | None = None, folder: str = '',
) -> GateResult:
    """Evaluate acceptance criteria on a campaign.

    Args:
        rows: its runs.
        options: the criteria.
        planned: number of runs planned before the first one, or their indices; 0 for the actual
            number.
        rules: stop rules of the search's sessions, as typed after ``--until``.
        compared: the criterion of a baseline, or None.
        folder: what a command calls these runs; '' for no next commands.

    Raises:
        UsageError: runs were stopped before it was known whether they leave the runway.
    """
    counts = {outcome: sum(row.outcome is outcome for row in rows) for outcome in Outcome}
    satisfied = rate_of(rows, lambda row: row.outcome is Outcome.PASS, planned or None)
    shares = []
    if options.min_satisfaction is not None:
        shares.append((MIN_SATISFACTION, satisfied, options.min_satisfaction))
    if options.max_off_runway is not None:
        on_runway = _on_runway(rows, planned or None)
        shares.append((MAX_OFF_RUNWAY, on_runway, 1 - options.max_off_runway))
    criteria = []
    for criterion, good, threshold in shares:
        test = options.test(criterion) if options.look is Look.SEQUENTIAL else None
        if test is not None:
            criteria.append(_sequential(rows, good, test, planned or None))
        else:
            off = criterion == MAX_OFF_RUNWAY
            criteria.append(_criterion(good, threshold, options, off=off))
    if compared is not None:
        criteria.append(compared)
    criteria.append(_infra(rows))
    if folder:
        criteria = [_with_next(one, options, folder) for one in criteria]
    verdicts = {one.verdict for one in criteria if one.kind is not Kind.BROKEN}
    if counts[Outcome.INFRA_ERROR]:
        verdicts.add(Verdict.INCONCLUSIVE)
    return GateResult(
        verdict=next((one for one in (Verdict.FAIL, Verdict.INCONCLUSIVE) if one in verdicts),
                     Verdict.PASS),
        criteria=tuple(criteria), counts=counts, judged=satisfied.runs,
        effective=satisfied.drawn, notes=tuple(macro_text(
            TEXT, 'notes', counts=counts, found=satisfied, criteria=criteria, rules=rules,
            planned=planned if isinstance(planned, int) else len(planned), look=options.look,
        ).splitlines()),
    )


def _with_next(one: Criterion, options: GateOptions, folder: str) -> Criterion:
    """The criterion with the command to go on with, if it has not passed and has none."""
    if one.verdict is Verdict.PASS or one.next:
        return one
    if one.kind is Kind.BROKEN:
        command = ['doctor', folder]
    elif one.verdict is Verdict.FAIL:
        command = ['why', folder]
    elif one.kind is Kind.OFF_RUNWAY:
        command = ['plan', folder, '--max-off-runway', f'{options.max_off_runway:g}']
    else:
        command = ['plan', folder, '--min-satisfaction', f'{options.min_satisfaction:g}']
    if command[0] == 'plan' and options.confidence != CONFIDENCE:
        command += ['--confidence', f'{options.confidence:g}']
    return replace(one, next=shlex.join(['taxinet', *command]))


def bounds(found: ProgramRate, confidence: float, look: Look = Look.ANY) -> Bounds:
    """A share with its one-sided bounds, each at a confidence over the looks at the campaign."""
    share = found.drawn_hits / found.drawn if found.drawn else math.nan
    return Bounds(share, *found.bounds((1 - confidence) / (2 if look is Look.ANY else 1)))


def further_runs(found: ProgramRate, threshold: float, confidence: float) -> int | None:
    """Approximate number of further runs to decide on a ``threshold``.

    It assumes that the share stays the same; without runs, that all are good.

    Returns:
        None if the share equals the threshold, or more than :data:`MOST_RUNS` would be needed.
    """
    share = found.drawn_hits / found.drawn if found.drawn else 1.0
    # A campaign that has not started can plan them; otherwise they add to the planned runs.
    ends = anytime_bounds if found.runs else share_bounds

    def decided(number: float) -> bool:
        low, high = ends(share * number, (1 - share) * number, (1 - confidence) / 2)
        return low >= threshold or high < threshold

    low, high = found.drawn, MOST_RUNS
    if not decided(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return math.ceil((high - found.drawn) * (found.runs / found.drawn if found.drawn else 1.0))


def _on_runway(rows: Sequence[RunRow], planned: Planned) -> ProgramRate:
    off = off_runway_rate(rows, planned)
    if off is None:
        judged = [row for row in rows if row.outcome.judged]
        unknown = sum(row.left_runway is None for row in judged)
        raise UsageError(
            f'max_off_runway: {unknown} of {len(judged)} runs were stopped too early to know '
            'whether they leave the runway; run the campaign without stop_on'
        )
    return rate_of(rows, lambda row: not row.left_runway, planned)


def _criterion(
    good: ProgramRate, threshold: float, options: GateOptions, *, off: bool
) -> Criterion:
    """Criterion on a minimum share of good runs; ``off`` words it as a maximum of the others."""
    planned = options.look is Look.PLANNED
    found = bounds(good, options.confidence, options.look)
    more = None
    if (good.runs and not good.drawn) or (planned and (good.anytime or not good.runs)):
        verdict = Verdict.INCONCLUSIVE
    elif found.low >= threshold:
        verdict = Verdict.PASS
    elif found.high < threshold:
        verdict = Verdict.FAIL
    else:
        verdict = Verdict.INCONCLUSIVE
        more = None if planned else further_runs(good, threshold, options.confidence)
    name, limit = _SATISFIED, threshold
    if off:
        name, limit = 'off the runway', options.max_off_runway or 0.0
    shown, once = (
        _shown(one, off=off) for one in (found, bounds(good, options.confidence, Look.PLANNED)))
    sign = '<=' if off else '>='
    return Criterion(
        kind=Kind.OFF_RUNWAY if off else Kind.SATISFACTION,
        name=f'{name} {sign} {limit:g}', verdict=verdict, bounds=shown, more_runs=more,
        sentence=macro_text(
            TEXT, 'share', good=good, shown=shown, once=once, name=name,
            confidence=options.confidence, look=options.look, more=more,
            undecided=verdict is Verdict.INCONCLUSIVE,
        ),
    )


def _sequential(
    rows: Sequence[RunRow], good: ProgramRate, test: SequentialTest, planned: Planned
) -> Criterion:
    """Criterion by a sequential test, at its first decision."""
    found = course(rows, test, planned)
    off = test.criterion == MAX_OFF_RUNWAY
    name, sign = ('off the runway', '<=') if off else ('satisfied', '>=')
    verdict = Verdict.INCONCLUSIVE
    if found.decision in (Decision.PASS, Decision.FAIL):
        verdict = Verdict(found.decision.value)
    return Criterion(
        kind=Kind.OFF_RUNWAY if off else Kind.SATISFACTION,
        name=f'{name} {sign} {test.shown(test.limit):g}, sequential', verdict=verdict,
        course=found, test=test,
        sentence=macro_text(TEXT, 'sequential', found=found, good=good, test=test, name=name),
    )


def _shown(found: Bounds, *, off: bool) -> Bounds:
    """Bounds of good runs in the words of a criterion, which may limit the others."""
    return Bounds(1 - found.share, 1 - found.high, 1 - found.low) if off else found


def further_words(good: ProgramRate, more: int | None) -> str:
    """How many further runs would decide, of :func:`further_runs`."""
    return macro_text(TEXT, 'further', good=good, more=more)


def _infra(rows: Sequence[RunRow]) -> Criterion:
    kinds = [row.kind for row in rows if row.outcome is Outcome.INFRA_ERROR]
    return Criterion(
        kind=Kind.BROKEN,
        name='runs broken by the bench: at most 0',
        verdict=Verdict.FAIL if kinds else Verdict.PASS,
        sentence=macro_text(
            TEXT, 'broken', runs=len(kinds), kinds=kind_words(count_kinds(kinds))),
    )
