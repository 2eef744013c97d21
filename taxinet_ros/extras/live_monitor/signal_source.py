"""Signal sources: ``NAME[unit]=/topic:field.path*factor``.

A field path addresses one number in a structured message: ``pose.pose.position.y``, ``ranges[0]``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from taxinet_ros.core.mtl.lexer import RESERVED
from taxinet_ros.core.units import DIMENSIONS, dimension_of, si_unit
from taxinet_ros.errors import UsageError, near_miss

FieldsOf = Callable[[str], Mapping[str, str]]
"""Maps the name ``package/Name`` of a structured type to its fields (name to type)."""
_STEP = re.compile(r'([A-Za-z][A-Za-z0-9_]*)(?:\[([0-9]{1,9})\])?')
_ARRAY = re.compile(r'(.+)\[([0-9]+)\]|sequence<(.+?)(?:, *[0-9]+)?>')
_NUMBER = re.compile(r'u?int(8|16|32|64)|float|double|long double|boolean|octet|char')


@dataclass(frozen=True, slots=True)
class FieldPath:
    """Path to a field of a (nested) message, or to an element of an array.

    Attributes:
        steps: field names and array indices, outermost first.
    """

    steps: tuple[str | int, ...]

    def __str__(self) -> str:
        text = ''.join(f'[{s}]' if isinstance(s, int) else f'.{s}' for s in self.steps)
        return text.removeprefix('.')


def parse_field_path(text: str) -> FieldPath:
    """Parse a path: field names joined by dots, with an index in brackets after an array."""
    steps: list[str | int] = []
    for part in text.split('.'):
        match = _STEP.fullmatch(part.strip())
        if match is None:
            raise UsageError(
                f'{text!r} is no field; write one such as pose.pose.position.y or ranges[0]'
            )
        steps.append(match[1])
        if match[2] is not None:
            steps.append(int(match[2]))
    return FieldPath(tuple(steps))


def check_field(path: FieldPath, type_name: str, fields_of: FieldsOf) -> None:
    """Check that messages of a type have a number at a path.

    Args:
        path: the path.
        type_name: type of the whole message, ``package/Name``.
        fields_of: gives the fields of this type and of nested types.
    """
    kind, done = type_name, FieldPath(())
    for step in path.steps:
        array = _ARRAY.fullmatch(kind)
        if isinstance(step, int):
            kind = _element(done, kind, array, step)
        elif array is not None:
            raise UsageError(f'{done} is an array, {kind}: write {done}[0]')
        else:
            kind = _member(done, kind, step, fields_of)
        done = FieldPath((*done.steps, step))
    if _NUMBER.fullmatch(kind):
        return
    if _ARRAY.fullmatch(kind):
        raise UsageError(f'{done} is an array, {kind}: write {done}[0]')
    inside = f'; it has: {", ".join(fields_of(kind))}' if '/' in kind else ''
    raise UsageError(f'{done} is a {kind}, no number{inside}')


def _element(done: FieldPath, kind: str, array: re.Match[str] | None, index: int) -> str:
    if array is None:
        raise UsageError(f'{done} is a {kind}, no array: leave [{index}] out')
    if array[2] is not None and index >= int(array[2]):
        raise UsageError(f'{done}[{index}]: there are {array[2]} elements, from [0] on')
    return array[1] or array[3]


def _member(done: FieldPath, kind: str, name: str, fields_of: FieldsOf) -> str:
    if '/' not in kind:
        raise UsageError(f'{done} is a {kind}, it has no field {name!r}')
    fields = fields_of(kind)
    if name not in fields:
        owner = f'{done} ({kind})' if done.steps else kind
        listed = ', '.join(fields) or 'none'
        hint = near_miss(name, fields)
        raise UsageError(f'{owner} has no field {name!r}{hint}; its fields: {listed}')
    return fields[name]


def number_at(message: Any, path: FieldPath) -> float:
    """Number at a path that :func:`check_field` has accepted; a boolean is 1 or 0."""
    value, done = message, ''
    for step in path.steps:
        if isinstance(step, int):
            if step >= len(value):
                raise LookupError(f'{done} has {len(value)} elements, no [{step}]')
            value = value[step]
            done += f'[{step}]'
        else:
            value = getattr(value, step)
            done += f'.{step}' if done else step
    # ROS represents an octet as a byte string of length 1.
    return float(value[0] if isinstance(value, bytes) else value)


_EXAMPLE = 'cte=/robot/odom:pose.pose.position.y'
_FORM = re.compile(
    r'\s*(?P<name>[^=\s\[]+)\s*(?:\[\s*(?P<unit>[^\]]*?)\s*\]\s*)?=\s*(?P<topic>[^:\s]+)\s*:\s*(?P<path>[^*]+?)\s*'
    r'(?:\*\s*(?P<factor>\S+)\s*)?'
)
_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


@dataclass(frozen=True, kw_only=True, slots=True)
class SignalSource:
    """Source of a signal: one number in the messages of a topic.

    Attributes:
        name: signal name in formulas.
        topic: topic, as the user wrote it.
        path: the field.
        factor: multiplies the field, e.g. 0.01745329 for a field in degrees.
        unit: SI unit of the product, such as ``m`` or ``rad``; '' if not given.
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
        """Value of the signal in a message, and '' or the reason why it is unusable."""
        try:
            value = number_at(message, self.path) * self.factor
        except LookupError as error:
            return math.nan, f'{self.name}: {error.args[0]}'
        finite = math.isfinite(value)
        return value, '' if finite else f'{self.name} is {value}'


def parse_signals(texts: Iterable[str]) -> tuple[SignalSource, ...]:
    """Parse sources, each ``NAME=/topic:field.path``, optionally ``NAME[unit]`` and ``*factor``."""
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
