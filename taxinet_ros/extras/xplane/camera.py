"""X-Plane as camera: our aircraft and clock, its picture. ``--camera xplane``.

X-Plane is paused and its aircraft held for the whole run; each frame places it at our state, reads
that back, waits until X-Plane has drawn frames since, and takes the picture. What it shows is its
own airport and its own aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.camera_model import CameraModel, rotation
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CAMERA,
    DATAREFS,
    DATE,
    PLACE,
    RAIN,
    SKY,
    TIME_OF_DAY,
)
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.extras.xplane.setup import XPlaneSetup, chosen_setup
from taxinet_ros.extras.xplane.simulator import POSITION, XPlane, pose_of
from taxinet_ros.extras.xplane.sky import Setting
from taxinet_ros.extras.xplane.wire import failed

Picture = NDArray[np.uint8]
_VIEW = 'sim/graphics/view/'
_MOVED_M, _TURNED_RAD = 0.05, 2e-3
"""Motion after which no picture stays the same to the last bit."""
_MORE_FRAMES = 30
"""Frames to wait for a picture that should have changed."""
_WIDEST_DEG = 140.0
_LEAST_SHARP = 0.75
"""Least resolution of X-Plane's picture, as a share of the camera's."""
_NEAR_M, _NEAR_DEG = 0.05, 0.2
"""Greatest distance of the view from the mounted camera."""
_LEAST_CODES = 2.0
"""Standard deviation of a picture that shows anything, in display codes."""


class Display:
    """A region of an X11 display, as X-Plane has no interface that gives pictures.

    It runs in full screen on a display of its own (a virtual desktop, or Xvfb where OpenGL works
    there), or in a window that nothing covers.
    """

    def __init__(self, display: str, region_px: tuple[int, int, int, int] | None) -> None:
        """Connect.

        Args:
            display: as ``:1``; '' for that of the environment.
            region_px: left, top, width and height; None for the first monitor.
        """
        try:
            import mss
        except ImportError:
            raise UsageError(
                "x-plane: pictures need the package mss; pip install 'taxinet_ros[xplane]'"
            ) from None
        self._words = f'display {display or "of the environment"}'
        try:
            self._mss = mss.MSS(display=display or None)
            monitors = self._mss.monitors
        except Exception as error:  # of X11, by any of its ways
            text = str(error).partition('\n')[0]
            raise failed(InfraKind.NOT_READY, f'{self._words}: {text:.120}') from error
        whole, first = monitors[0], monitors[min(1, len(monitors) - 1)]
        left, top, width, height = region_px or tuple(
            first[key] for key in ('left', 'top', 'width', 'height')
        )
        if left + width > whole['width'] or top + height > whole['height']:
            self.close()
            raise UsageError(
                f'x-plane: region_px {left}, {top}, {width}, {height} is not within the '
                f'{whole["width"]} x {whole["height"]} of {self._words}'
            )
        self._region = {'left': left, 'top': top, 'width': width, 'height': height}

    def grab(self) -> Picture:
        """The picture now, (height, width, 3) uint8 RGB."""
        try:
            shot = self._mss.grab(self._region)
        except Exception as error:  # of X11, by any of its ways
            text = str(error).partition('\n')[0]
            raise failed(InfraKind.DIED, f'{self._words}: {text:.120}') from error
        bgra = np.frombuffer(shot.raw, np.uint8).reshape(shot.height, shot.width, 4)
        return np.ascontiguousarray(bgra[:, :, 2::-1])

    def close(self) -> None:
        """Disconnect."""
        self._mss.close()


OpenScreen = Callable[[str, tuple[int, int, int, int] | None], Display]


def check_picture(picture: Picture, size_px: tuple[int, int]) -> None:
    """Check that a picture is of the size that X-Plane tells of its window, and shows anything."""
    height, width = picture.shape[:2]
    if (width, height) != size_px:
        raise failed(
            InfraKind.SIM, f'the picture has {width} x {height} pixels, the window of X-Plane '
            f'{size_px[0]} x {size_px[1]}; set region_px, or the resolution in X-Plane'
        )
    if picture.std() < _LEAST_CODES:
        raise failed(
            InfraKind.SIM, 'the picture has one colour: is X-Plane minimised, covered or on '
            'another desktop?'
        )


def field_of_view_deg(model: CameraModel, size_px: tuple[int, int]) -> float:
    """Horizontal field of view of a window that contains all of a camera's picture [deg]."""
    width, height = size_px
    x, y = _rays(model)
    reach = max(float(np.abs(x).max()), float(np.abs(y).max()) * width / height)
    return float(np.degrees(2 * np.arctan(reach)))


