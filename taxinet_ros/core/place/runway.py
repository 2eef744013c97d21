"""Runway description: position, size, surface, markings and crossing runways.

Coordinates are ``map`` coordinates in metres (see :mod:`taxinet_ros.core.types`): the origin is the
near end of the pavement, x runs along the centreline.
"""

from __future__ import annotations

import datetime
import math
import re
from dataclasses import dataclass
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from taxinet_ros.core.types import FOOT_M

KMWH_HALF_WIDTH_M = 50 * FOOT_M
"""Half width of the paper's runway, the default without a place."""

CATEGORIES = ('visual', 'nonprecision', 'precision')
"""Marking categories (FAA AC 150/5340-1), by type of instrument approach."""

SURFACES = ('asphalt', 'concrete', 'grooved')
"""The last is asphalt with grooves across: darker, and without cracks sealed with tar."""
SURROUNDINGS = ('dry', 'grass', 'sand')
"""Ground beside the pavement: dry ground with straw, green grass, or light sand."""

_ROOM_AHEAD_M = 442.0
"""Minimum distance of a start to the far end [m]: 30 s of taxiing, and a turn-off."""
_EDGE_ROOM_M = 0.24
_FIXED_ZONE = re.compile(r'UTC([+-])(\d{2}):(\d{2})')


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """A wider crossing runway, which interrupts this runway's paint (FAA AC 150/5340-1).

    Attributes:
        x_m: position of the intersection of its axis with the centreline [m].
        yaw_rad: direction of its axis, counter-clockwise from the x axis [rad].
        width_m: width of its pavement, without shoulders [m].
        clear_half_m: half width of the strip along its axis without paint of this runway [m].
        paved_m: range of x in which pavement continues beyond this runway's edges (fillets) [m].
    """

    x_m: float
    yaw_rad: float
    width_m: float
    clear_half_m: float
    paved_m: tuple[float, float]

    def clear_x(self, y_m: float) -> tuple[float, float]:
        """Interval of x [m] at lateral position ``y_m`` in which this runway's paint ends."""
        sin, cos = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        middle = self.x_m + y_m * cos / sin
        reach = self.clear_half_m / abs(sin)
        return middle - reach, middle + reach

    def strip(self, reach_m: float) -> tuple[tuple[float, float], ...]:
        """Corners (x, y) [m] of its pavement, up to ``reach_m`` from the centreline each way."""
        sin, cos, half = math.sin(self.yaw_rad), math.cos(self.yaw_rad), self.width_m / 2
        return tuple(
            (self.x_m + along * cos - across * sin, along * sin + across * cos)
            for along, across in ((-reach_m, -half), (reach_m, -half), (reach_m, half),
                                  (-reach_m, half))
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Condition:
    """Age and wear of a runway's surface; the default is that of KMWH 04.

    Attributes:
        lightness: factor on the brightness of the pavement without paint.
        mottle: strength of stains, joints and cracks.
        rubber: amount of tyre rubber.
        wear: wear of the paint, 0 = fresh.
        edge_wear: wear of the edge stripes, 0 = fresh.
        ground: factor on the brightness of the ground beside the pavement.
        seed: a whole number, of the pattern of all these.
    """

    lightness: float = 1.0
    mottle: float = 1.0
    rubber: float = 1.0
    wear: float = 1.0
    edge_wear: float = 0.0
    ground: float = 1.0
    seed: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Runway:
    """Position and properties of a runway, used by aircraft, camera, sun and pages.

    Attributes:
        threshold_deg: geodetic latitude and longitude of the origin of ``map`` [deg].
        end_deg: latitude and longitude of the far end of the centreline, on the x axis [deg].
        elevation_m: height of the ground above the ellipsoid [m], constant.
        bearing_rad: true bearing of the x axis [rad], clockwise from north.
        length_m, width_m: length and width of the pavement [m].
        time_zone: local time zone: an IANA name, or a fixed offset such as ``UTC-08:00``.
        designations: designations of the near and the far end, such as ``('04', '22')``.
        displaced_m: displacement of the threshold at each end [m].
        category: marking category, one of :data:`CATEGORIES`.
        edge_stripes: whether there are edge stripes.
        surface: one of :data:`SURFACES`.
        surroundings: one of :data:`SURROUNDINGS`.
        crossings: crossing runways, ordered by x.
        shoulder_m: width of the paved shoulder beyond each edge [m].
        condition: age and wear of the surface.
    """

    threshold_deg: tuple[float, float]
    end_deg: tuple[float, float]
    elevation_m: float
    bearing_rad: float
    length_m: float
    width_m: float
    time_zone: str
    designations: tuple[str, str]
    displaced_m: tuple[float, float] = (0.0, 0.0)
    category: str = 'precision'
    edge_stripes: bool = True
    surface: str = 'asphalt'
    surroundings: str = 'dry'
    crossings: tuple[Crossing, ...] = ()
    shoulder_m: float = 0.0
    condition: Condition = Condition()

    @property
    def half_width_m(self) -> float:
        """Distance of the pavement's edges from the centreline [m]."""
        return self.width_m / 2

    @property
    def last_start_m(self) -> float:
        """Maximum start distance past the threshold [m]."""
        return self.length_m - _ROOM_AHEAD_M

    @property
    def farthest_start_m(self) -> float:
        """Maximum start distance from the centreline [m]."""
        return round(self.half_width_m - _EDGE_ROOM_M, 6)

    @property
    def zone(self) -> datetime.tzinfo:
        """The time zone.

        Raises:
            ValueError: unknown name.
        """
        return time_zone(self.time_zone)


def time_zone(name: str) -> datetime.tzinfo:
    """Time zone of an IANA name, ``Pacific/Auckland``, or of a fixed offset, ``UTC-08:00``.

    Raises:
        ValueError: unknown name.
    """
    if fixed := _FIXED_ZONE.fullmatch(name):
        offset = datetime.timedelta(hours=int(fixed[2]), minutes=int(fixed[3]))
        return datetime.timezone(offset if fixed[1] == '+' else -offset)
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, OSError, ValueError):
        raise ValueError(
            f'time zone {name!r:.60} is unknown; write an IANA name, or an offset as UTC-08:00'
        ) from None
