"""Options of a sampler: numbers given as ``key=value``, checked against a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from taxinet_ros.core.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class Option:
    """A number that a sampler takes.

    Attributes:
        meaning: in a few words.
        default: value where none is given.
        low, high: ends of what is allowed, both included.
        whole: whether it is a whole number.
    """

    meaning: str
    default: float
    low: float
    high: float
    whole: bool = False

    def parse(self, where: str, given: str | float) -> float:
        """The value that was given.

        Raises:
            UsageError: it is no such number.
        """
        try:
            value = float(given)
        except ValueError:
            raise UsageError(f'{where}={given}: {given!r} is no number') from None
        if not math.isfinite(value) or not self.low <= value <= self.high:
            raise UsageError(f'{where}={given}: needs to be within {self.low:g}..{self.high:g}')
        if self.whole and not value.is_integer():
            raise UsageError(f'{where}={given}: needs to be a whole number')
        return value


def split_options(texts: Iterable[str]) -> dict[str, str]:
    """Keys and values of ``key=value`` texts, for ``make_sampler(…, **options)``.

    Raises:
        UsageError: a text is no such thing, or a key is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition('='))
        if not (key and equals and value):
            raise UsageError(f'sampler option {text!r}: expected key=value')
        if key in found:
            raise UsageError(f'sampler option {key} is given twice')
        found[key] = value
    return found


def parse_options(
    sampler: str, known: Mapping[str, Option], given: Mapping[str, str | float]
) -> dict[str, float]:
    """The value of every option of a sampler, the given ones and the defaults.

    Raises:
        UsageError: an unknown option (the known ones are listed), or a value that is not allowed.
    """
    for key in given:
        if key not in known:
            names = ', '.join(known) or 'none'
            raise UsageError(f'sampler {sampler}: unknown option {key}; known: {names}')
    return {
        key: option.parse(f'sampler {sampler}: {key}', given.get(key, option.default))
        for key, option in known.items()
    }
