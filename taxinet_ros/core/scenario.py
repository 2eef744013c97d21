"""One test case: the point in the paper's six-dimensional feature space, and what belongs to it.

Inside the program a scenario is in SI units; people write metres, degrees, percent and hours (in
Scenic programs, on the command line, in tables). :func:`scenario_from_human` is the one door.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError

CLOUDS = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
"""The six cloud kinds, from clear sky to dark stratus, in X-Plane 11's order."""

RAIN_CLOUDS = ('broken', 'overcast', 'stratus')
"""The cloud kinds that rain may fall from."""

AIRCRAFT = ('caravan', 'c172p')

RANGES: dict[str, tuple[float, float, str]] = {
    'cross_track_m': (-15.0, 15.0, 'm left of the centreline (on the runway)'),
    'distance_m': (0.0, 2600.0, 'm past the threshold'),
    'heading_rad': (-math.pi / 2, math.pi / 2, 'rad, nose left positive'),
    'rain': (0.0, 1.0, 'as a fraction'),
    'time_of_day_s': (0.0, 86400.0, 's after local midnight'),
    'duration_s': (0.1, 600.0, 's'),
}
"""Least and greatest value of each number of a scenario, both allowed, with the unit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """Initial condition and environment of one run, validated on construction.

    Attributes:
        cross_track_m: start cross-track error [m], left positive.
        distance_m: start distance past the threshold along the runway [m].
        heading_rad: start heading error [rad], nose left positive.
        clouds: one of :data:`CLOUDS`.
        rain: intensity as a fraction 0..1; more than 0 only under :data:`RAIN_CLOUDS`.
        time_of_day_s: local standard time (UTC-8) after midnight [s].
        date: ISO date of the sun's position; near an equinox 6-18 h is daylight.
        shadows: whether the aircraft casts a shadow (the paper's confirmation experiment).
        crossing: whether the other runway is there that crosses this one near 1,450 m; without it
            pavement and paint go on as elsewhere.
        aircraft: flight-dynamics model, one of :data:`AIRCRAFT`.
        duration_s: length of the run [s], a multiple of the control period.

    Raises:
        UsageError: a value is out of range, not finite, or of an unknown word.
    """

    cross_track_m: float = 0.0
    distance_m: float = 400.0
    heading_rad: float = 0.0
    clouds: str = 'clear'
    rain: float = 0.0
    time_of_day_s: float = 12 * 3600.0
    date: str = '2020-03-20'
    shadows: bool = True
    crossing: bool = True
    aircraft: str = 'caravan'
    duration_s: float = 30.0

    def __post_init__(self) -> None:
        for name, (low, high, unit) in RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f'scenario: {name} is {value:g}, outside {low:g}..{high:g} {unit}')
        if self.clouds not in CLOUDS:
            raise UsageError(f'scenario: clouds is {self.clouds!r}, not one of {", ".join(CLOUDS)}')
        if self.rain > 0 and self.clouds not in RAIN_CLOUDS:
            kinds = '/'.join(RAIN_CLOUDS)
            raise UsageError(f'scenario: rain needs clouds {kinds}, got {self.clouds!r}')
        if self.aircraft not in AIRCRAFT:
            kinds = ', '.join(AIRCRAFT)
            raise UsageError(f'scenario: aircraft is {self.aircraft!r}, not one of {kinds}')
        try:
            datetime.date.fromisoformat(self.date)
        except ValueError as error:
            raise UsageError(f'scenario: date is {self.date!r}, not YYYY-MM-DD') from error

    @property
    def duration_ns(self) -> int:
        """Length of the run in integer nanoseconds."""
        return round(self.duration_s * NS_PER_S)

    def to_human(self) -> dict[str, Any]:
        """The scenario in the units people read; the inverse of :func:`scenario_from_human`."""
        values = asdict(self)
        return {key: to_human(values[field]) for key, (field, _, to_human) in _HUMAN.items()}


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool):
        raise UsageError(f'scenario: {key} needs a number, got {value!r}')
    try:
        return float(value)
    except (TypeError, ValueError):
        raise UsageError(f'scenario: {key} needs a number, got {value!r}') from None


def _switch(key: str, value: Any) -> bool:
    words = {'true': True, 'on': True, '1': True, 'false': False, 'off': False, '0': False}
    if isinstance(value, bool):
        return value
    if str(value).lower() not in words:
        raise UsageError(f'scenario: {key} needs on or off, got {value!r}')
    return words[str(value).lower()]


def _scaled(factor: float) -> tuple[Any, Any]:
    # Rounding to a nano-unit makes degrees -> radians -> degrees give back what was typed.
    return (lambda key, v: _number(key, v) * factor), (lambda v: round(v / factor, 9))


def _same(convert: Any) -> tuple[Any, Any]:
    return convert, lambda v: v


_TEXT = _same(lambda key, value: str(value))
_HUMAN: dict[str, tuple[str, Any, Any]] = {
    'cross_track': ('cross_track_m', *_scaled(1.0)),
    'distance': ('distance_m', *_scaled(1.0)),
    'heading': ('heading_rad', *_scaled(math.pi / 180)),
    'clouds': ('clouds', *_TEXT),
    'rain': ('rain', *_scaled(0.01)),
    'time_of_day': ('time_of_day_s', *_scaled(3600.0)),
    'date': ('date', *_TEXT),
    'shadows': ('shadows', *_same(_switch)),
    'crossing': ('crossing', *_same(_switch)),
    'aircraft': ('aircraft', *_TEXT),
    'duration': ('duration_s', *_scaled(1.0)),
}
HUMAN_KEYS = tuple(_HUMAN)
"""Scenario keys as people type them.

m, m, degrees, word, percent, hours, date, on or off twice, word, s."""


def scenario_from_human(values: Mapping[str, Any]) -> Scenario:
    """Build a scenario from the units people type (m, degrees, percent, hours).

    Raises:
        UsageError: an unknown key (the known ones are listed) or a bad value.
    """
    unknown = [key for key in values if key not in _HUMAN]
    if unknown:
        raise UsageError(f'scenario: unknown key {unknown[0]!r}; known: {", ".join(HUMAN_KEYS)}')
    fields = {_HUMAN[key][0]: _HUMAN[key][1](key, value) for key, value in values.items()}
    return Scenario(**fields)
