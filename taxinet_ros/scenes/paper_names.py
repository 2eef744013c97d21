"""Parameters under the names of the paper and of X-Plane's datarefs, converted to scenario keys.

The paper's programs (Fig. 3) set X-Plane 11's own quantities: seconds after midnight GMT, a number
for the kind of clouds, rain as a fraction. Its ``rain_percent`` is a fraction too, although here
the same name is a percentage: it is the paper's where ``zulu_time`` or ``cloud_type`` is set.

Any other dataref (``sim/…``) becomes part of the key ``datarefs``, which only X-Plane takes.

``start_percent`` is of ours: a program for any place says by it how far along the aircraft starts.

Sources: CAV 2020 case study, Fig. 3; X-Plane 11 dataref list (``sim/time``, ``sim/weather``).
"""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from taxinet_ros.core.datarefs import PREFIX
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE, typed_place
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CLOUDS,
    DATAREFS,
    DISTANCE,
    PLACE,
    RAIN,
    SKY,
    TIME_OF_DAY,
    TRACK,
    TRAFFIC,
    WIND_DIRECTION,
    WIND_SPEED,
    by_key,
    full_key,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.values import placed_objects

_KNOT_MPS = 1852 / 3600
_DAY_S = 86400.0
_SIGNS = frozenset({'zulu_time', 'cloud_type'})
"""Names that say that ``rain_percent`` is the paper's fraction."""


def local_hours(zulu_s: float, place: str, date: str, track: str = RUNWAY_TRACK) -> float:
    """Local time of day [h] at seconds after midnight GMT.

    Args:
        zulu_s: seconds [s]; the paper's exceed a day for afternoons west of Greenwich.
        place: place, as a user gives it.
        date: ISO date there, which decides on daylight saving time.
        track: without effect.

    Raises:
        UsageError: no such place.
    """
    noon = datetime.datetime.combine(
        datetime.date.fromisoformat(date), datetime.time(12), typed_place(place).runway.zone
    )
    offset = noon.utcoffset()
    assert offset is not None
    return (zulu_s + offset.total_seconds()) % _DAY_S / 3600


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperName:
    """A parameter of the paper, or another that depends on the place.

    Attributes:
        key: scenario key that it sets.
        low, high: its range, both ends included.
        unit: of its values.
        convert: to the key's human unit, given place, date and track.
        whole: whether it is a whole number.
    """

    key: str
    low: float
    high: float
    unit: str
    convert: Callable[[float, str, str, str], Any]
    whole: bool = False

    def check(self, name: str, value: Any) -> float:
        """The value as a number.

        Raises:
            UsageError: it is none, or outside the range.
        """
        number = float(value) if isinstance(value, int | float) else math.nan
        if isinstance(value, bool) or not self.low <= number <= self.high or (
            self.whole and number % 1
        ):
            kind = 'a whole number' if self.whole else 'a number'
            raise UsageError(
                f'{name} is {value!r:.40}; expected {kind} from {self.low:g} to {self.high:g}, '
                f'{self.unit}'
            )
        return number


