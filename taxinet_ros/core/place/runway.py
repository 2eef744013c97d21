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

FOOT_M = 0.3048
KMWH_HALF_WIDTH_M = 50 * FOOT_M
"""Half width of the paper's runway, the default without a place."""

CATEGORIES = ('visual', 'nonprecision', 'precision')
"""How much is painted (FAA AC 150/5340-1): the better the instrument approach, the more."""

SURFACES = ('asphalt', 'concrete')
SURROUNDINGS = ('dry', 'grass')
"""What grows beside the pavement: dry ground and straw, or green grass."""

_ROOM_AHEAD_M = 442.0
"""Less than this before the far end no run begins: 30 s of taxiing, and a turn off."""
_EDGE_ROOM_M = 0.24
_FIXED_ZONE = re.compile(r'UTC([+-])(\d{2}):(\d{2})')


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """A wider runway that crosses: as the circular demands, it interrupts the lesser one's paint.

    Attributes:
        x_m: where its axis meets the centreline [m].
        yaw_rad: direction of its axis, counter-clockwise from the x axis [rad].
        width_m: of its pavement, without shoulders [m].
        clear_half_m: nothing of ours is painted within this distance of its axis, across it [m].
        paved_m: x between which the pavement goes on beyond our edges, its fillets [m].
    """

    x_m: float
    yaw_rad: float
    width_m: float
    clear_half_m: float
    paved_m: tuple[float, float]

    def clear_x(self, y_m: float) -> tuple[float, float]:
        """Interval of x [m] at lateral position ``y_m`` in which it interrupts our paint."""
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
class Runway:
    """Position and properties of a runway, used by aircraft, camera, sun and pages.

    Attributes:
        threshold_deg: geodetic latitude and longitude of the origin of ``map`` [deg].
        end_deg: the same of the far end of the centreline, on the x axis [deg].
        elevation_m: height of the ground above the ellipsoid [m], the same everywhere.
        bearing_rad: true bearing of the x axis [rad], clockwise from north.
        length_m, width_m: of the pavement between its ends and edges [m].
        time_zone: in which people there read the time of day, by its IANA name, or a fixed offset
            as ``UTC-08:00``.
        designations: painted at the near end and at the far one, such as ``('04', '22')``.
        displaced_m: how far inside the pavement the threshold of each end is [m].
        category: how much is painted, one of :data:`CATEGORIES`.
        edge_stripes: whether stripes mark the edges.
        surface: one of :data:`SURFACES`.
        surroundings: one of :data:`SURROUNDINGS`.
        crossings: in the order of x.
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

    @property
    def half_width_m(self) -> float:
        """Distance of the pavement's edges from the centreline [m]."""
        return self.width_m / 2

    @property
    def last_start_m(self) -> float:
        """Greatest distance past the threshold at which a run may begin [m]."""
        return self.length_m - _ROOM_AHEAD_M

    @property
    def farthest_start_m(self) -> float:
        """Greatest distance from the centreline at which a run may begin [m]."""
        return round(self.half_width_m - _EDGE_ROOM_M, 6)

    @property
    def zone(self) -> datetime.tzinfo:
        """The time zone.

        Raises:
            ValueError: there is none of that name.
        """
        return time_zone(self.time_zone)


def time_zone(name: str) -> datetime.tzinfo:
    """A time zone by its IANA name, ``Pacific/Auckland``, or a fixed one, ``UTC-08:00``.

    Raises:
        ValueError: there is none of that name.
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
