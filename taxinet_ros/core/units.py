"""Units of numbers that people type: values of a scenario, and numbers in formulas.

In formulas numbers are compared in SI units: metres, seconds, radians. A number with a unit is
converted by the parser, so formulas, their texts and their robustness are in SI only. A number
without a unit takes the unit of the quantity that it is compared with. The dimensions of an
expression are checked against those of the signals.

A value of a scenario without a unit is in that of its key (:func:`typed_number`).
"""

from __future__ import annotations

import decimal
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

Dimension = tuple[int, int, int]
"""Exponents of length, time and angle; angle is a dimension, so degrees never match metres."""

SHARE: Dimension = (0, 0, 0)
LENGTH: Dimension = (1, 0, 0)
TIME: Dimension = (0, 1, 0)
ANGLE: Dimension = (0, 0, 1)
SPEED: Dimension = (1, -1, 0)
TURN_RATE: Dimension = (0, -1, 1)
TURN_PER_LENGTH: Dimension = (-1, 0, 1)

_NAMES = {
    SHARE: 'a share', LENGTH: 'a length', TIME: 'a time', ANGLE: 'an angle', SPEED: 'a speed',
    TURN_RATE: 'a turn rate', TURN_PER_LENGTH: 'an angle per length',
}
DIMENSIONS = tuple(_NAMES)
"""The named dimensions."""

_EXACT = decimal.Context(prec=60)
_LONGEST_NUMBER = 60


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit and its factor to SI; the factor is None for degrees, where it is irrational."""

    dimension: Dimension
    factor: decimal.Decimal | None


def _units() -> dict[str, Unit]:
    listed: dict[Dimension, dict[str, str]] = {
        LENGTH: {'m': '1', 'km': '1000', 'cm': '0.01', 'mm': '0.001', 'ft': '0.3048',
                 'nmi': '1852'},
        TIME: {'s': '1', 'ms': '0.001', 'us': '0.000001', 'ns': '0.000000001', 'min': '60',
               'h': '3600'},
        ANGLE: {'rad': '1', 'mrad': '0.001', 'deg': '', '°': ''},
        SPEED: {'m/s': '1'},
        TURN_RATE: {'rad/s': '1', 'deg/s': '', '°/s': ''},
        TURN_PER_LENGTH: {'rad/m': '1', 'deg/m': '', '°/m': ''},
        SHARE: {'%': '0.01'},
    }  # fmt: skip
    found = {
        name: Unit(dimension, decimal.Decimal(factor) if factor else None)
        for dimension, units in listed.items() for name, factor in units.items()
    }
    for name, metres in {'km/h': 1000, 'kt': 1852}.items():
        found[name] = Unit(SPEED, _EXACT.divide(decimal.Decimal(metres), decimal.Decimal(3600)))
    return found


UNITS: Mapping[str, Unit] = MappingProxyType(_units())
"""Every unit allowed behind a number, the SI unit of each dimension first."""

MEANT = {
    'degree': 'deg', 'degrees': 'deg', 'radian': 'rad', 'radians': 'rad', 'meter': 'm',
    'meters': 'm', 'metre': 'm', 'metres': 'm', 'feet': 'ft', 'sec': 's', 'second': 's',
    'seconds': 's', 'minutes': 'min', 'hour': 'h', 'hours': 'h', 'kn': 'kt', 'kts': 'kt',
    'knots': 'kt', 'kmh': 'km/h', 'kph': 'km/h', 'mps': 'm/s', 'percent': '%', 'M': 'm',
    'Deg': 'deg', 'DEG': 'deg',
}  # fmt: skip
"""Unsupported spellings, and the unit that was probably meant."""


_WITH_UNIT = re.compile(
    r'\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?)\s*([a-zA-Z°%/]{1,20})\s*'
)


def typed_number(text: str, unit: str) -> float | None:
    """Read the text of a number with a unit.

    Args:
        text: such as ``1.2 km`` or ``30%``.
        unit: the unit to convert it to.

    Returns:
        The number, the very one of the text if that has this unit; None if the text is no number
        with a unit.

    Raises:
        ValueError: unknown unit, or one of another dimension; its text says what is allowed.
    """
    found = _WITH_UNIT.fullmatch(text) if len(text) <= _LONGEST_NUMBER else None
    if found is None:
        return None
    number, given = found.groups()
    if given == unit:
        return float(number)
    here, wanted = UNITS.get(given), UNITS.get(unit)
    if wanted is None:
        raise ValueError(f'a number in {unit}' if unit else 'a number without a unit')
    if here is None or here.dimension != wanted.dimension:
        raise ValueError(f'a number in {_units_of(wanted.dimension)}')
    if here.factor is None or wanted.factor is None:
        if here.factor is wanted.factor:
            return float(number)
        return in_si(number, given) if here.factor is None else math.degrees(in_si(number, given))
    try:
        product = _EXACT.multiply(_EXACT.create_decimal(number), here.factor)
        return float(_EXACT.divide(product, wanted.factor))
    except decimal.Overflow:
        return math.inf


def _units_of(dimension: Dimension) -> str:
    return ', '.join(name for name, unit in UNITS.items() if unit.dimension == dimension)


def in_si(number: str, unit: str) -> float:
    """Convert the text of a number with a unit to SI, rounded once; infinite if too large."""
    factor = UNITS[unit].factor
    if factor is None:
        return math.radians(float(number))
    try:
        return float(_EXACT.multiply(_EXACT.create_decimal(number), factor))
    except decimal.Overflow:
        return math.inf


def dimension_of(unit: str) -> Dimension | None:
    """Dimension of a signal's unit; None for an unknown unit."""
    if unit == '1':
        return SHARE
    return UNITS[unit].dimension if unit in UNITS else None


