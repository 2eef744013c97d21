"""The runway frame ``map``: conversion between ``map`` and geodetic coordinates.

x and y are coordinates of a rigid tangent frame: its plane touches the ground at the threshold, x
points to the far end of the centreline, y to the left. Height and attitude refer to the level
ground below the point instead, as camera and flat runway require; over 3 km the ground falls 0.7 m
below the tangent plane and tilts by 0.03 degrees. True heading is converted to yaw at the point
itself, so the meridian convergence (0.02 degrees over the length of the runway) does not affect the
heading error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import pymap3d

from taxinet_ros.core.place.runway import Runway

Vector = tuple[float, float, float]

_WGS84 = pymap3d.Ellipsoid.from_name('wgs84')
_MAJOR_M, _MINOR_M = _WGS84.semimajor_axis, _WGS84.semiminor_axis
_FOCAL_M = math.sqrt(_MAJOR_M**2 - _MINOR_M**2)
"""Distance of the foci of a meridian from the Earth's centre."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GeodeticPose:
    """A point on WGS84 and a direction there.

    Attributes:
        latitude_rad, longitude_rad: geodetic latitude and longitude [rad], north and east positive.
        altitude_m: height above the ellipsoid [m].
        heading_rad: true heading [rad], clockwise from north.
    """

    latitude_rad: float
    longitude_rad: float
    altitude_m: float
    heading_rad: float


@dataclass(frozen=True, kw_only=True, slots=True)
class MapPose:
    """A point and a direction in ``map`` (signs: :mod:`taxinet_ros.core.types`).

    Attributes:
        x_m, y_m: position along the centreline and to the left of it [m].
        z_m: height above the ground [m].
        yaw_rad: direction [rad], counter-clockwise from the centreline, in -pi..pi.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _hypot(x: float, y: float) -> float:
    """The C library's, as numpy has it; :func:`math.hypot` rounds otherwise."""
    return abs(complex(x, y))


class _Turn(NamedTuple):
    """Sines and cosines of a latitude and a longitude."""

    sin_lat: float
    cos_lat: float
    sin_lon: float
    cos_lon: float

    @classmethod
    def of(cls, latitude_rad: float, longitude_rad: float) -> _Turn:
        return cls(
            math.sin(latitude_rad), math.cos(latitude_rad),
            math.sin(longitude_rad), math.cos(longitude_rad),
        )


def _ecef(turn: _Turn, altitude_m: float) -> Vector:
    """As :func:`pymap3d.geodetic2ecef`, to the bit; that is made for arrays, and slow."""
    sin_lat, cos_lat, sin_lon, cos_lon = turn
    radius_m = _MAJOR_M**2 / _hypot(_MAJOR_M * cos_lat, _MINOR_M * sin_lat)
    out_m = (radius_m + altitude_m) * cos_lat
    return (
        out_m * cos_lon, out_m * sin_lon,
        (radius_m * (_MINOR_M / _MAJOR_M) ** 2 + altitude_m) * sin_lat,
    )


def _geodetic(x: float, y: float, z: float) -> Vector:
    """As :func:`pymap3d.ecef2geodetic`, to the bit, away from the poles: You (2000)."""
    focal2 = _FOCAL_M**2
    beyond = math.sqrt(x * x + y * y + z * z) ** 2 - focal2
    u = math.sqrt(0.5 * beyond + 0.5 * _hypot(beyond, 2 * _FOCAL_M * z))
    out_m, reach_m = _hypot(x, y), _hypot(u, _FOCAL_M)
    beta = math.atan(reach_m / u * z / out_m)
    sin, cos = math.sin(beta), math.cos(beta)
    beta += (_MINOR_M * u - _MAJOR_M * reach_m + focal2) * sin / (
        _MAJOR_M * reach_m / cos - focal2 * cos
    )
    altitude_m = _hypot(z - _MINOR_M * math.sin(beta), out_m - _MAJOR_M * math.cos(beta))
    within = x * x / _MAJOR_M**2 + y * y / _MAJOR_M**2 + z * z / _MINOR_M**2
    return (
        math.atan(_MAJOR_M / _MINOR_M * math.tan(beta)), math.atan2(y, x),
        -altitude_m if within < 1 else altitude_m,
    )


