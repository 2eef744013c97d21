"""When a search has seen enough: so many failures, or a rate that is known well enough.

A search that ends by what it has seen has a number of runs that depends on its results, so its
intervals are those that hold at any number of runs (:mod:`taxinet_ros.campaign.rates`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from taxinet_ros.campaign.rates import failure_rate
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome

FAILURES = 'failures'
HALF_WIDTH = 'half-width'


@dataclass(frozen=True, kw_only=True, slots=True)
class StopRule:
    """A rule of ``--until``.

    Attributes:
        kind: ``failures``, or ``half-width`` of the 95 % interval of the failure rate.
        value: number of failures, or the half width as a fraction.
    """

    kind: str
    value: float

    def __str__(self) -> str:
        return f'{self.kind}={self.value:g}'

    @property
    def reached(self) -> str:
        """What a search says that was ended by it."""
        return f'{self} reached'

    def met(self, rows: Sequence[RunRow]) -> bool:
        """Whether these runs are enough."""
        if self.kind == FAILURES:
            return sum(row.outcome is Outcome.FAIL for row in rows) >= self.value
        found = failure_rate(rows, 0).rate
        return found is not None and (found.high - found.low) / 2 <= self.value


def parse_stop_rule(text: str) -> StopRule:
    """The rule ``failures=K`` or ``half-width=W``.

    Raises:
        UsageError: it is neither.
    """
    kind, _, number = (part.strip() for part in text.partition('='))
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    whole = kind == FAILURES and value >= 1 and value.is_integer()
    if not whole and not (kind == HALF_WIDTH and 0 < value < 0.5):
        raise UsageError(
            f'--until {text}: expected {FAILURES}=K (1, 2, …) or {HALF_WIDTH}=W (0…0.5)'
        )
    return StopRule(kind=kind, value=value)
