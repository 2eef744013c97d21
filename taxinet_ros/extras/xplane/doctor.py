"""What of X-Plane works: each step of a run tried by itself, and told in a line."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane import native
from taxinet_ros.extras.xplane.camera import OpenScreen, ViewFromXPlane
from taxinet_ros.extras.xplane.screen import Display, Picture, Screen, check_picture
from taxinet_ros.extras.xplane.setup import XPlaneSetup
from taxinet_ros.extras.xplane.simulator import (
    FLIGHT_TIME,
    FRAME_MARKS,
    HELD,
    NAME,
    SPEED,
    XPlane,
    pose_of,
)
from taxinet_ros.extras.xplane.sky import time_settings, weather_settings
from taxinet_ros.extras.xplane.web import WebApi
from taxinet_ros.extras.xplane.wire import failed
from taxinet_ros.extras.xplane.world import CONTROLS, XPlaneWorld

_FRAMES = 30
_STEPS = 10
_STEP_ASIDE_M = 1.0
_BEACON_S = 3.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """Result of one check.

    Attributes:
        name: of the check.
        words: what was found.
        fine: whether a run can rely on it; None: not checked, or of no consequence.
    """

    name: str
    words: str
    fine: bool | None


@dataclass
class Doctor:
    """Examination of one X-Plane, which it leaves running.

    Attributes:
        setup: where it is.
        scenario: whose start is used.
        open_screen: connects to the display.
    """

    setup: XPlaneSetup
    scenario: Scenario = field(default_factory=lambda: Scenario(duration_s=_STEPS / 10))
    open_screen: OpenScreen = Display
    _xplane: XPlane | None = None
    _screen: Screen | None = None
    _view: ViewFromXPlane | None = None

    def findings(self) -> Iterator[Finding]:
        """Check one thing after the other; the first that fails ends what builds on it."""
        yield self._beacon()
        steps: list[tuple[str, Callable[[], str]]] = [
            ('answer', self._answer), ('aircraft', self._aircraft), ('values', self._values),
            ('frames', self._frames), ('pause', self._pause), ('start', self._start),
            ('screen', self._window), ('view', self._look), ('pictures', self._pictures),
        ]
        fine = True
        try:
            for name, check in steps:
                if not fine:
                    yield Finding(name=name, words='not checked', fine=None)
                    continue
                found = _tried(name, check)
                fine = bool(found.fine)
                yield found
        finally:
            self.close()
        yield _tried('driving', self._drive) if fine else Finding(
            name='driving', words='not checked', fine=None
        )

    def close(self) -> None:
        """Give X-Plane back, running."""
        if self._screen is not None:
            self._screen.close()
        if self._xplane is not None:
            self._xplane.close()
        self._screen = self._xplane = None

    @property
    def _there(self) -> XPlane:
        assert self._xplane is not None
        return self._xplane

    def _beacon(self) -> Finding:
        try:
            found = native.find_simulator(_BEACON_S)
        except InfraError as error:
            return Finding(name='beacon', words=f'{error.detail} (not needed)', fine=None)
        return Finding(
            name='beacon', fine=True, words=f'X-Plane {found.version} on {found.name!r:.40}, '
            f'{found.role}, at {found.host}:{found.port}',
        )

    def _answer(self) -> str:
        self._xplane = XPlane(self.setup)
        return f'{self._there.link.words}, X-Plane {self._there.version}'

    def _aircraft(self) -> str:
        if not isinstance(self._there.link, WebApi):
            return 'not told by the plug-in; look at it'
        self._there.check_aircraft()
        (name,) = self._there.link.read(NAME)
        asked = f', as asked for: {self.setup.aircraft}' if self.setup.aircraft else ''
        return f'{name!r:.80}{asked}'

    def _values(self) -> str:
        names = [
            HELD, SPEED, *CONTROLS,
            *(one.name for one in time_settings(self.scenario, 0.0)),
            *(one.name for one in weather_settings(
                self.scenario, self._there.version, moves=True
            )),
        ]
        troubles = list(filter(None, map(self._there.link.trouble, names)))
        if troubles:
            raise failed(
                InfraKind.PROTOCOL, f'{len(troubles)} of {len(names)} cannot be written: '
                + '; '.join(troubles)
            )
        if not isinstance(self._there.link, WebApi):
            return f'{len(names)} that runs write: not told by the plug-in, seen at the start'
        return f'all {len(names)} that runs write are there'

    def _frames(self) -> str:
        began = time.monotonic()
        self._there.frames(_FRAMES)
        lasted = time.monotonic() - began
        return f'{_FRAMES} seen in {lasted:.2f} s by the clock of this machine'

    def _pause(self) -> str:
        there = self._there
        there.pause(True)
        before, marks = there.number(FLIGHT_TIME), there.numbers(*FRAME_MARKS)
        there.frames(_FRAMES)
        if there.number(FLIGHT_TIME) != before:
            raise failed(InfraKind.SIM, 'its time goes on while it is paused')
        changed = [
            name for name, one, other in zip(
                FRAME_MARKS, marks, there.numbers(*FRAME_MARKS), strict=True
            ) if one != other
        ]
        return f'its time stands still; frames are counted by {", ".join(changed)}'

    def _start(self) -> str:
        there, state = self._there, Aircraft(self.scenario).state
        there.begin(self.scenario, pose_of(self.scenario, state), moves=False)
        now = there.pose().state(self.scenario, 0.0, 0.0)
        return (
            f'placed, settled and read back: {now.x_m:.2f} m along the runway, {now.y_m:+.2f} m '
            f'left, {math.degrees(now.yaw_rad):+.2f} deg, {now.z_m:.2f} m above the ground'
        )

    def _window(self) -> str:
        self._screen = self.open_screen(self.setup.display, self.setup.region_px)
        picture = self._screen.grab()
        height, width = picture.shape[:2]
        return f'{width} x {height} pixels, mean {picture.mean():.0f} of 255'

    def _look(self) -> str:
        assert self._screen is not None
        self._view = ViewFromXPlane(self._there, self.scenario.camera_model, self._screen)
        away_m, away_deg = self._view.away()
        return (
            f'{self._view.fov_deg:.1f} deg wide, {away_m:.3f} m and {away_deg:.3f} deg from where '
            f'the camera {self.scenario.camera_model.name} is mounted'
        )

    def _pictures(self) -> str:
        assert self._screen is not None
        assert self._view is not None
        state = Aircraft(self.scenario).state
        first, again = self._seen(), self._seen()
        check_picture(first, self._view.size_px)
        still = _codes(first, again)
        aside = replace(state, y_m=state.y_m + _STEP_ASIDE_M)
        self._there.place(pose_of(self.scenario, aside))
        for frames in itertools.count(1):
            self._there.frames(1)
            moved = _codes(first, self._screen.grab())
            if moved > max(2 * still, 0.1):
                break
            if frames > _FRAMES:
                raise failed(
                    InfraKind.TIMEOUT, f'{_STEP_ASIDE_M:g} m aside, the picture changed by '
                    f'{moved:.2f} codes in {frames} frames; by {still:.2f} without a move'
                )
        late = '' if frames <= self.setup.frames else f'; set frames to {frames + 1} at least'
        return (
            f'two of one pose differ by {still:.2f} codes on average, {_STEP_ASIDE_M:g} m aside by '
            f'{moved:.2f}, {frames} frames later{late}'
        )

    def _seen(self) -> Picture:
        assert self._screen is not None
        self._there.frames(self.setup.frames)
        return self._screen.grab()

    def _drive(self) -> str:
        world = XPlaneWorld(self.scenario, pictures=False, setup=self.setup)
        try:
            began = world.observe(picture=False).state
            for _ in range(_STEPS):
                world.advance(TaxiCommand(steering_rad=0.1, speed_mps=self.scenario.speed_mps))
            now = world.observe(picture=False).state
        finally:
            world.close()
        turned = math.degrees(now.yaw_rad - began.yaw_rad)
        ahead_m = now.x_m - began.x_m
        words = (
            f'{_STEPS} steps of 0.1 s, at most {world.latest_s * 1000:.0f} ms late: '
            f'{ahead_m:.1f} m ahead at {now.speed_mps:.1f} m/s, turned {turned:+.1f} deg left'
        )
        if turned <= 0:
            raise failed(InfraKind.SIM, f'{words}, steering left; does the nose wheel obey?')
        return words


def _tried(name: str, check: Callable[[], str]) -> Finding:
    try:
        return Finding(name=name, words=check(), fine=True)
    except InfraError as error:
        return Finding(name=name, words=f'{error.kind}: {error.detail}', fine=False)
    except UsageError as error:
        return Finding(name=name, words=str(error), fine=False)


def _codes(one: Picture, other: Picture) -> float:
    if one.shape != other.shape:
        return math.inf
    return float(np.abs(one.astype(np.int16) - other.astype(np.int16)).mean())
