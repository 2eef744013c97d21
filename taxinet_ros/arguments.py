"""Argument checks of public functions and values: a one-line error names the parameter.

A public function declares the kind of each parameter where it is defined::

    @takes(path=PATH, runs=WHOLE)
    def falsify(path, *, runs=100): ...
"""

from __future__ import annotations

import functools
import inspect
import math
import numbers
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, NamedTuple, ParamSpec, TypeVar

from taxinet_ros.errors import UsageError

P = ParamSpec('P')
T = TypeVar('T')
_TOLD_CHARACTERS = 40


def can_be_called(function: Callable[..., Any], *values: str, **named: Any) -> bool:
    """Whether a function can be called with such arguments; True if it does not say.

    Args:
        function: any callable, a user's too.
        values: the arguments by position; only their number counts.
        named: the arguments by name.
    """
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(*values, **named)
    except TypeError:
        return False
    return True


def has_parameter(function: Callable[..., Any], name: str) -> bool:
    """Whether a function, a user's too, says that it has a parameter of this name."""
    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


class Kind(NamedTuple):
    """Kind of value that a parameter accepts.

    Attributes:
        words: description, as in "expected ...".
        accepts: whether a value is of this kind; may raise for other values.
    """

    words: str
    accepts: Callable[[Any], bool]

    def __or__(self, other: Kind) -> Kind:
        """Union of two kinds."""
        return Kind(
            f'{self.words} or {other.words}', lambda value: self.has(value) or other.has(value)
        )

    def has(self, value: Any) -> bool:
        """Whether a value is of this kind; never raises."""
        try:
            return bool(self.accepts(value))
        except Exception:  # a user's object may raise anything
            return False

    def check(self, name: str, value: Any) -> None:
        """Reject a value of another kind.

        Raises:
            UsageError: names the parameter, the value and the expected kind.
        """
        if not self.has(value):
            raise UsageError(f'{name}: got {told(value)}; expected {self.words}')


def told(value: object) -> str:
    """Describe a value briefly: plain values as they are, others by type."""
    if isinstance(value, type):
        return f'the class {value.__name__}'
    if value is None or isinstance(value, str | bytes | bool | int | float):
        try:
            text = repr(value)
        except ValueError:  # Python does not print integers of more than some thousand digits
            text = 'a number of thousands of digits'
        return text if len(text) <= _TOLD_CHARACTERS else f'{text[:_TOLD_CHARACTERS]}…'
    if isinstance(value, list | tuple | dict | set) and not value:
        return f'an empty {type(value).__name__}'
    return f'a {type(value).__name__}'


def is_number(value: Any) -> bool:
    """Whether it is a real number that fits a float, NaN included; not True or False."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def a(words: str, *types: type) -> Kind:
    """Kind of values of the given types."""
    return Kind(words, lambda value: isinstance(value, types))


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ('bool_', 'bool')


def _is_path(value: Any) -> bool:
    text = os.fspath(value)
    return isinstance(text, str) and bool(text) and '\0' not in text


def _is_table(value: Any) -> bool:
    pandas = sys.modules.get('pandas')  # any table means that pandas is imported
    return pandas is not None and isinstance(value, pandas.DataFrame)


NONE = Kind('None', lambda value: value is None)
TEXT = a('a text', str)
WORD = Kind('a word', lambda value: isinstance(value, str) and bool(value.strip()))
FLAG = Kind('True or False', _is_flag)
NUMBER = Kind('a number', is_number)
FINITE = Kind('a finite number', lambda value: is_number(value) and math.isfinite(value))
WHOLE = Kind(
    'a whole number',
    lambda value: isinstance(value, numbers.Integral) and not isinstance(value, bool),
)
FROM_0 = Kind('a whole number from 0', lambda value: WHOLE.has(value) and value >= 0)
FROM_1 = Kind('a whole number from 1', lambda value: WHOLE.has(value) and value >= 1)
PATH = Kind('a path', _is_path)
TABLE = Kind('a pandas DataFrame', _is_table)
TEXTS = TEXT | Kind('a list of texts', lambda value: isinstance(value, list | tuple) and all(
    isinstance(one, str) for one in value
))
MAPPING = Kind('a mapping of names to values', lambda value: isinstance(value, Mapping) and all(
    isinstance(name, str) for name in value
))
_OF_FIELDS: dict[str, tuple[Kind, type]] = {
    'float': (NUMBER, float), 'bool': (FLAG, bool), 'str': (TEXT, str),
}


def takes(**kinds: Kind) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function to check the kinds of its arguments, given for each parameter."""
    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        assert set(kinds) <= set(signature.parameters), 'a parameter is gone'

        @functools.wraps(function)
        def call(*args: P.args, **given: P.kwargs) -> T:
            try:
                arguments = signature.bind(*args, **given).arguments
            except TypeError:  # which Python words best
                return function(*args, **given)
            for parameter, kind in kinds.items():
                if parameter in arguments:
                    kind.check(parameter, arguments[parameter])
            return function(*args, **given)

        return call

    return decorate


def check_fields(value: Any) -> None:
    """Check the fields of a dataclass against their annotations; NaN is a number.

    Numbers, booleans and strings of other libraries become Python's own: a NumPy number would
    impose its precision on later arithmetic.

    Raises:
        UsageError: names the class and the field.
    """
    of_class: Any = type(value)
    for name, kind, plain in _kinds_of(of_class):
        given = getattr(value, name)
        kind.check(f'{of_class.__name__}: {name}', given)
        if type(given) is not plain:
            object.__setattr__(value, name, plain(given))


@functools.cache
def _kinds_of(kind: Any) -> tuple[tuple[str, Kind, type], ...]:
    return tuple(
        (field.name, *_OF_FIELDS[str(field.type)]) for field in fields(kind)
        if str(field.type) in _OF_FIELDS
    )