def si_unit(dimension: Dimension | None) -> str:
    """SI unit in which values of a dimension are compared; '' if it has no name here."""
    names = (name for name, unit in UNITS.items() if unit.dimension == dimension)
    return '' if dimension in (None, SHARE) else next(names, '')


def kind_words(dimension: Dimension) -> str:
    """A dimension in words, with its units: ``a length (m, km, …)``."""
    units = _units_of(dimension)
    return f'{_NAMES.get(dimension, "another kind of number")}{f" ({units})" if units else ""}'


class Quantity(NamedTuple):
    """Dimension of an expression, as far as known.

    Attributes:
        dimension: None if unknown: a signal without unit, or a sum of different dimensions.
        pure: it consists of numbers without units, which are compatible with everything.
        product: it is a product or quotient; radians in it may have become part of a length.
    """

    dimension: Dimension | None = None
    pure: bool = False
    product: bool = False

    def agrees(self, other: Quantity) -> bool:
        """Whether the two can be compared or added, as far as known."""
        one, two = self.dimension, other.dimension
        if one is None or two is None or one == two:
            return True
        return (self.product or other.product) and one[:2] == two[:2]


PURE = Quantity(pure=True)


def added(one: Quantity, two: Quantity) -> Quantity:
    """Quantity of a sum, difference, minimum or maximum."""
    if one.dimension is None or two.dimension is None:
        known = one.dimension is not None or (two.pure and not one.pure)
        return one if known else two
    if not one.agrees(two):
        return Quantity()
    return two if one.product else one


def multiplied(one: Quantity, two: Quantity, power: int) -> Quantity:
    """Quantity of a product (``power`` 1) or of a quotient (-1)."""
    if two.pure:
        return one
    if two.dimension is None or (one.dimension is None and not one.pure):
        return Quantity()
    length, time, angle = (
        a + power * b for a, b in zip(one.dimension or SHARE, two.dimension, strict=True)
    )
    return Quantity((length, time, angle), product=not one.pure or power < 0)


def rooted(one: Quantity) -> Quantity:
    """Quantity of a square root."""
    if one.dimension is None:
        return one
    if any(exponent % 2 for exponent in one.dimension):
        return Quantity()
    length, time, angle = (exponent // 2 for exponent in one.dimension)
    return Quantity((length, time, angle), product=one.product)


def value_words(value: float, dimension: Dimension | None) -> str:
    """A value with its SI unit and, in parentheses, in the customary unit (deg, kt, km)."""
    unit = si_unit(dimension)
    number = f'{value:.6g}{f" {unit}" if unit else ""}'
    if dimension in (ANGLE, TURN_RATE, TURN_PER_LENGTH):
        return f'{number} ({math.degrees(value):.4g} deg{unit.removeprefix("rad")})'
    if dimension == SHARE:
        return f'{100 * value:.6g} %'
    if dimension == SPEED:
        return f'{number} ({value * 3600 / 1852:.4g} kt)'
    return f'{number} ({value / 1000:.6g} km)' if unit == 'm' and abs(value) >= 1000 else number
