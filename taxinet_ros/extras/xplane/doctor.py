"""What of X-Plane works: each step of a run tried by itself, a line each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace

import numpy as np

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.xplane.camera import (
    Display,
    OpenScreen,
    Picture,
    ViewFromXPlane,
    check_picture,
)
from taxinet_ros.extras.xplane.setup import XPlaneSetup
from taxinet_ros.extras.xplane.simulator import FLIGHT_TIME, HELD, NAME, SPEED, XPlane, pose_of
from taxinet_ros.extras.xplane.sky import time_settings, weather_settings
from taxinet_ros.extras.xplane.wire import failed
from taxinet_ros.extras.xplane.world import CONTROLS, XPlaneWorld

_CHECKS = ('answer', 'values', 'pause', 'start', 'view', 'pictures', 'driving')
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


def findings(setup: XPlaneSetup, open_screen: OpenScreen = Display) -> Iterator[Finding]:
    """Check one thing after the other; the first that fails ends what builds on it."""
    with ExitStack() as opened:
        lines, fine = _lines(setup, open_screen, opened), True
        for name in _CHECKS:
            if not fine:
                yield Finding(name=name, words='not checked', fine=None)
                continue
            try:
                words = next(lines)
            except InfraError as error:
                words, fine = f'{error.kind}: {error.detail}', False
            except UsageError as error:
                words, fine = str(error), False
            yield Finding(name=name, words=words, fine=fine)


def _lines(setup: XPlaneSetup, open_screen: OpenScreen, opened: ExitStack) -> Iterator[str]:
    """What each of the checks finds; raises where one fails."""
    scenario = Scenario(duration_s=_STEPS / 10)
    there = opened.enter_context(closing(XPlane(setup)))
    there.check_aircraft()
    aircraft = f', {there.link.read(NAME)[0]!r:.80}' if setup.wire == 'web' else ''
    yield f'{there.link.words}, X-Plane {there.version}{aircraft}'
    yield _values(there, scenario)
    yield _pause(there)
    there.begin(scenario, pose_of(scenario, Aircraft(scenario).state), moves=False)
    now = there.pose().state(scenario, 0.0, 0.0)
    yield (
        f'placed {now.x_m:.2f} m along the runway, {now.y_m:+.2f} m left, '
        f'{math.degrees(now.yaw_rad):+.2f} deg, {now.z_m:.2f} m above the ground'
    )
    screen = opened.enter_context(closing(open_screen(setup.display, setup.region_px)))
    view = ViewFromXPlane(there, scenario.camera_model, screen)
    check_picture(screen.grab(), view.size_px)
    away_m, away_deg = view.away()
    yield (
        f'{view.fov_deg:.1f} deg wide, {away_m:.3f} m and {away_deg:.3f} deg from where the '
        f'camera {scenario.camera_model.name} is mounted'
    )
    yield _pictures(there, scenario, screen)
    opened.close()
    yield _drive(setup, scenario)


def _values(there: XPlane, scenario: Scenario) -> str:
    names = [
        HELD, SPEED, *CONTROLS, *(one.name for one in (
            *time_settings(scenario, 0.0), *weather_settings(scenario, there.version, moves=True),
        )),
    ]
    troubles = list(filter(None, map(there.link.trouble, names)))
    if troubles:
        raise failed(
            InfraKind.PROTOCOL, f'{len(troubles)} of {len(names)} cannot be written: '
            + '; '.join(troubles)
        )
    unseen = '' if there.setup.wire == 'web' else ', as far as the plug-in tells'
    return f'all {len(names)} datarefs of a run can be written{unseen}'


def _pause(there: XPlane) -> str:
    there.pause(True)
    before = there.number(FLIGHT_TIME)
    there.frames(_FRAMES)
    if there.number(FLIGHT_TIME) != before:
        raise failed(InfraKind.SIM, 'its time goes on while it is paused')
    return f'its time stands still for {_FRAMES} frames'


def _pictures(there: XPlane, scenario: Scenario, screen: Display) -> str:
    def after(frames: int) -> Picture:
        there.frames(frames)
        return screen.grab()

    usual = there.setup.frames
    first, again = after(usual), after(usual)
    still, state = _codes(first, again), Aircraft(scenario).state
    there.place(pose_of(scenario, replace(state, y_m=state.y_m + _STEP_ASIDE_M)))
    for frames in range(1, _FRAMES + 1):
        moved = _codes(first, after(1))
        if moved > max(2 * still, 0.1):
            late = '' if frames <= usual else f'; set frames to {frames + 1}'
            return f'{_STEP_ASIDE_M:g} m aside, they changed after {frames} frames{late}'
    raise failed(
        InfraKind.TIMEOUT, f'{_STEP_ASIDE_M:g} m aside, the picture changed by {moved:.2f} codes '
        f'in {_FRAMES} frames; by {still:.2f} without a move'
    )


def _drive(setup: XPlaneSetup, scenario: Scenario) -> str:
    with closing(XPlaneWorld(scenario, pictures=False, setup=setup)) as world:
        began = world.observe(picture=False).state
        for _ in range(_STEPS):
            world.advance(TaxiCommand(steering_rad=0.1, speed_mps=scenario.speed_mps))
        now = world.observe(picture=False).state
    turned = math.degrees(now.yaw_rad - began.yaw_rad)
    words = (
        f'{now.x_m - began.x_m:.1f} m ahead in {_STEPS} steps of 0.1 s, turned {turned:+.1f} deg '
        'left'
    )
    if turned <= 0:
        raise failed(InfraKind.SIM, f'{words}, steering left; does the nose wheel obey?')
    return words


def _codes(one: Picture, other: Picture) -> float:
    """Mean difference of two pictures, in display codes."""
    if one.shape != other.shape:
        return math.inf
    return float(np.abs(one.astype(np.int16) - other.astype(np.int16)).mean())
