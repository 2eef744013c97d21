"""Sequential test of a share of runs: it ends as soon as the runs decide, with a known error.

The claim is that *bad* runs (violated, or off the runway) are no more frequent than a limit. After
every run two gamblers are asked, each of whom began with a stake of 1:

* one bets against "bad runs are at least as frequent as the limit". If that is true, the stake ever
  reaches 1/alpha with a probability of at most alpha (Ville, 1939), so a PASS at that moment is
  wrong with a probability of at most alpha = 1 - confidence, whenever somebody looks or stops;
* the other bets against "bad runs are at most as frequent as the limit": FAIL, likewise.

How they bet decides only how many runs it takes. Without a *design* rate the bets are spread over
all rates by Jeffreys' prior (:func:`.rates.log_evidence_below`), so nothing has to be known
beforehand. With one, the first gambler bets on this rate alone: Wald's sequential probability ratio
test (Annals of Mathematical Statistics 16, 1945), which of all tests with these errors takes the
fewest runs on average at the design rate and at the limit (Wald and Wolfowitz, 1948). Then there is
a third end: the runs are not as good as the design, as the same ratio says with the same
confidence. That is no violation of the limit, so it stays INCONCLUSIVE.

Wald's boundaries are 1/alpha here, not (1-beta)/alpha: errors then stay below alpha exactly, not
approximately. Since bad runs only ever speak against a PASS, each boundary is one number of bad
runs for each number of runs, and the probabilities of all ends are sums (:func:`operating`), not
simulations.

Other rules of ``--until`` are here too (:class:`StopRule`). With a stop rule the number of runs
depends on the results, so the intervals are those valid at any number of runs (:mod:`.rates`).
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import Planned, log_evidence_below, rate, without_gaps
from taxinet_ros.trials.record.row import RunRow

MIN_SATISFACTION = 'min-satisfaction'
MAX_OFF_RUNWAY = 'max-off-runway'


class Decision(enum.StrEnum):
    """How a sequential test ends."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    BELOW_DESIGN = 'BELOW_DESIGN'
    """Bad runs are more frequent than designed; on the limit nothing is known."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SequentialTest:
    """Test that bad runs are no more frequent than a limit.

    Attributes:
        criterion: ``min-satisfaction`` or ``max-off-runway``: which runs are bad.
        limit: largest acceptable share of bad runs, within 0..1 exclusively.
        design: share of bad runs for which the test is made, below the limit; None for none.
        confidence: of a PASS and of a FAIL, each; and of a pass at the design rate.
    """

    criterion: str
    limit: float
    design: float | None = None
    confidence: float = 0.95

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            UsageError: one is out of range.
        """
        if not 0 < self.limit < 1:
            raise UsageError(
                f'{self._words(self.limit, "threshold")}: no number of runs can decide it; a '
                'sequential test needs a threshold within 0..1, without its ends'
            )
        if not 0.5 <= self.confidence < 1:
            raise UsageError(f'confidence={self.confidence:g}: needs to be within 0.5..1')
        if self.design is not None and not 0 < self.design < self.limit:
            raise UsageError(
                f'{self._words(self.design, "design")}: needs to be better than the threshold '
                f'{self.shown(self.limit):g}, and not free of failures, since one would then be '
                'too many for ever'
            )

    def shown(self, bad: float) -> float:
        """A share of bad runs as the criterion words it: of satisfied runs, or of those off."""
        return bad if self.criterion == MAX_OFF_RUNWAY else round(1 - bad, 12)

    def _words(self, bad: float, what: str) -> str:
        return f'{self.criterion} {what}={self.shown(bad):g}'

    def __str__(self) -> str:
        """The rule as :func:`parse_test` reads it."""
        text = f'{self.criterion}={self.shown(self.limit):.12g}'
        if self.design is not None:
            text += f',design={self.shown(self.design):.12g}'
        return text if self.confidence == 0.95 else f'{text},confidence={self.confidence:.12g}'

    def is_bad(self, row: RunRow) -> bool | None:
        """Whether a judged run is bad; None if that is unknown."""
        if self.criterion == MAX_OFF_RUNWAY:
            return row.left_runway
        return row.outcome is Outcome.FAIL

    @property
    def enough(self) -> float:
        """Logarithm of the stake that decides."""
        return -math.log(1 - self.confidence)

    def log_pass(self, bad: int, good: int) -> float:
        """Logarithm of the stake against "at least as frequent as the limit"."""
        if self.design is None:
            return log_evidence_below(bad, good, self.limit)
        return bad * math.log(self.design / self.limit) + good * (
            math.log1p(-self.design) - math.log1p(-self.limit)
        )

    def log_fail(self, bad: int, good: int) -> float:
        """Logarithm of the stake against "at most as frequent as the limit"."""
        return log_evidence_below(good, bad, 1 - self.limit)

    def log_below_design(self, bad: int, good: int) -> float:
        """Logarithm of the stake against "no more frequent than the design"."""
        return -math.inf if self.design is None else -self.log_pass(bad, good)


