"""The camera ``flightgear``: pose and weather in, a frame that shows them out.

FlightGear draws on its own clock, so a picture that arrives after a request need not show it. One
is accepted when FlightGear's own view, told by a script in the frame loop, is where it was put, in
the time and weather that were set; when frames have been drawn since; when two pictures after that
are equal (with rain, whose streaks move: alike); and when nobody has set anything meanwhile, as the
script tells, or the second picture, which may be of a later frame than what the script told. The
simulation is paused, so nothing else moves.
"""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import SensorNoise
from taxinet_ros.core.camera.light import display_code, linear_exposure
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import InfraKind
from taxinet_ros.extras.flightgear.client import (
    FlightGear,
    check_instance,
    failed,
    flightgear_address,
)
from taxinet_ros.extras.flightgear.scene import (
    FEET_M,
    Eye,
    Ground,
    Lens,
    Weather,
    eye_of,
    lens_of,
    weather_of,
)

_VIEW, _REQUEST = '/taxinet/told', '/taxinet/request'
_RATE = '/sim/frame-rate-throttle-hz'
_BUSY_HZ, _IDLE_HZ, _IDLE_FRAMES = 0, 5, 600
"""Limit of FlightGear's frame rate while it is in use (none), and so many frames later."""
_HOOK = f"""
if (!contains(globals, "taxinet_told")) {{
  globals.taxinet_since = 0;
  globals.taxinet_last = "";
  globals.taxinet_told = func {{
    var request = getprop("{_REQUEST}") or "none";
    globals.taxinet_since += 1;
    if (request != globals.taxinet_last) {{
      globals.taxinet_last = request;
      globals.taxinet_since = 0;
    }}
    if (globals.taxinet_since == {_IDLE_FRAMES}) setprop("{_RATE}", {_IDLE_HZ});
    setprop("{_VIEW}", sprintf("%s %d %.4f %.4f %.4f %.6f %.6f %.6f %.6f %.5f %s %.5f %.1f %s %.4f",
      request, getprop("/sim/rendering/sim-frame-count") or 0,
      getprop("/sim/current-view/viewer-x-m"), getprop("/sim/current-view/viewer-y-m"),
      getprop("/sim/current-view/viewer-z-m"), getprop("/sim/current-view/raw-orientation[0]"),
      getprop("/sim/current-view/raw-orientation[1]"),
      getprop("/sim/current-view/raw-orientation[2]"),
      getprop("/sim/current-view/raw-orientation[3]"),
      getprop("/sim/current-view/field-of-view"), getprop("/sim/time/gmt"),
      getprop("/sim/time/sun-angle-rad"), getprop("/environment/visibility-m"),
      getprop("/environment/clouds/layer[0]/coverage"), getprop("/environment/rain-norm") or 0));
    settimer(globals.taxinet_told, 0, 1);
  }};
  globals.taxinet_told();
}}
"""
_NEAR_M, _NEAR_TURN, _NEAR_DEG = 0.005, 1e-4, 0.002
"""Tolerances of position [m], the attitude's quaternion (0.01 degrees) and the view [deg]."""
_NEAR_SUN_RAD = 0.05
"""Tolerance of the sun's angle: FlightGear's sun is where it should be about 14 minutes later."""
_POLLS, _PICTURES = 200, 12
"""How often its view is asked for, and how many pictures are compared, for one of ours."""
_EQUAL_CODES, _ALIKE_CODES, _ALIKE_IN_RAIN = 2, 0.02, 4.0
"""Largest difference of pixels that are equal, mean difference of equal pictures, and in rain."""
_numbers = itertools.count()


@dataclass(frozen=True, slots=True)
class Shown:
    """What FlightGear shows, as its frame loop tells."""

    request: str
    frame: int
    ecef_m: NDArray[np.float64]
    attitude: NDArray[np.float64]
    field_of_view_deg: float
    moment: str
    sun_angle_rad: float
    visibility_m: float
    coverage: str
    rain: float


