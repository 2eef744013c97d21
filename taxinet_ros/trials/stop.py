"""Rules that stop a search before all of its runs.

With a stop rule the number of runs depends on the results, so the intervals are those valid at any
number of runs (:mod:`taxinet_ros.trials.rates`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import rate
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sequential import (
    MAX_OFF_RUNWAY,
    MIN_SATISFACTION,
    Course,
    SequentialTest,
    parse_test,
)

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
            f'--until {text}: expected {FAILURES}=K (1, 2, …), {HALF_WIDTH}=W (0…0.5), '
            f'{MIN_SATISFACTION}=SHARE or {MAX_OFF_RUNWAY}=SHARE'
        )
    return StopRule(kind=kind, value=value)
