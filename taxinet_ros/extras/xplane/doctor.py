"""What of X-Plane works: each step of a run tried by itself, a line each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane.camera import OpenScreen, ViewFromXPlane
from taxinet_ros.extras.xplane.screen import Display, Picture, Screen, check_picture
from taxinet_ros.extras.xplane.setup import XPlaneSetup
from taxinet_ros.extras.xplane.simulator import FLIGHT_TIME, HELD, NAME, SPEED, XPlane, pose_of
from taxinet_ros.extras.xplane.sky import time_settings, weather_settings
from taxinet_ros.extras.xplane.wire import failed
from taxinet_ros.extras.xplane.world import CONTROLS, XPlaneWorld

_FRAMES = 30
_STEPS = 10
_STEP_ASIDE_M = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """Result of one check.

    Attributes:
        name: of the check.
        words: what was found.
        fine: whether a run can rely on it; None: not checked.
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

    def findings(self) -> Iterator[Finding]:
        """Check one thing after the other; the first that fails ends what builds on it."""
        fine = True
        try:
            for name, check in (
                ('answer', self._answer), ('values', self._values), ('pause', self._pause),
                ('start', self._start), ('view', self._view), ('pictures', self._pictures),
                ('driving', self._drive),
            ):
                found = _tried(name, check) if fine else Finding(
                    name=name, words='not checked', fine=None
                )
                fine = bool(found.fine)
                yield found
        finally:
            self.close()

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

    def _answer(self) -> str:
        there = self._xplane = XPlane(self.setup)
        there.check_aircraft()
        aircraft = f', {there.link.read(NAME)[0]!r:.80}' if self.setup.wire == 'web' else ''
        return f'{there.link.words}, X-Plane {there.version}{aircraft}'

    def _values(self) -> str:
        names = [
            HELD, SPEED, *CONTROLS, *(one.name for one in (
                *time_settings(self.scenario, 0.0),
                *weather_settings(self.scenario, self._there.version, moves=True),
            )),
        ]
        troubles = list(filter(None, map(self._there.link.trouble, names)))
        if troubles:
            raise failed(
                InfraKind.PROTOCOL, f'{len(troubles)} of {len(names)} cannot be written: '
                + '; '.join(troubles)
            )
        unseen = '' if self.setup.wire == 'web' else ', as far as the plug-in tells'
        return f'all {len(names)} datarefs of a run can be written{unseen}'

    def _pause(self) -> str:
        there = self._there
        there.pause(True)
        before = there.number(FLIGHT_TIME)
        there.frames(_FRAMES)
        if there.number(FLIGHT_TIME) != before:
            raise failed(InfraKind.SIM, 'its time goes on while it is paused')
        return f'its time stands still for {_FRAMES} frames'

    def _start(self) -> str:
        there, state = self._there, Aircraft(self.scenario).state
        there.begin(self.scenario, pose_of(self.scenario, state), moves=False)
        now = there.pose().state(self.scenario, 0.0, 0.0)
        return (
            f'placed {now.x_m:.2f} m along the runway, {now.y_m:+.2f} m left, '
            f'{math.degrees(now.yaw_rad):+.2f} deg, {now.z_m:.2f} m above the ground'
        )

    def _view(self) -> str:
        self._screen = self.open_screen(self.setup.display, self.setup.region_px)
        view = ViewFromXPlane(self._there, self.scenario.camera_model, self._screen)
        check_picture(self._screen.grab(), view.size_px)
        away_m, away_deg = view.away()
        return (
            f'{view.fov_deg:.1f} deg wide, {away_m:.3f} m and {away_deg:.3f} deg from where the '
            f'camera {self.scenario.camera_model.name} is mounted'
        )

    def _pictures(self) -> str:
        state = Aircraft(self.scenario).state
        first, again = self._seen(self.setup.frames), self._seen(self.setup.frames)
        still = _codes(first, again)
        aside = replace(state, y_m=state.y_m + _STEP_ASIDE_M)
        self._there.place(pose_of(self.scenario, aside))
        for frames in range(1, _FRAMES + 1):
            moved = _codes(first, self._seen(1))
            if moved > max(2 * still, 0.1):
                late = '' if frames <= self.setup.frames else f'; set frames to {frames + 1}'
                return f'{_STEP_ASIDE_M:g} m aside, they changed after {frames} frames{late}'
        raise failed(
            InfraKind.TIMEOUT, f'{_STEP_ASIDE_M:g} m aside, the picture changed by {moved:.2f} '
            f'codes in {_FRAMES} frames; by {still:.2f} without a move'
        )

    def _seen(self, frames: int) -> Picture:
        assert self._screen is not None
        self._there.frames(frames)
        return self._screen.grab()

    def _drive(self) -> str:
        self.close()
        world = XPlaneWorld(self.scenario, pictures=False, setup=self.setup)
        try:
            began = world.observe(picture=False).state
            for _ in range(_STEPS):
                world.advance(TaxiCommand(steering_rad=0.1, speed_mps=self.scenario.speed_mps))
            now = world.observe(picture=False).state
        finally:
            world.close()
        turned = math.degrees(now.yaw_rad - began.yaw_rad)
        words = (
            f'{now.x_m - began.x_m:.1f} m ahead in {_STEPS} steps of 0.1 s, turned {turned:+.1f} '
            'deg left'
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
    """Mean difference of two pictures, in display codes."""
    if one.shape != other.shape:
        return math.inf
    return float(np.abs(one.astype(np.int16) - other.astype(np.int16)).mean())