class FlightGearCamera:
    """FlightGear's view through the scenario's camera; a class that makes cameras of runs."""

    reproducible = False
    shows = frozenset({
        'clouds', 'rain_percent', 'time_of_day_h', 'date', 'camera', 'place', 'aircraft',
    })

    def __init__(self, scenario: Scenario, *, model: CameraModel | None = None) -> None:
        """Connect, and find the scenario's runway in FlightGear's terrain."""
        self._model = model = model or scenario.camera_model
        self._noise = SensorNoise(scenario, model)
        # FlightGear has no exposure: the camera's is applied to its codes as light.
        light = linear_exposure(np.minimum(np.arange(256.0), 254.5)) * 2.0**model.exposure_ev
        self._exposed = np.rint(display_code(light)).astype(np.uint8)
        self._weather = weather_of(scenario)
        self._flightgear = _connection(flightgear_address())
        with self._flightgear.alone():
            if not self._flightgear.ready:
                check_instance(self._flightgear)
                self._flightgear.run(_HOOK)
                self._flightgear.ready = True
            self.ground = _ground(self._flightgear, scenario)
        width_px, height_px = self._flightgear.window_px
        self.lens = lens_of(model, width_px, height_px)

    def render(self, state: AircraftState, stamp_ns: int) -> NDArray[np.uint8]:
        """Take the picture of a state."""
        eye = eye_of(state, self._model, self.ground)
        with self._flightgear.alone():
            taken = self._taken(eye)
        if taken.shape != (self.lens.height_px, self.lens.width_px, 3):
            raise failed(
                InfraKind.SIM, f'its window has been resized to {taken.shape[1]} x {taken.shape[0]}'
            )
        seen = cv2.remap(taken, self.lens.columns, self.lens.rows, cv2.INTER_LINEAR)
        if self._model.exposure_ev:
            seen = cv2.LUT(seen, self._exposed)
        picture: NDArray[np.uint8] = np.asarray(seen, np.uint8)
        if self._model.noise_codes:
            self._noise.add_to(picture, stamp_ns)
        return picture

    @property
    def sun_elevation_deg(self) -> float:
        """Elevation of FlightGear's sun as its frame loop tells it [deg]."""
        return 90.0 - math.degrees(_parse_shown(self._flightgear.value(_VIEW)).sun_angle_rad)

    def close(self) -> None:
        """Nothing: the connection serves the next run of this process."""

    def _taken(self, eye: Eye) -> NDArray[np.uint8]:
        """The whole window's picture from an eye, when it shows it."""
        request = f'{os.getpid()}-{next(_numbers)}'
        self._flightgear.run(_script(request, eye, self._weather, self.lens))
        view, before = self._view_and_picture()
        shown = self._await_view(view, request, eye)
        for _ in range(_PICTURES):
            # Asked for since the view is confirmed, beside the view's confirmation once more.
            after, now = self._view_and_picture()
            if after.request != request or self._unlike(after, eye):
                raise failed(InfraKind.INTRUDER, 'somebody has set it while a picture was taken')
            moved_on = after.frame > shown.frame
            if moved_on and now.shape == before.shape and self._alike(before, now):
                if now.min() == now.max():
                    raise failed(InfraKind.SIM, 'its picture has one colour: does it draw at all?')
                return now
            before = now
        if not moved_on:
            raise failed(InfraKind.SIM, f'it draws no frames: still frame {shown.frame}')
        raise failed(
            InfraKind.SIM, f'its picture goes on changing, {_PICTURES} times, where it is put'
        )

    def _await_view(self, view: Shown, request: str, eye: Eye) -> Shown:
        """Wait until FlightGear's view is where it was put."""
        why = ''
        for _ in range(_POLLS):
            why = 'it does not take up what was set' if view.request != request else (
                self._unlike(view, eye)
            )
            if not why:
                return view
            view = _parse_shown(self._flightgear.value(_VIEW))
        raise failed(InfraKind.SIM, f'not the requested view after {_POLLS} looks: {why}')

    def _view_and_picture(self) -> tuple[Shown, NDArray[np.uint8]]:
        """What its frame loop tells and its picture, asked for in one frame."""
        value, picture = self._flightgear.value_and_picture(_VIEW)
        return _parse_shown(value), picture

    def _unlike(self, view: Shown, eye: Eye) -> str:
        """What FlightGear shows other than requested; '' for nothing."""
        away_m = float(np.linalg.norm(view.ecef_m - eye.ecef_m))
        if not away_m <= _NEAR_M:
            return f'the eye is {away_m:.3f} m away'
        turned = min(float(np.linalg.norm(view.attitude + sign * eye.attitude)) for sign in (1, -1))
        if not turned <= _NEAR_TURN:
            return 'the eye is turned otherwise'
        if not abs(view.field_of_view_deg - self.lens.field_of_view_deg) <= _NEAR_DEG:
            return f'the field of view is {view.field_of_view_deg:g} degrees'
        wanted = self._weather
        if view.moment != wanted.moment:
            return f'its clock is at {view.moment}, not {wanted.moment}'
        if not abs(view.sun_angle_rad - wanted.sun_angle_rad) <= _NEAR_SUN_RAD:
            return f'its sun is {np.degrees(view.sun_angle_rad):.1f} degrees from the zenith, ' \
                f'ours {np.degrees(wanted.sun_angle_rad):.1f}'
        if not abs(view.visibility_m - wanted.visibility_m) <= 1.0:
            return f'its visibility is {view.visibility_m:g} m'
        if (view.coverage, view.rain) != (wanted.coverage, round(wanted.rain, 4)):
            return f'its clouds are {view.coverage}, its rain {view.rain:g}'
        return ''

    def _alike(self, one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
        away = np.abs(one.astype(np.int16) - other)
        if self._weather.rain:
            return float(away.mean()) <= _ALIKE_IN_RAIN
        return int(away.max()) <= _EQUAL_CODES and float(away.mean()) <= _ALIKE_CODES


def _parse_shown(value: object) -> Shown:
    words = str(value).split()
    try:
        request, frame, *numbers = words[:10]
        x, y, z, *turn, view = map(float, numbers)
        moment, sun, visibility, coverage, rain = words[10:]
        return Shown(
            request, int(frame), np.array([x, y, z]), np.array(turn), view, moment,
            float(sun), float(visibility), coverage, float(rain),
        )
    except ValueError:
        raise failed(
            InfraKind.PROTOCOL, f'its frame loop told {" ".join(words)[:60]!r}'
        ) from None


def _script(request: str, eye: Eye, weather: Weather, lens: Lens) -> str:
    """Script that sets everything in one frame; what is as wanted is left alone."""
    wanted: dict[str, str | float] = {
        **weather.settings,
        '/position/latitude-deg': eye.latitude_deg, '/position/longitude-deg': eye.longitude_deg,
        '/position/altitude-ft': eye.altitude_m / FEET_M,
        '/orientation/heading-deg': eye.heading_deg, '/orientation/pitch-deg': eye.pitch_deg,
        '/orientation/roll-deg': eye.roll_deg,
        '/sim/current-view/field-of-view': lens.field_of_view_deg,
        **{f'/sim/current-view/{axis}-offset-m': 0.0 for axis in 'xyz'},
        **{f'/sim/current-view/{angle}-offset-deg': 0.0 for angle in ('heading', 'pitch', 'roll')},
        _RATE: _BUSY_HZ, _REQUEST: request,
    }
    pairs = ', '.join(
        f'["{path}", {f"{value!r}" if not isinstance(value, str) else _quoted(value)}]'
        for path, value in wanted.items()
    )
    return (
        f'foreach (var pair; [{pairs}]) if (getprop(pair[0]) != pair[1]) '
        'setprop(pair[0], pair[1]);'
    )


def _quoted(text: str) -> str:
    return f'"{text}"'


@lru_cache(maxsize=4)
def _connection(address: tuple[str, int]) -> FlightGear:
    """The connection of this process, which lasts longer than a run."""
    return FlightGear(address)


_GROUNDS: dict[tuple[str, str], Ground] = {}


def _ground(flightgear: FlightGear, scenario: Scenario) -> Ground:
    """The ground of the scenario's place, asked for once per process."""
    key = flightgear.where, scenario.place
    if key not in _GROUNDS:
        _GROUNDS[key] = Ground(flightgear, find_place(scenario.place))
    return _GROUNDS[key]