def _north_east(turn: _Turn) -> tuple[Vector, Vector]:
    """Unit vectors north and east at a point, in ECEF."""
    sin_lat, cos_lat, sin_lon, cos_lon = turn
    return (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat), (-sin_lon, cos_lon, 0.0)


class RunwayFrame:
    """A runway's ``map`` frame on the WGS84 ellipsoid.

    Attributes:
        length_m: distance from the threshold to the far end of the centreline [m].
        elevation_m: height of the ground above the ellipsoid [m], constant.
    """

    def __init__(
        self, threshold_deg: tuple[float, float], end_deg: tuple[float, float], elevation_m: float
    ) -> None:
        """Align the frame with a centreline.

        Args:
            threshold_deg: geodetic latitude and longitude of the origin [deg].
            end_deg: latitude and longitude of the far end of the centreline, on the x axis [deg].
            elevation_m: height of the ground above the ellipsoid [m].
        """
        latitude, longitude = (math.radians(angle) for angle in threshold_deg)
        east, north, _ = pymap3d.geodetic2enu(
            *end_deg, elevation_m, *threshold_deg, elevation_m, deg=True
        )
        self.length_m = math.hypot(float(east), float(north))
        self.elevation_m = elevation_m
        turn = _Turn.of(latitude, longitude)
        self._origin = _ecef(turn, elevation_m)
        toward_north, toward_east = _north_east(turn)
        sin, cos = float(east) / self.length_m, float(north) / self.length_m
        self._x = _combine(cos, toward_north, sin, toward_east)
        self._y = _combine(sin, toward_north, -cos, toward_east)
        self._z = (
            self._x[1] * self._y[2] - self._x[2] * self._y[1],
            self._x[2] * self._y[0] - self._x[0] * self._y[2],
            self._x[0] * self._y[1] - self._x[1] * self._y[0],
        )

    def to_map(self, pose: GeodeticPose) -> MapPose:
        """Convert a geodetic pose to ``map``."""
        turn = _Turn.of(pose.latitude_rad, pose.longitude_rad)
        x_m, y_m = self._tangent(_ecef(turn, pose.altitude_m))
        (north_x, north_y), (east_x, east_y) = self._compass(turn)
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        yaw_rad = math.atan2(cos * north_y + sin * east_y, cos * north_x + sin * east_x)
        return MapPose(x_m=x_m, y_m=y_m, z_m=pose.altitude_m - self.elevation_m, yaw_rad=yaw_rad)

    def to_geodetic(self, pose: MapPose) -> GeodeticPose:
        """Convert a pose in ``map`` to a geodetic one; the inverse of :meth:`to_map`."""
        altitude_m = self.elevation_m + pose.z_m
        up_m = pose.z_m
        # The height is above the ground, not above the tangent plane: each iteration corrects the
        # altitude and the lateral error, which shrinks 2000-fold per iteration.
        for _ in range(3):
            latitude, longitude, reached_m = _geodetic(*(
                o + pose.x_m * x + pose.y_m * y + up_m * z
                for o, x, y, z in zip(self._origin, self._x, self._y, self._z, strict=True)
            ))
            up_m += altitude_m - reached_m
        (north_x, north_y), (east_x, east_y) = self._compass(_Turn.of(latitude, longitude))
        cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        heading = math.atan2(north_y * cos - north_x * sin, east_x * sin - east_y * cos)
        return GeodeticPose(
            latitude_rad=latitude,
            longitude_rad=longitude,
            altitude_m=altitude_m,
            heading_rad=heading % math.tau,
        )

    def _tangent(self, point: Vector) -> tuple[float, float]:
        x, y, z = self._origin
        offset = point[0] - x, point[1] - y, point[2] - z
        return _dot(offset, self._x), _dot(offset, self._y)

    def _compass(self, turn: _Turn) -> tuple[tuple[float, float], tuple[float, float]]:
        """Horizontal components in ``map`` of north and east at a point."""
        north, east = _north_east(turn)
        return (
            (_dot(north, self._x), _dot(north, self._y)),
            (_dot(east, self._x), _dot(east, self._y)),
        )


def _combine(a: float, u: Vector, b: float, v: Vector) -> Vector:
    return a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2]


@cache
def runway_frame(runway: Runway) -> RunwayFrame:
    """The ``map`` frame of a runway."""
    return RunwayFrame(runway.threshold_deg, runway.end_deg, runway.elevation_m)
