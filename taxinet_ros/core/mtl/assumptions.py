"""Bounds and rates of signals as a user writes them: ``cte=-25:25`` and ``cte=3``."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl.specs import SIGNALS


@dataclass(frozen=True, kw_only=True, slots=True)
class Assumptions:
    """What a user vouches for; it narrows robustness intervals before the end of a run.

    Attributes:
        bounds: least and greatest value by signal, in the unit of the signal.
        rates: greatest change per second by signal.
    """

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)

    def about(self, names: Collection[str]) -> Assumptions:
        """Those about some signals only."""
        return Assumptions(
            bounds={name: ends for name, ends in self.bounds.items() if name in names},
            rates={name: rate for name, rate in self.rates.items() if name in names},
        )


NO_ASSUMPTIONS = Assumptions()


def parse_assumptions(
    bounds: Iterable[str], rates: Iterable[str], signals: Collection[str] | None = None
) -> Assumptions:
    """Read what :func:`parse_bounds` and :func:`parse_rates` do.

    Raises:
        UsageError: see there.
    """
    return Assumptions(bounds=parse_bounds(bounds, signals), rates=parse_rates(rates, signals))


def parse_bounds(
    texts: Iterable[str], signals: Collection[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Read bounds, each ``SIGNAL=LOW:HIGH`` in the unit of the signal; an end may be ``inf``.

    Args:
        texts: the bounds.
        signals: names that there are; where None, those of a run (:data:`.specs.SIGNALS`).

    Returns:
        Least and greatest value by signal, as :class:`Monitor` takes them.

    Raises:
        UsageError: an unknown signal, one that is named twice, or no such numbers.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, value = _split(text, 'bound', '-25:25', found, signals)
        ends = [_number(end) for end in value.split(':')]
        if len(ends) != 2 or not ends[0] <= ends[1] or math.inf in (ends[0], -ends[1]):
            raise UsageError(
                f'bound {text!r}: expected LOW:HIGH with LOW <= HIGH{_unit(name)}, '
                f'e.g. {name}=-25:25'
            )
        found[name] = (ends[0], ends[1])
    return found


def parse_rates(
    texts: Iterable[str], signals: Collection[str] | None = None
) -> dict[str, float]:
    """Read rate limits, each ``SIGNAL=RATE`` in the unit of the signal per second.

    Args:
        texts: the limits.
        signals: names that there are; where None, those of a run (:data:`.specs.SIGNALS`).

    Returns:
        Greatest change per second by signal, as :class:`Monitor` takes them.

    Raises:
        UsageError: an unknown signal, one that is named twice, or no such number.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, value = _split(text, 'rate', '3', found, signals)
        rate = _number(value)
        if not 0 <= rate < math.inf:
            raise UsageError(
                f'rate {text!r}: expected a number >= 0{_unit(name, " per s")}, e.g. {name}=3'
            )
        found[name] = rate
    return found


def _split(
    text: str, what: str, example: str, found: Collection[str], signals: Collection[str] | None
) -> tuple[str, str]:
    known = SIGNALS if signals is None else signals
    name, sign, value = (part.strip() for part in text.partition('='))
    if not sign:
        first = next(iter(known), 'cte')
        raise UsageError(f'{what} {text!r}: expected SIGNAL=..., e.g. {first}={example}')
    if name not in known:
        raise UsageError(f'{what} {text!r}: unknown signal {name!r}; known: {", ".join(known)}')
    if name in found:
        raise UsageError(f'{what} {text!r}: {name} has one already')
    return name, value


def _unit(name: str, per: str = '') -> str:
    return f' [{SIGNALS[name]}{per}]' if name in SIGNALS else ''


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