def parse_test(text: str) -> SequentialTest:
    """Parse ``min-satisfaction=0.99,design=0.999,confidence=0.9`` or ``max-off-runway=0.01``.

    Raises:
        UsageError: it has another form, or a value is out of range.
    """
    head, *others = text.split(',')
    criterion, _, threshold = (part.strip() for part in head.partition('='))
    values = {'threshold': _number(text, threshold)}
    for part in others:
        name, _, value = (word.strip() for word in part.partition('='))
        if name not in ('design', 'confidence') or name in values:
            raise UsageError(
                f'until {text}: {part!r}: expected design=SHARE or confidence=SHARE, each once'
            )
        values[name] = _number(text, value)
    return sequential_test(
        criterion, values['threshold'], values.get('design'), values.get('confidence', 0.95)
    )


def sequential_test(
    criterion: str, threshold: float, design: float | None, confidence: float
) -> SequentialTest:
    """A test of a threshold, in the criterion's own words.

    Args:
        criterion: ``min-satisfaction`` or ``max-off-runway``.
        threshold: share of satisfied runs, or of those off the runway.
        design: the same share of the system that the test is made for, or None.
        confidence: of each answer.

    Raises:
        UsageError: a value is out of range.
    """
    def bad(share: float) -> float:
        return share if criterion == MAX_OFF_RUNWAY else round(1 - share, 12)

    return SequentialTest(
        criterion=criterion, limit=bad(threshold), confidence=confidence,
        design=None if design is None else bad(design),
    )


def _number(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f'until {text}: {number!r} is no number')
    return value


class _Boundaries:
    """Numbers of bad runs at which a test ends, for each number of runs; made as needed.

    One run more cannot lower the largest number that passes, nor raise it by more than one, as a
    good run only raises and a bad one only lowers the stake; the others likewise. So each takes one
    evaluation per run.
    """

    def __init__(self, test: SequentialTest) -> None:
        self._test = test
        self._ends: list[tuple[int, int, int]] = [(-1, 1, 1)]

    def at(self, runs: int) -> tuple[int, int, int]:
        """Most bad runs that pass, fewest that fail, fewest that are below the design."""
        while len(self._ends) <= runs:
            self._ends.append(self._next(len(self._ends)))
        return self._ends[runs]

    def _next(self, runs: int) -> tuple[int, int, int]:
        passes, fails, below = self._ends[-1]
        test, enough = self._test, self._test.enough
        if test.log_pass(passes + 1, runs - passes - 1) >= enough:
            passes += 1
        while fails <= runs and test.log_fail(fails, runs - fails) < enough:
            fails += 1
        while below <= runs and test.log_below_design(below, runs - below) < enough:
            below += 1
        return passes, fails, below


@lru_cache(maxsize=64)
def _boundaries(test: SequentialTest) -> _Boundaries:
    return _Boundaries(test)


def decision(test: SequentialTest, bad: int, runs: int) -> Decision | None:
    """What a test decides after a number of runs; None if it goes on."""
    passes, fails, below = _boundaries(test).at(runs)
    if bad <= passes:
        return Decision.PASS
    if bad >= fails:
        return Decision.FAIL
    return Decision.BELOW_DESIGN if bad >= below else None


@dataclass(kw_only=True, slots=True)
class Course:
    """How far a test has come on a campaign.

    Attributes:
        decision: the first one, or None; it stands whatever comes later.
        runs, bad: runs drawn by the program itself and judged until then, and the bad among them.
        index: number of the run that decided; None without a decision.
        later: such runs after the decision.
        unknown: index of the first run of which it is unknown whether it is bad, which ends the
            test; or None.
    """

    decision: Decision | None = None
    runs: int = 0
    bad: int = 0
    index: int | None = None
    later: int = 0
    unknown: int | None = None

    def take(self, row: RunRow, test: SequentialTest) -> None:
        """Go on with the next run in the order of their numbers."""
        if not row.outcome.judged or not row.from_program or self.unknown is not None:
            return
        if self.decision is not None:
            self.later += 1
            return
        is_bad = test.is_bad(row)
        if is_bad is None:
            self.unknown = row.index
            return
        self.runs, self.bad = self.runs + 1, self.bad + is_bad
        self.decision = decision(test, self.bad, self.runs)
        if self.decision is not None:
            self.index = row.index


def course(
    rows: Iterable[RunRow], test: SequentialTest, planned: Planned = None
) -> Course:
    """Follow a test through a campaign's runs in the order of their numbers.

    Runs that ended early are a biased sample, so it goes up to the first one without a result. Only
    runs drawn by the program itself count; those with an infrastructure error or a rejected scene
    are passed over.

    Args:
        rows: rows of a campaign.
        test: the test.
        planned: see :data:`.rates.Planned`.
    """
    listed = sorted(rows, key=lambda row: row.index)
    end = without_gaps({row.index: row.outcome for row in listed}, planned)
    found = Course()
    for row in listed:
        if row.index < end:
            found.take(row, test)
    return found


