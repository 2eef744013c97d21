"""Robust satisfaction interval: the values the robustness of a formula can still take.

During a run, rho is only known to lie between two bounds (Deshmukh et al., Formal Methods in System
Design 51, 2017). For a complete run both equal rho; for a stopped or aborted run only an interval
is known.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Self

from taxinet_ros.errors import UsageError

LOWER, UPPER = 'rho_lower', 'rho_upper'
"""Names of the ends of an interval, in messages and in JSON."""


class Verdict(enum.IntEnum):
    """Verdict of a robustness interval. Only SATISFIED is a success."""

    UNKNOWN = 0
    SATISFIED = 1
    VIOLATED = 2
    MARGINAL = 3
    """Robustness exactly zero; counts as a failure, as in VerifAI."""


def rho_text(rho: float, digits: str = '.2f', width: int = 0) -> str:
    """A robustness with its sign, which is the verdict: where it rounds to zero, one digit more.

    Args:
        rho: the robustness.
        digits: format of a number, without its sign.
        width: minimum width.
    """
    rho += 0.0  # no negative zero
    text = f'{rho:+{width}{digits}}'
    return text if rho == 0 or float(text) else f'{rho:+{width}.1g}'


class RobustnessInterval(NamedTuple):
    """Bounds on the robustness of one formula on one run, in the unit of its predicate.

    Attributes:
        lower, upper: minimum and maximum robustness; equal if rho is known.
    """

    lower: float
    upper: float

    @classmethod
    def exactly(cls, rho: float) -> Self:
        """Interval of a known robustness."""
        return cls(rho, rho)

    @classmethod
    def of_message(cls, message: Any) -> Self:
        """Interval in a robustness message, or in one of a verdict's formulas."""
        return cls(float(message.rho_lower), float(message.rho_upper))

    def by_end(self) -> dict[str, float]:
        """Its ends by :data:`LOWER` and :data:`UPPER`."""
        return {LOWER: self.lower, UPPER: self.upper}

    def by_column(self, spec: str) -> dict[str, float]:
        """Its ends by :func:`lower_column` and :func:`upper_column` of a formula."""
        return {lower_column(spec): self.lower, upper_column(spec): self.upper}

    @property
    def exact(self) -> bool:
        """Whether rho is known."""
        return self.lower == self.upper

    @property
    def unclear(self) -> bool:
        """Whether rho rests on empty windows only, not on any sample."""
        return self.exact and math.isinf(self.lower)

    @property
    def satisfied(self) -> bool:
        """Whether robustness > 0 is certain."""
        return self.lower > 0

    @property
    def failed(self) -> bool:
        """Whether robustness > 0 is impossible."""
        return self.upper <= 0

    @property
    def decided(self) -> bool:
        """Whether robustness > 0 is certain or impossible."""
        return self.satisfied or self.failed

    @property
    def nearest_to_zero(self) -> float | None:
        """The bound nearer to zero, with the sign of rho; None if the sign is unknown."""
        return self.upper if self.failed else self.lower if self.satisfied else None

    @property
    def verdict(self) -> Verdict:
        """Verdict of the interval.

        An infinite rho rests on empty windows: nothing was evaluated, so the verdict is UNKNOWN.

        Raises:
            UsageError: a bound is NaN, or the interval is empty.
        """
        lower, upper = self
        if not lower <= upper:
            raise UsageError(f'robustness: [{lower}, {upper}] is no interval')
        if lower == upper and math.isinf(lower):
            return Verdict.UNKNOWN
        if lower > 0:
            return Verdict.SATISFIED
        if upper < 0:
            return Verdict.VIOLATED
        return Verdict.MARGINAL if lower == upper else Verdict.UNKNOWN

    def words(self, digits: str = '.3f', width: int = 0) -> str:
        """E.g. ``rho -0.500`` or ``rho within [-inf, -0.500]``.

        Args:
            digits: format of a number, without its sign.
            width: minimum width of a known rho.
        """
        if self.exact:
            return f'rho {rho_text(self.lower, digits, width)}'
        return f'rho within [{rho_text(self.lower, digits)}, {rho_text(self.upper, digits)}]'

    def bound_words(self, width: int = 0) -> str:
        """E.g. ``rho -0.50``, ``rho <=-0.50``, or ``rho -1.00 to +2.00``; for tables.

        Args:
            width: minimum width of rho, or of its only finite bound.
        """
        if not self.exact and math.isfinite(self.lower) and math.isfinite(self.upper):
            return f'rho {rho_text(self.lower)} to {rho_text(self.upper)}'
        sign = '' if self.exact else '<=' if self.upper < math.inf else '>='
        value = self.lower if sign == '>=' else self.upper
        return f'rho {sign}{rho_text(value, width=max(width - len(sign), 0))}'


def lower_column(spec: str) -> str:
    """Column with the lower end of a formula's interval, in tables and traces."""
    return f'{LOWER}.{spec}'


def upper_column(spec: str) -> str:
    """Column with the upper end of a formula's interval."""
    return f'{UPPER}.{spec}'


def specs_with_interval(columns: Iterable[object]) -> list[str]:
    """Names of the formulas that a table or trace has the interval of, in its order."""
    start = lower_column('')
    return [str(name).removeprefix(start) for name in columns if str(name).startswith(start)]


def exact_intervals(rho: Mapping[str, float]) -> dict[str, RobustnessInterval]:
    """Intervals of known robustness values, by formula name."""
    return {name: RobustnessInterval.exactly(value) for name, value in rho.items()}


def exact_rho(robustness: Mapping[str, RobustnessInterval]) -> dict[str, float]:
    """Known robustness values, by formula name."""
    return {name: interval.lower for name, interval in robustness.items() if interval.exact}
