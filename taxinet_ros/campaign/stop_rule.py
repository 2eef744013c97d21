"""When a search has seen enough: so many failures, or a rate that is known well enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.estimate import Estimate, estimate_rate
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

    def met(self, rows: Sequence[RunRow]) -> bool:
        """Whether the runs so far are enough."""
        if self.kind == FAILURES:
            return sum(row.outcome is Outcome.FAIL for row in rows) >= self.value
        found = failure_estimate(rows)
        return found is not None and (found.rate.high - found.rate.low) / 2 <= self.value


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


def failure_estimate(rows: Sequence[RunRow]) -> Estimate | None:
    """Failure rate under the program's own distribution; None where weights are unknown."""
    judged = [row for row in rows if row.outcome.judged]
    signs = [-1.0 if row.outcome is Outcome.FAIL else 1.0 for row in judged]
    return estimate_rate(signs, [row.weight for row in judged])


def off_runway_estimate(rows: Sequence[RunRow]) -> Estimate | None:
    """Rate at which the aircraft leaves the runway, likewise; None if runs were stopped on it."""
    judged = [row for row in rows if row.outcome.judged]
    if any(row.left_runway is None for row in judged):
        return None
    signs = [-1.0 if row.left_runway else 1.0 for row in judged]
    return estimate_rate(signs, [row.weight for row in judged])