@dataclass(frozen=True, kw_only=True, slots=True)
class Operating:
    """What a test does at a true rate, with at most a number of runs.

    Attributes:
        truth: share of bad runs.
        passes, fails, below_design, open: probability of each end; ``open`` is that of none.
        mean_runs: expected number of runs.
    """

    truth: float
    passes: float
    fails: float
    below_design: float
    open: float
    mean_runs: float


def operating(test: SequentialTest, truth: float, most: int) -> Operating:
    """Probabilities of all ends, and the expected number of runs; exact sums, no simulation.

    Args:
        test: the test.
        truth: true share of bad runs.
        most: number of runs at which it is given up.
    """
    ends = dict.fromkeys(Decision, 0.0)
    alive, first = np.ones(1), 0  # probability of first, first + 1, … bad runs, not yet ended
    mean = 0.0
    for runs in range(1, most + 1):
        mean += float(alive.sum())
        grown = np.zeros(len(alive) + 1)
        grown[:-1] = alive * (1 - truth)
        grown[1:] += alive * truth
        passes, fails, below = _boundaries(test).at(runs)
        low = max(passes + 1 - first, 0)
        high = max(min(fails, below) - first, low)
        ends[Decision.PASS] += float(grown[:low].sum())
        ended = grown[high:]
        numbers = first + high + np.arange(len(ended))
        ends[Decision.FAIL] += float(ended[numbers >= fails].sum())
        ends[Decision.BELOW_DESIGN] += float(ended[numbers < fails].sum())
        alive, first = grown[low:high], first + low
        if not len(alive) or alive.sum() < 1e-15:
            alive = np.zeros(0)
            break
    return Operating(
        truth=truth, passes=ends[Decision.PASS], fails=ends[Decision.FAIL],
        below_design=ends[Decision.BELOW_DESIGN], open=float(alive.sum()), mean_runs=mean,
    )


def simulate(
    test: SequentialTest, outcomes: Sequence[bool] | np.ndarray
) -> tuple[Decision | None, int]:
    """Run a test on a sequence of bad (True) and good runs: the decision, and after how many."""
    bad = 0
    for number, is_bad in enumerate(outcomes, 1):
        bad += bool(is_bad)
        if (found := decision(test, bad, number)) is not None:
            return found, number
    return None, len(outcomes)


FAILURES = 'failures'
HALF_WIDTH = 'half-width'


@dataclass(frozen=True, kw_only=True, slots=True)
class StopRule:
    """A rule of ``--until``.

    Attributes:
        kind: ``failures``; ``half-width`` of the 95 % interval of the failure rate; or the
            criterion of a sequential test.
        value: number of failures, the half width as a fraction, or the test's threshold.
        test: the sequential test, or None.
    """

    kind: str
    value: float
    test: SequentialTest | None = None

    def __str__(self) -> str:
        return f'{self.kind}={self.value:g}' if self.test is None else str(self.test)

    @property
    def reached(self) -> str:
        """Text for a search that this rule ended."""
        return f'{self} reached' if self.test is None else f'{self} decided'

    @property
    def needs_draws(self) -> bool:
        """Whether it can only be met by runs that the program itself draws."""
        return self.kind != FAILURES


class StopCount:
    """What a rule needs of the runs so far, which are given in the order of their numbers."""

    def __init__(self, rule: StopRule) -> None:
        """No run is counted yet."""
        self._rule = rule
        self._failed = self._drawn = self._drawn_failed = 0
        self._course = Course()

    def take(self, row: RunRow) -> None:
        """Count the next run, which has a result."""
        failed = row.outcome is Outcome.FAIL
        self._failed += failed
        if row.outcome.judged and row.from_program:
            self._drawn += 1
            self._drawn_failed += failed
        if self._rule.test is not None:
            self._course.take(row, self._rule.test)

    @property
    def is_met(self) -> bool:
        """Whether the runs so far meet the rule."""
        if self._rule.test is not None:
            return self._course.decision is not None
        if self._rule.kind == FAILURES:
            return self._failed >= self._rule.value
        if not self._drawn:
            return False
        found = rate(self._drawn_failed, self._drawn, anytime=True)
        return (found.high - found.low) / 2 <= self._rule.value


def parse_stop_rule(text: str) -> StopRule:
    """Parse ``failures=K``, ``half-width=W``, or a sequential test (:func:`.parse_test`).

    Raises:
        UsageError: it is none of them.
    """
    kind, _, number = (part.strip() for part in text.partition('='))
    if kind in (MIN_SATISFACTION, MAX_OFF_RUNWAY):
        test = parse_test(text)
        return StopRule(kind=kind, value=test.shown(test.limit), test=test)
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    whole = kind == FAILURES and value >= 1 and value.is_integer()
    if not whole and not (kind == HALF_WIDTH and 0 < value < 0.5):
        raise UsageError(
            f'until {text}: expected {FAILURES}=K (1, 2, …), {HALF_WIDTH}=W (0…0.5), '
            f'{MIN_SATISFACTION}=SHARE or {MAX_OFF_RUNWAY}=SHARE'
        )
    return StopRule(kind=kind, value=value)
