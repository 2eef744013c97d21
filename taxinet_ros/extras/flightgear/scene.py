"""A scenario in FlightGear: where its runway lies, where the eye is, and what the weather is.

FlightGear's earth is an ellipsoid with terrain: its runways slope, and lie a metre or two beside
the surveys of others. So the ``map`` frame is laid on the runway that FlightGear has, and the
aircraft stands on FlightGear's ground, tilted as the ground is there. What is in the picture is
then where our camera model projects it.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pymap3d
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import pose
from taxinet_ros.core.camera.light import scenario_light
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.runway_frame import MapPose, RunwayFrame
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, quaternion_product
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.extras.flightgear.client import FlightGear, failed

Floats = NDArray[np.float64]

_STEP_M, _BESIDE_M, _BEYOND_M = 40.0, 240.0, 120.0
"""Spacing and reach of the grid of ground heights, beside the centreline and beyond the ends."""
_SLOPE_OVER_M = 8.0
"""Distance over which the ground under the wheels is taken as a plane."""
_MOST_AWAY_M = 30.0
"""Surveys of one runway end differ by less."""
_POINTS_AT_ONCE = 250
_OUT = '/taxinet/out'


class Ground:
    """FlightGear's runway and the heights of its ground, for one place."""

    def __init__(self, flightgear: FlightGear, place: Place) -> None:
        """Ask for both, in about ten frames."""
        runway = place.runway
        ends = _nearest_runway(flightgear, place)
        self.moved_m = max(
            _distance_m(ours, theirs)
            for ours, theirs in zip((runway.threshold_deg, runway.end_deg), ends, strict=True)
        )
        if not self.moved_m <= _MOST_AWAY_M:
            raise UsageError(
                f'camera flightgear: its nearest runway to that of {place.name} is '
                f'{self.moved_m:.0f} m away; take a place that FlightGear has, such as bikf_10'
            )
        level = RunwayFrame(*ends, 0.0)
        self._along = np.arange(-_BEYOND_M, level.length_m + _BEYOND_M + _STEP_M, _STEP_M)
        self._aside = np.arange(-_BESIDE_M, _BESIDE_M + _STEP_M, _STEP_M)
        points = [
            level.to_geodetic(MapPose(x_m=float(x), y_m=float(y), z_m=0.0, yaw_rad=0.0))
            for x in self._along for y in self._aside
        ]
        heights = list(_heights(flightgear, [
            (math.degrees(one.latitude_rad), math.degrees(one.longitude_rad)) for one in points
        ]))
        if not all(map(math.isfinite, heights)):
            raise UsageError(
                f'camera flightgear: it has no terrain at {place.name}; start it there, and see '
                'that its scenery is installed'
            )
        self._heights = np.array(heights).reshape(len(self._along), len(self._aside))
        self.frame = RunwayFrame(*ends, float(self.height(0.0, 0.0)))

    def height(self, x_m: float, y_m: float) -> float:
        """Height of the ground above the ellipsoid [m], at the grid's edge outside of it."""
        (row, down), (column, across) = (
            _cell(axis, value) for axis, value in ((self._along, x_m), (self._aside, y_m))
        )
        near, far = self._heights[row, column:column + 2], self._heights[row + 1, column:column + 2]
        weights = np.array([1 - across, across])
        return float((1 - down) * (near @ weights) + down * (far @ weights))

    def tilt(self, x_m: float, y_m: float) -> Floats:
        """Rotation (3, 3) in ``map`` from level ground to the ground at a point."""
        half = _SLOPE_OVER_M / 2
        rise_x = (self.height(x_m + half, y_m) - self.height(x_m - half, y_m)) / _SLOPE_OVER_M
        rise_y = (self.height(x_m, y_m + half) - self.height(x_m, y_m - half)) / _SLOPE_OVER_M
        ahead = np.array([1.0, 0.0, rise_x]) / math.hypot(1.0, rise_x)
        up = np.array([-rise_x, -rise_y, 1.0]) / math.sqrt(1.0 + rise_x**2 + rise_y**2)
        return np.stack([ahead, np.cross(up, ahead), up], axis=1)