def developed(picture: Picture, model: CameraModel, fov_deg: float) -> Picture:
    """The picture of a camera out of a window's, through its lens.

    The optical axis meets the middle of the window. A window with more pixels is shrunk before it
    is sampled, each pixel the mean of those it covers.
    """
    import cv2

    height, width = picture.shape[:2]
    focal_px = width / 2 / np.tan(np.radians(fov_deg) / 2)
    shrink = min(1.0, max(model.focal_px) / focal_px)
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if shrink < 1 else picture
    x, y = _rays(model)
    # Pixel centres are integers: the middle of the window is half a pixel before the middle one.
    u = (focal_px * x + width / 2) * size[0] / width - 0.5
    v = (focal_px * y + height / 2) * size[1] / height - 0.5
    return np.asarray(cv2.remap(
        small, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ))


def _rays(model: CameraModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Undistorted directions x/z and y/z of a camera's pixels, (height, width) each."""
    matrix, _, u, v = model.inner_view
    return (u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]


class ViewFromXPlane:
    """View of a mounted camera in a running X-Plane, and its pictures.

    Attributes:
        size_px: width and height of X-Plane's window, as it says.
        fov_deg: horizontal field of view of the window [deg].
    """

    def __init__(self, xplane: XPlane, model: CameraModel, screen: Display) -> None:
        """Select the view and move it to where the camera is mounted, X-Plane paused."""
        self._xplane, self._model, self._screen = xplane, model, screen
        self._last: tuple[AircraftState, Picture] | None = None
        if model.exposure_ev or model.noise_codes:
            raise UsageError(
                f'x-plane: camera {model.name}: exposure_ev and noise_codes have no effect on '
                'pictures of X-Plane; leave them out'
            )
        width, height = xplane.numbers(f'{_VIEW}window_width', f'{_VIEW}window_height')
        self.size_px = round(width), round(height)
        if min(self.size_px) < 1:
            raise failed(InfraKind.SIM, f'its window has {width:g} x {height:g} pixels')
        self.fov_deg = field_of_view_deg(model, self.size_px)
        if not self.fov_deg <= _WIDEST_DEG:
            raise UsageError(
                f'x-plane: camera {model.name} needs a window of {self.fov_deg:.0f} degrees, more '
                f'than {_WIDEST_DEG:g}; make the window less wide, or take another lens'
            )
        focal_px = width / 2 / math.tan(math.radians(self.fov_deg) / 2)
        if focal_px < _LEAST_SHARP * max(model.focal_px):
            least = _LEAST_SHARP * max(model.focal_px) / focal_px
            raise UsageError(
                f'x-plane: its window of {width:g} x {height:g} pixels is too small for '
                f'the camera {model.name}; make it {math.ceil(width * least)} x '
                f'{math.ceil(height * least)} or larger'
            )
        xplane.link.command(xplane.setup.view)
        for one in self._settings():
            xplane.link.write(one.name, one.value)
        xplane.frames(xplane.setup.frames)
        for one in self._settings():
            xplane.check(one)
        self._check_view()

    def _check_view(self) -> None:
        """Check that the view is where the camera is mounted, and as wide as its picture."""
        away_m, away_deg = self.away()
        if not (away_m <= _NEAR_M and away_deg <= _NEAR_DEG):
            raise failed(
                InfraKind.SIM, f'the view is {away_m:.2f} m and {away_deg:.1f} deg from where the '
                f'camera {self._model.name} is mounted: is {self._xplane.setup.view} the view?'
            )
        self._xplane.check(self._settings()[-1])

    def away(self) -> tuple[float, float]:
        """Distance of X-Plane's view from the mounted camera, as X-Plane tells both [m, deg].

        Local coordinates are x east, y up, z south, at the origin of X-Plane's frame.
        """
        names = ('local_x', 'local_y', 'local_z', 'psi', 'theta', 'phi')
        x, y, z, psi, theta, phi = self._xplane.numbers(*(f'{POSITION}{one}' for one in names))
        names = ('x', 'y', 'z', 'heading', 'pitch', 'roll')
        *seen, heading, pitch, roll = self._xplane.numbers(*(f'{_VIEW}view_{one}' for one in names))
        model = self._model
        body = _attitude(psi, theta, phi)
        east, north, up = body @ np.array(model.offset_m)
        wanted = body @ rotation(model.roll_rad, model.pitch_rad, model.yaw_rad)
        between = _attitude(heading, pitch, roll).T @ wanted
        turn = math.acos(min(1.0, max(-1.0, (float(np.trace(between)) - 1) / 2)))
        return math.dist(seen, (x + east, y + up, z - north)), math.degrees(turn)

    def _settings(self) -> list[Setting]:
        ahead_m, left_m, up_m = self._model.offset_m
        values = {
            'pilots_head_x': -left_m, 'pilots_head_y': up_m, 'pilots_head_z': -ahead_m,
            'pilots_head_psi': -math.degrees(self._model.yaw_rad),
            'pilots_head_the': -math.degrees(self._model.pitch_rad),
            'pilots_head_phi': math.degrees(self._model.roll_rad),
            'field_of_view_deg': self.fov_deg,
        }
        return [Setting(f'{_VIEW}{name}', value, within=0.01) for name, value in values.items()]

    def take(self, state: AircraftState, time_s: float) -> NDArray[np.uint8]:
        """Picture of the aircraft at a state, where X-Plane has it; its time [s] stands still."""
        picture = self._taken(state)
        # After the picture: whoever presses a key may do it any time before.
        self._xplane.check_still(time_s)
        self._check_view()
        self._xplane.check_next()
        return picture

    def _taken(self, state: AircraftState) -> NDArray[np.uint8]:
        self._xplane.frames(self._xplane.setup.frames)
        for _ in range(_MORE_FRAMES):
            picture = self._screen.grab()
            check_picture(picture, self.size_px)
            if self._is_new(state, picture):
                self._last = state, picture
                return developed(picture, self._model, self.fov_deg)
            self._xplane.frames(1)
        raise failed(
            InfraKind.TIMEOUT, f'its picture stayed the same for {_MORE_FRAMES} frames, though the '
            'aircraft moved: does the region show X-Plane, uncovered?'
        )

    def _is_new(self, state: AircraftState, picture: Picture) -> bool:
        if self._last is None:
            return True
        before, shown = self._last
        moved = (
            math.hypot(state.x_m - before.x_m, state.y_m - before.y_m) > _MOVED_M
            or abs(state.yaw_rad - before.yaw_rad) > _TURNED_RAD
        )
        return not moved or not np.array_equal(picture, shown)


def _attitude(heading_deg: float, pitch_deg: float, roll_deg: float) -> NDArray[np.float64]:
    """Rotation matrix from body axes (x forward, y left, z up) to east, north, up."""
    return rotation(
        math.radians(roll_deg), -math.radians(pitch_deg), math.radians(90.0 - heading_deg)
    )


class XPlaneCamera:
    """The camera of one run."""

    reproducible = False
    shows = (
        SKY.key, RAIN.key, TIME_OF_DAY.key, DATE.key, CAMERA.key, PLACE.key, DATAREFS.key,
    )

    def __init__(
        self, scenario: Scenario, setup: XPlaneSetup | None = None,
        open_screen: OpenScreen = Display,
    ) -> None:
        """Prepare X-Plane for a run: pause, hold, place, light and weather, settle, view."""
        setup = setup or chosen_setup()
        self._scenario = scenario
        self._xplane = XPlane(setup)
        self._screen: Display | None = None
        try:
            self._screen = open_screen(setup.display, setup.region_px)
            start = pose_of(scenario, Aircraft(scenario).state)
            self._xplane.begin(scenario, start, moves=False)
            self._view = ViewFromXPlane(self._xplane, scenario.camera_model, self._screen)
            self._time_s = self._xplane.time_s()
        except BaseException:
            self.close()
            raise

    def render(self, state: AircraftState, stamp_ns: int) -> NDArray[np.uint8]:
        """Picture of a state; the light is that of the scenario for the whole run."""
        self._xplane.place(pose_of(self._scenario, state))
        return self._view.take(state, self._time_s)

    def close(self) -> None:
        """Give X-Plane back, running."""
        if self._screen is not None:
            self._screen.close()
        self._xplane.close()