_TIME = PaperName(
    key=TIME_OF_DAY.key, low=0, high=2 * _DAY_S, unit='in seconds after midnight GMT',
    convert=local_hours,
)
_CLOUDS = PaperName(
    key=SKY.key, low=0, high=len(CLOUDS) - 1, unit=f'for {", ".join(CLOUDS)}', whole=True,
    convert=lambda number, *_: CLOUDS[int(number)],
)
_RAIN = PaperName(
    key=RAIN.key, low=0, high=1, unit='as a fraction',
    convert=lambda fraction, *_: 100 * fraction,
)
_RAIN_PERCENT = RAIN.key
START = 'start_percent'
"""How far along a run starts, of what place and track allow [%]."""
PAPER_NAMES: Mapping[str, PaperName] = MappingProxyType({
    'zulu_time': _TIME,
    'sim/time/zulu_time_sec': _TIME,
    'cloud_type': _CLOUDS,
    'sim/weather/cloud_type[0]': _CLOUDS,
    'sim/weather/rain_percent': _RAIN,
    'sim/weather/wind_speed_kt[0]': PaperName(
        key=WIND_SPEED.key, low=0, high=WIND_SPEED.high / _KNOT_MPS, unit='in knots',
        convert=lambda knots, *_: knots * _KNOT_MPS,
    ),
    'sim/weather/wind_direction_degt[0]': PaperName(
        key=WIND_DIRECTION.key, low=0, high=360, unit='in degrees from true north',
        convert=lambda degrees, *_: degrees,
    ),
    START: PaperName(
        key=DISTANCE.key, low=0, high=100, unit='in percent of the starts that the place allows',
        convert=lambda percent, place, date, track: (
            percent / 100 * typed_place(place).track(track).last_start_m),
    ),
})
"""By name, besides ``rain_percent`` (:func:`paper_name`)."""


def paper_name(name: str, names: Collection[str]) -> PaperName | None:
    """The meaning of a parameter named as in the paper; None if it is a key of ours.

    Args:
        name: of the parameter.
        names: of all parameters of its program.
    """
    if name == _RAIN_PERCENT and not _SIGNS.isdisjoint(names):
        return _RAIN
    return PAPER_NAMES.get(name)


def is_dataref(name: str) -> bool:
    """Whether a parameter is one of X-Plane's variables without a key of ours."""
    return name.startswith(PREFIX) and name not in PAPER_NAMES


def key_of(name: str, names: Collection[str]) -> str:
    """The scenario key that a parameter sets, from either name, with its unit.

    Raises:
        UsageError: it is a control point that cannot be.
    """
    if is_dataref(name):
        return DATAREFS.key
    found = paper_name(name, names)
    return found.key if found else full_key(name)


def our_value(name: str, value: Any, place: str, date: str, track: str) -> Any:
    """The value of the key that a parameter of the paper sets, in its human unit.

    Args:
        name: ``rain_percent``, or one of :data:`PAPER_NAMES`.
        value: of the parameter.
        place: of the scene, as a user gives it.
        date: of the scene, ISO.
        track: of the scene.

    Raises:
        UsageError: it is outside its range.
    """
    meant = PAPER_NAMES.get(name, _RAIN)
    return meant.convert(meant.check(f'param {name}', value), place, date, track)


def our_values(values: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """A scene's values by scenario key, in human units.

    Args:
        values: by key, its short form or name of the paper.
        overrides: by key, which replace drawn ones: of place and date, on which local time depends,
            and of the track, along which a program places others on the ground.

    Raises:
        UsageError: a value is outside its range, or the aircraft's place also says how far along
            it starts.
    """
    values = by_key(values)
    place = str({**values, **overrides}.get(PLACE.key, DEFAULT_PLACE))
    date = str({**values, **overrides}.get('date', Scenario().date))
    track = str({**values, **overrides}.get(TRACK.key, RUNWAY_TRACK))
    if START in values and values.pop(DISTANCE.key):
        raise UsageError(f'param {START} says how far along it starts; place the ego at (x, 0)')
    found: dict[str, Any] = {}
    datarefs = {name: value for name, value in values.items() if is_dataref(name)}
    if datarefs and DATAREFS.key not in overrides:
        found[DATAREFS.key] = json.dumps(datarefs)
    for name, value in values.items():
        if name in datarefs:
            continue
        meant = paper_name(name, values)
        if meant is None:
            found[name] = value
        elif meant.key not in overrides:
            found[meant.key] = our_value(name, value, place, date, track)
    if TRAFFIC.key in found and TRAFFIC.key not in overrides:
        line = typed_place(place).track(track)
        found[TRAFFIC.key] = placed_objects(str(found[TRAFFIC.key]), line)
    return found