def _cell(axis: Floats, value: float) -> tuple[int, float]:
    """Index of the cell of a value along an axis, and its place in it, 0..1."""
    at = float(np.clip((value - axis[0]) / _STEP_M, 0.0, len(axis) - 1 - 1e-9))
    return int(at), at - int(at)


def _distance_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    east, north, _ = pymap3d.geodetic2enu(*one, 0.0, *other, 0.0)
    return math.hypot(float(east), float(north))


def _nearest_runway(
    flightgear: FlightGear, place: Place
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends of FlightGear's runway that is nearest to a place's, latitude and longitude [deg]."""
    asked = f'"{place.icao}"' if place.icao else ', '.join(map(repr, place.runway.threshold_deg))
    flightgear.run(
        f'var found = airportinfo({asked}); var out = "";'
        'if (found != nil) foreach (var name; keys(found.runways)) {'
        ' var one = found.runways[name];'
        ' out ~= sprintf("%s %.9f %.9f;", name, one.lat, one.lon); }'
        f'setprop("{_OUT}", out);'
    )
    listed = [words.split() for words in str(flightgear.value(_OUT)).split(';') if words]
    try:
        ends = [(float(latitude), float(longitude)) for _, latitude, longitude in listed]
    except ValueError:
        raise failed(InfraKind.PROTOCOL, f'its runways are {str(listed)[:60]!r}') from None
    if len(ends) < 2:
        raise UsageError(
            f'camera flightgear: it has no runway of {place.icao or place.name}; take a place that '
            'it has, such as bikf_10'
        )
    first, second = (
        min(ends, key=lambda end: _distance_m(end, wanted))
        for wanted in (place.runway.threshold_deg, place.runway.end_deg)
    )
    return first, second


def _heights(
    flightgear: FlightGear, points: Sequence[tuple[float, float]]
) -> Iterator[float]:
    """Ground heights [m] at points; infinite where there is no solid ground."""
    for start in range(0, len(points), _POINTS_AT_ONCE):
        some = points[start:start + _POINTS_AT_ONCE]
        listed = ', '.join(f'[{latitude!r}, {longitude!r}]' for latitude, longitude in some)
        flightgear.run(
            f'var out = ""; foreach (var point; [{listed}]) {{'
            ' var info = geodinfo(point[0], point[1]);'
            ' var solid = info != nil and info[1] != nil and info[1].solid;'
            ' out ~= solid ? sprintf("%.4f ", info[0]) : "inf "; }'
            f'setprop("{_OUT}", out);'
        )
        heights = str(flightgear.value(_OUT)).split()
        if len(heights) != len(some):
            raise failed(
                InfraKind.PROTOCOL, f'{len(heights)} ground heights for {len(some)} points'
            )
        try:
            yield from map(float, heights)
        except ValueError as error:
            raise failed(InfraKind.PROTOCOL, f'its ground heights: {error}') from None


@dataclass(frozen=True, kw_only=True, slots=True)
class Eye:
    """Position and attitude of FlightGear's view.

    Attributes:
        latitude_deg, longitude_deg: geodetic [deg].
        altitude_m: above the ellipsoid [m].
        heading_deg, pitch_deg, roll_deg: aeronautical angles [deg]: clockwise from north, nose up,
            right side down.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    heading_deg: float
    pitch_deg: float
    roll_deg: float

    @property
    def ecef_m(self) -> Floats:
        """Earth-centred position, (3,) [m]."""
        return np.array(
            pymap3d.geodetic2ecef(self.latitude_deg, self.longitude_deg, self.altitude_m)
        )

    @property
    def attitude(self) -> Floats:
        """Quaternion (w, x, y, z) of the view, as in ``/sim/current-view/raw-orientation``."""
        half_longitude = math.radians(self.longitude_deg) / 2
        half_down = -math.pi / 4 - math.radians(self.latitude_deg) / 2
        sin_a, cos_a = math.sin(half_longitude), math.cos(half_longitude)
        sin_b, cos_b = math.sin(half_down), math.cos(half_down)
        north = -sin_a * sin_b, cos_a * sin_b, sin_a * cos_b, cos_a * cos_b
        turned = north
        for axis, angle_deg in ((2, self.heading_deg), (1, self.pitch_deg), (0, self.roll_deg)):
            half = math.radians(angle_deg) / 2
            turn = [0.0, 0.0, 0.0, math.cos(half)]
            turn[axis] = math.sin(half)
            turned = quaternion_product(turned, (turn[0], turn[1], turn[2], turn[3]))
        x, y, z, w = quaternion_product(turned, (-0.5, -0.5, 0.5, 0.5))
        return np.array([w, x, y, z])


def eye_of(state: AircraftState, camera: CameraModel, ground: Ground) -> Eye:
    """View of a camera on an aircraft that stands on FlightGear's ground."""
    _, to_optical, at = pose(state, camera)
    tilt = ground.tilt(state.x_m, state.y_m)
    moved = tilt @ (at - [state.x_m, state.y_m, 0.0])
    height_m = ground.height(state.x_m, state.y_m) + float(moved[2])
    there = ground.frame.to_geodetic(MapPose(
        x_m=state.x_m + float(moved[0]), y_m=state.y_m + float(moved[1]),
        z_m=height_m - ground.frame.elevation_m, yaw_rad=0.0,
    ))
    sin, cos = math.sin(there.heading_rad), math.cos(there.heading_rad)
    # Columns: x, y and z of map as north, east and down at the point.
    compass = np.array([[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]])
    right, down, forward = (compass @ tilt @ axis for axis in to_optical)
    return Eye(
        latitude_deg=math.degrees(there.latitude_rad),
        longitude_deg=math.degrees(there.longitude_rad), altitude_m=there.altitude_m,
        heading_deg=math.degrees(math.atan2(forward[1], forward[0])) % 360.0,
        pitch_deg=math.degrees(math.asin(max(-1.0, min(1.0, -float(forward[2]))))),
        roll_deg=math.degrees(math.atan2(right[2], down[2])),
    )


FEET_M = 0.3048
_COVERAGES = {
    # Kind: coverage of the layer, its base and thickness [ft]. Flat layers: 3-D clouds are off.
    'clear': ('clear', 3000.0, 1000.0), 'cirrus': ('cirrus', 26000.0, 1000.0),
    'scattered': ('scattered', 4000.0, 1500.0), 'broken': ('broken', 3500.0, 2000.0),
    'overcast': ('overcast', 3000.0, 2500.0), 'stratus': ('overcast', 1000.0, 3000.0),
}
_LAYERS = 5
_HAZE = 3.0
"""Meteorological visibility (contrast of 5 %) in distances that reduce contrast to 1/e."""
_FARTHEST_M = 16_000.0
"""Visibility at most [m]: terrain farther away costs time, and is at the horizon."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Weather:
    """Light and weather of a scenario, as FlightGear's properties.

    Attributes:
        time_s: time [s since 1970, UTC].
        sun_angle_rad: the sun's angle from the zenith, as our sun has it.
        visibility_m: meteorological visibility [m].
        coverage: of the cloud layer, in FlightGear's words.
        base_ft, thickness_ft: of the cloud layer [ft].
        rain: intensity, 0..1.
    """

    time_s: int
    sun_angle_rad: float
    visibility_m: float
    coverage: str
    base_ft: float
    thickness_ft: float
    rain: float

    @property
    def moment(self) -> str:
        """The time as FlightGear tells it."""
        return f'{datetime.datetime.fromtimestamp(self.time_s, datetime.UTC):%Y-%m-%dT%H:%M:%S}'

    @property
    def settings(self) -> dict[str, str | float]:
        """Properties and their values."""
        layers = {
            f'/environment/clouds/layer[{number}]/coverage': 'clear' if number else self.coverage
            for number in range(_LAYERS)
        }
        return {
            # Its own weather and a warped clock would move these on.
            '/environment/params/metar-updates-environment': 0, '/environment/config/enabled': 0,
            '/sim/time/warp': 0, '/sim/time/warp-easing': 0,
            '/sim/freeze/master': 1, '/sim/freeze/clock': 1,
            '/sim/time/cur-time-override': self.time_s,
            '/environment/visibility-m': self.visibility_m,
            '/environment/clouds/layer[0]/elevation-ft': self.base_ft,
            '/environment/clouds/layer[0]/thickness-ft': self.thickness_ft,
            **layers,
            '/sim/rendering/precipitation-enable': 1 if self.rain else 0,
            '/environment/rain-norm': self.rain, '/environment/metar/rain-norm': self.rain,
        }


def weather_of(scenario: Scenario) -> Weather:
    """Light and weather of a scenario."""
    light = scenario_light(scenario)
    day = datetime.datetime.fromisoformat(scenario.date).replace(tzinfo=scenario.runway.zone)
    moment = day + datetime.timedelta(seconds=scenario.time_of_day_s)
    coverage, base_ft, thickness_ft = _COVERAGES[scenario.clouds]
    return Weather(
        time_s=round(moment.timestamp()), sun_angle_rad=math.pi / 2 - light.sun_elevation_rad,
        visibility_m=min(_HAZE * light.visibility_m, _FARTHEST_M), coverage=coverage,
        base_ft=base_ft, thickness_ft=thickness_ft, rain=scenario.rain_fraction,
    )


@dataclass(frozen=True, kw_only=True)
class Lens:
    """How a camera's picture is taken from FlightGear's, which is centred and has square pixels.

    Attributes:
        width_px, height_px: size of FlightGear's window.
        focal_px: focal length of its view in pixels.
        columns, rows: where each of the camera's pixels is in it, (height, width) each; pixel
            centres are integers.
    """

    width_px: int
    height_px: int
    focal_px: float
    columns: NDArray[np.float32]
    rows: NDArray[np.float32]

    @cached_property
    def field_of_view_deg(self) -> float:
        """FlightGear's horizontal field of view [deg]."""
        return math.degrees(2 * math.atan(self.width_px / 2 / self.focal_px))


_LEAST_SHARP = 0.75
"""Least resolution of FlightGear's view, as a share of the camera's."""


@lru_cache(maxsize=4)
def lens_of(camera: CameraModel, width_px: int, height_px: int) -> Lens:
    """The widest view's lens that a window can hold."""
    rows, columns = np.mgrid[0:camera.height_px, 0:camera.width_px].astype(np.float64)
    x, y = camera.straight_rays(columns, rows)
    # Half a pixel is left at the edge, for interpolation.
    focal = min(
        (size / 2 - 0.5) / float(np.abs(reach).max())
        for size, reach in ((width_px, x), (height_px, y))
    )
    if focal < _LEAST_SHARP * max(camera.focal_px):
        least = _LEAST_SHARP * max(camera.focal_px) / focal
        raise UsageError(
            f'camera flightgear: its window of {width_px} x {height_px} is too small for camera '
            f'{camera.name}; start it with a size of {math.ceil(width_px * least)}x'
            f'{math.ceil(height_px * least)}'
        )
    return Lens(
        width_px=width_px, height_px=height_px, focal_px=focal,
        columns=np.asarray(width_px / 2 - 0.5 + focal * x, np.float32),
        rows=np.asarray(height_px / 2 - 0.5 + focal * y, np.float32),
    )
