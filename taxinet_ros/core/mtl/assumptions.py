"""Bounds and rates of signals as a user writes them: ``cte=-25:25`` and ``cte=3``."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl.specs import SIGNALS


def parse_bounds(texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Read bounds, each ``SIGNAL=LOW:HIGH`` in the unit of the signal; an end may be ``inf``.

    Returns:
        Least and greatest value by signal, as :class:`Monitor` takes them.

    Raises:
        UsageError: an unknown signal, one that is named twice, or no such numbers.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, value = _split(text, 'bound', 'cte=-25:25', found)
        ends = [_number(end) for end in value.split(':')]
        if len(ends) != 2 or not ends[0] <= ends[1] or math.inf in (ends[0], -ends[1]):
            raise UsageError(
                f'bound {text!r}: expected LOW:HIGH with LOW <= HIGH [{SIGNALS[name]}], '
                f'e.g. {name}=-25:25'
            )
        found[name] = (ends[0], ends[1])
    return found


def parse_rates(texts: Iterable[str]) -> dict[str, float]:
    """Read rate limits, each ``SIGNAL=RATE`` in the unit of the signal per second.

    Returns:
        Greatest change per second by signal, as :class:`Monitor` takes them.

    Raises:
        UsageError: an unknown signal, one that is named twice, or no such number.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, value = _split(text, 'rate', 'cte=3', found)
        rate = _number(value)
        if not 0 <= rate < math.inf:
            raise UsageError(
                f'rate {text!r}: expected a number >= 0 [{SIGNALS[name]} per s], e.g. {name}=3'
            )
        found[name] = rate
    return found


def _split(text: str, what: str, example: str, found: Collection[str]) -> tuple[str, str]:
    name, sign, value = (part.strip() for part in text.partition('='))
    if not sign:
        raise UsageError(f'{what} {text!r}: expected SIGNAL=..., e.g. {example}')
    if name not in SIGNALS:
        raise UsageError(f'{what} {text!r}: unknown signal {name!r}; known: {", ".join(SIGNALS)}')
    if name in found:
        raise UsageError(f'{what} {text!r}: {name} has one already')
    return name, value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
