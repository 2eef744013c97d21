"""Where a signal comes from: ``NAME[unit]=/topic:field.path*factor`` as a user writes it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.field_path import FieldPath, number_at, parse_field_path
from taxinet_ros.core.mtl.lexer import RESERVED
from taxinet_ros.core.mtl.units import DIMENSIONS, dimension_of, si_unit

_EXAMPLE = 'cte=/robot/odom:pose.pose.position.y'
_FORM = re.compile(
    r'\s*(?P<name>[^=\s\[]+)\s*(?:\[\s*(?P<unit>[^\]]*?)\s*\]\s*)?=\s*(?P<topic>[^:\s]+)\s*:\s*(?P<path>[^*]+?)\s*'
    r'(?:\*\s*(?P<factor>\S+)\s*)?'
)
_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


@dataclass(frozen=True, kw_only=True, slots=True)
class SignalSource:
    """One number of the messages of a topic.

    Attributes:
        name: what formulas call it.
        topic: topic, as the user wrote it.
        path: the field.
        factor: what the field is multiplied with, e.g. 0.01745329 for a field in degrees.
        unit: SI unit of the product, such as ``m`` or ``rad``; '' where nobody said.
    """

    name: str
    topic: str
    path: FieldPath
    factor: float = 1.0
    unit: str = ''

    def __str__(self) -> str:
        factor = '' if self.factor == 1.0 else f'*{self.factor:g}'
        unit = f'[{self.unit}]' if self.unit else ''
        return f'{self.name}{unit}={self.topic}:{self.path}{factor}'

    def read(self, message: Any) -> tuple[float, str]:
        """The signal's value in a message, and '' or why it is none (then the value is NaN)."""
        try:
            value = number_at(message, self.path) * self.factor
        except LookupError as error:
            return math.nan, f'{self.name}: {error.args[0]}'
        finite = math.isfinite(value)
        return value, '' if finite else f'{self.name} is {value}'


def parse_signals(texts: Iterable[str]) -> tuple[SignalSource, ...]:
    """Read sources, each ``NAME=/topic:field.path``; ``NAME[unit]``, and ``*factor`` at the end.

    Raises:
        UsageError: a text of another form, a name that formulas cannot use, or one used twice.
    """
    found: dict[str, SignalSource] = {}
    for text in texts:
        try:
            source = _source(text)
        except UsageError as error:
            raise UsageError(f'signals: {text!r}: {error}') from None
        if source.name in found:
            raise UsageError(f'signals: {text!r}: there is a {source.name} already')
        found[source.name] = source
    return tuple(found.values())


def _source(text: str) -> SignalSource:
    match = _FORM.fullmatch(text)
    if match is None:
        raise UsageError(f'expected NAME=/topic:field, e.g. {_EXAMPLE}')
    name = match['name']
    if not _NAME.fullmatch(name) or name in RESERVED:
        raise UsageError(f'name {name!r}: letters, digits and _, and none that formulas reserve')
    return SignalSource(
        name=name, topic=match['topic'], path=parse_field_path(match['path']),
        factor=_factor(match['factor'] or '1'), unit=_unit(match['unit']),
    )


def _unit(text: str | None) -> str:
    if text is None:
        return ''
    dimension = dimension_of(text)
    if dimension is None or text not in ('1', si_unit(dimension)):
        known = ', '.join(filter(None, map(si_unit, DIMENSIONS)))
        raise UsageError(
            f'unit {text!r}: formulas compare in SI: one of {known} or 1; scale with *factor'
        )
    return text


def _factor(text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not math.isfinite(factor) or factor == 0:
        raise UsageError(f'factor {text!r} needs to be a finite number other than 0')
    return factor
