"""A running X-Plane: paused, placed, read back, settled and released, by its own clock.

Nothing is believed because it was sent: every value that decides a result is read back. Waiting is
counted in frames and seconds of the simulator; the clock of the wall only limits it.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import itertools
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import InfraError, InfraKind, UsageError, warn_once
from taxinet_ros.extras.xplane.connect import XPlaneConnect
from taxinet_ros.extras.xplane.setup import XPlaneSetup
from taxinet_ros.extras.xplane.sky import (
    REGENERATE,
    Setting,
    major,
    time_settings,
    weather_settings,
)
from taxinet_ros.extras.xplane.wire import Value, address_of, failed

_T = TypeVar('_T')
POSITION = 'sim/flightmodel/position/'
FRAME_MARKS = ('sim/time/total_running_time_sec', 'sim/time/framerate_period')
"""A frame changes one of them at least, paused or not: the time that X-Plane has been up, and how
long its last frame took."""
FLIGHT_TIME = 'sim/time/total_flight_time_sec'
"""Time of the simulation; it stands still while paused."""
PAUSED, SPEED = 'sim/time/paused', 'sim/time/sim_speed'
HELD = 'sim/operation/override/override_planepath[0]'
NAME = 'sim/aircraft/view/acf_ui_name'
VERSION = 'sim/version/xplane_internal_version'
HEIGHT = f'{POSITION}y_agl'
_WHERE = tuple(
    f'{POSITION}{name}' for name in ('latitude', 'longitude', 'theta', 'phi', 'true_psi')
)

NEAR_M, NEAR_DEG = 0.02, 0.05
"""Greatest differences of a pose that is read back."""
_MOST_TRIES = 8
MOST_AWAY_M = 30_000.0
_SETTLE_FRAMES = 2
_RELEASES = 3
_MERIDIAN_M = 111_132.0
"""Length of a degree of latitude at 45° [m]; poses are corrected until they are read back."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Pose:
    """Where the user's aircraft is, as X-Plane counts it.

    Attributes:
        latitude_deg, longitude_deg: of its reference point, WGS84 [deg].
        height_m: of that above X-Plane's ground [m].
        pitch_deg: nose up positive [deg].
        roll_deg: right wing down positive [deg].
        heading_deg: true, clockwise from north [deg].
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float
    pitch_deg: float
    roll_deg: float
    heading_deg: float

    def state(self, scenario: Scenario, speed_mps: float, rate_degps: float) -> AircraftState:
        """The state in ``map``.

        Args:
            scenario: at whose place it is.
            speed_mps: ground speed.
            rate_degps: rate of the heading, clockwise positive.
        """
        frame = runway_frame(scenario.runway)
        found = frame.to_map(GeodeticPose(
            latitude_rad=math.radians(self.latitude_deg),
            longitude_rad=math.radians(self.longitude_deg),
            altitude_m=frame.elevation_m + self.height_m,
            heading_rad=math.radians(self.heading_deg),
        ))
        return AircraftState(
            x_m=found.x_m, y_m=found.y_m, z_m=self.height_m,
            roll_rad=math.radians(self.roll_deg), pitch_rad=-math.radians(self.pitch_deg),
            yaw_rad=found.yaw_rad, speed_mps=speed_mps, yaw_rate_radps=-math.radians(rate_degps),
        )

    def away(self, now: Pose) -> tuple[float, float, float, float]:
        """What another pose lacks to this one: east, north, up [m] and the largest turn [deg]."""
        parallel_m = _MERIDIAN_M * math.cos(math.radians(self.latitude_deg))
        return (
            _turn(self.longitude_deg, now.longitude_deg) * parallel_m,
            (self.latitude_deg - now.latitude_deg) * _MERIDIAN_M, self.height_m - now.height_m,
            max(
                abs(_turn(getattr(self, name), getattr(now, name)))
                for name in ('heading_deg', 'pitch_deg', 'roll_deg')
            ),
        )


def pose_of(scenario: Scenario, state: AircraftState) -> Pose:
    """A state in ``map`` as X-Plane counts it; heights are above its own ground."""
    there = runway_frame(scenario.runway).to_geodetic(
        MapPose(x_m=state.x_m, y_m=state.y_m, z_m=state.z_m, yaw_rad=state.yaw_rad)
    )
    return Pose(
        latitude_deg=math.degrees(there.latitude_rad),
        longitude_deg=math.degrees(there.longitude_rad), height_m=state.z_m,
        pitch_deg=-math.degrees(state.pitch_rad), roll_deg=math.degrees(state.roll_rad),
        heading_deg=math.degrees(there.heading_rad),
    )


class XPlane:
    """A running X-Plane; all methods raise InfraError where it does not do its part.

    Attributes:
        link: open interface.
        version: of X-Plane, as ``12.4.0``.
    """

    def __init__(self, setup: XPlaneSetup) -> None:
        """Wait for our turn, and connect."""
        self.setup, self._up_s = setup, 0.0
        self._watched: Iterator[Callable[[], None]] = iter(())
        with contextlib.ExitStack() as opened:
            opened.enter_context(_alone(setup))
            self.link = setup.open()
            opened.callback(self.link.close)
            self.version = self.link.version or f'{self.number(VERSION):.0f}'
            major(self.version)
            self._opened = opened.pop_all()

    def close(self, *overrides: str) -> None:
        """Let the aircraft go, end further overrides, resume the simulation, and disconnect."""
        with self._opened, contextlib.suppress(InfraError):  # it is gone, which has been said
            for _ in range(_RELEASES):  # over UDP nothing is confirmed
                for name in (*overrides, HELD):
                    self.link.write(name, 0.0)
                self.link.write(SPEED, 1.0)
                if not any(self.numbers(HELD, PAUSED)):
                    break

    def number(self, name: str) -> float:
        """Read a number."""
        return self.numbers(name)[0]

    def numbers(self, *names: str) -> list[float]:
        """Read numbers."""
        return [_number(name, value) for name, value in zip(
            names, self.link.read(*names), strict=True
        )]

    # Time

    def frames(self, count: int) -> None:
        """Wait until it has drawn frames."""
        last = self._marks()
        for _ in range(count):
            last = self._changed(
                self._marks, last, 'it draws no frames: minimised, loading, or hanging?'
            )

    def _changed(self, read: Callable[[], _T], before: _T, otherwise: str) -> _T:
        """Read a value until it is another one; the clock of the wall limits that."""
        limit_s = self.setup.timeout_s
        until = time.monotonic() + limit_s
        while (now := read()) == before:
            if time.monotonic() > until:
                raise failed(InfraKind.TIMEOUT, f'after {limit_s:g} s {otherwise}')
        return now

    def _marks(self) -> list[float]:
        """What a frame changes; the time that X-Plane has been up only grows."""
        marks = self.numbers(*FRAME_MARKS)
        if marks[0] < self._up_s:
            raise failed(
                InfraKind.DIED, f'X-Plane has been up for {marks[0]:.1f} s, before it was '
                f'{self._up_s:.1f} s: it was restarted during the run'
            )
        self._up_s = marks[0]
        return marks

    def pause(self, paused: bool) -> None:
        """Pause or resume, and wait until it has."""
        self.link.write(SPEED, 0.0 if paused else 1.0)
        self._changed(lambda: bool(self.number(PAUSED)), not paused,
                      'it cannot be paused' if paused else 'it stays paused')

    def run_until(self, flight_time_s: float, since_s: float = -math.inf) -> float:
        """Let it run to a time of its own, and pause it; the time at which it stands then [s]."""
        now = self.time_s(since_s)
        self.link.write(SPEED, 1.0)
        while now < flight_time_s:
            now = self._changed(
                functools.partial(self.time_s, now), now,
                'its time stands still: is it paused, or a menu open in it?',
            )
        self.pause(True)
        return self.time_s(now)

    def time_s(self, least_s: float = -math.inf) -> float:
        """Time of the simulation [s], which has reached another already."""
        now = self.number(FLIGHT_TIME)
        if now < least_s:
            raise failed(
                InfraKind.SIM, f'its time went back from {least_s:.2f} to {now:.2f} s: was the '
                'flight begun anew, or a replay shown?'
            )
        return now

    def check_still(self, time_s: float) -> None:
        """Check that its time has stood still since a moment, as it does while it is paused."""
        if (now := self.time_s(time_s)) > time_s:
            raise failed(
                InfraKind.SIM, f'its time went on by {now - time_s:.2f} s though it was paused: '
                'did somebody resume it?'
            )

    # Start of a run

    def begin(self, scenario: Scenario, start: Pose, *, moves: bool) -> None:
        """Pause, hold the aircraft, place it, set time and weather, settle, and pause again."""
        self.check_aircraft()
        for name in scenario.dataref_values:
            if trouble := self.link.trouble(name):
                raise UsageError(f'datarefs: {trouble}')
        self.pause(True)
        away_m = math.hypot(*start.away(self.pose())[:2])
        if not away_m <= MOST_AWAY_M:
            raise failed(
                InfraKind.NOT_READY, f'X-Plane is {away_m / 1000:.0f} km from the runway; start it '
                'there'
            )
        self.link.write(HELD, 1.0)
        self.place(start)
        time = time_settings(scenario, self.setup.settle_s)
        ours = [*time, *weather_settings(scenario, self.version, moves=moves)]
        theirs = [Setting(name, one) for name, one in scenario.dataref_values.items()]
        for one in (*ours, *theirs):
            self.link.write(one.name, one.value)
        if major(self.version) >= 12:
            self.link.command(REGENERATE)
        if self.setup.settle_s:
            self.run_until(self.time_s() + self.setup.settle_s)
        self.frames(_SETTLE_FRAMES)
        replaced = {split_name(one.name)[0] for one in theirs}
        kept = [*(one for one in ours if split_name(one.name)[0] not in replaced), *theirs]
        for one in kept:
            self.check(one)
        self.place(start)
        if moves:  # time goes on, and with it what is theirs may change
            kept = [one for one in ours[len(time):] if one in kept]
        self._watched = itertools.cycle([
            *(functools.partial(self.check, one) for one in kept), self.check_aircraft,
        ])

    def check_next(self) -> None:
        """Check that one of the things set for the run, each time the next, is still as it was.

        All at once would take as many questions as a picture does.
        """
        next(self._watched)()

    def check_aircraft(self) -> None:
        """Check that the required aircraft is loaded."""
        if not self.setup.aircraft:
            return
        (name,) = self.link.read(NAME)
        if self.setup.aircraft not in str(name):
            raise failed(
                InfraKind.SIM, f'the aircraft is {name!r:.80}, expected {self.setup.aircraft!r}; '
                'load it'
            )

    def check(self, wanted: Setting) -> None:
        """Check that a setting is read back as it was set."""
        (now,) = self.link.read(wanted.name)
        asked = wanted.value if isinstance(wanted.value, tuple) else (wanted.value,)
        read = now if isinstance(now, tuple) else (_number(wanted.name, now),)
        if len(asked) > len(read) or any(
            abs(one - other) > wanted.within + 1e-5 * abs(one)
            for one, other in zip(asked, read, strict=False)
        ):
            raise failed(
                InfraKind.SIM, f'{wanted.name} is {_short(read)} after it was set to '
                f'{_short(asked)}'
            )

    # Where the aircraft is

    def pose(self) -> Pose:
        """Where the aircraft is."""
        if isinstance(self.link, XPlaneConnect):  # its datarefs are floats, of a metre
            latitude, longitude, pitch, roll, heading = self.link.position()
        else:
            latitude, longitude, pitch, roll, heading = self.numbers(*_WHERE)
        return Pose(
            latitude_deg=latitude, longitude_deg=longitude, height_m=self.number(HEIGHT),
            pitch_deg=pitch, roll_deg=roll, heading_deg=heading,
        )

    def place(self, wanted: Pose) -> None:
        """Place the held aircraft, and correct until it is where it should be.

        X-Plane's local coordinates, heights and headings follow from a frame of its own, so what
        is read back differs at first.
        """
        for tried in range(_MOST_TRIES):
            now = self.pose()
            east_m, north_m, up_m, turn_deg = wanted.away(now)
            away_m = math.hypot(east_m, north_m)
            if max(away_m, abs(up_m)) <= NEAR_M and turn_deg <= NEAR_DEG:
                return
            if tried < _MOST_TRIES - 1:
                self._move(wanted, now)
                self.frames(_SETTLE_FRAMES)
        raise failed(
            InfraKind.SIM, f'the aircraft stays {away_m:.2f} m, {up_m:+.2f} m in height and '
            f'{turn_deg:.2f} deg from where it was placed; does another program move it?'
        )

    def _move(self, wanted: Pose, now: Pose) -> None:
        east_m, north_m, up_m, _ = wanted.away(now)
        x_m, y_m, z_m, heading_deg = self.numbers(
            *(f'{POSITION}{name}' for name in ('local_x', 'local_y', 'local_z', 'psi'))
        )
        # Local north differs from the true one by the convergence of the meridians.
        bend_deg = _turn(now.heading_deg, heading_deg)
        sin, cos = math.sin(math.radians(bend_deg)), math.cos(math.radians(bend_deg))
        heading_deg = (wanted.heading_deg - bend_deg) % 360
        for name, value in (
            ('local_x', x_m + east_m * cos - north_m * sin), ('local_y', y_m + up_m),
            ('local_z', z_m - east_m * sin - north_m * cos),
            ('psi', heading_deg), ('theta', wanted.pitch_deg), ('phi', wanted.roll_deg),
            ('q', _quaternion(heading_deg, wanted.pitch_deg, wanted.roll_deg)),
        ):
            self.link.write(f'{POSITION}{name}', value)


@contextlib.contextmanager
def _alone(setup: XPlaneSetup) -> Iterator[None]:
    """Context in which no other run of this user uses this X-Plane; waits for it."""
    name = f'taxinet-xplane-{os.getuid()}-{address_of(setup.host)}-{setup.port}.lock'
    path = Path(tempfile.gettempdir(), name)
    try:
        lock = path.open('a')
    except OSError as error:
        raise failed(InfraKind.NOT_READY, f'{path}: {error.strerror}') from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            warn_once(f'x-plane at {setup.host}:{setup.port}: another run uses it; waiting')
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _turn(to_deg: float, from_deg: float) -> float:
    """Smallest turn from one direction to another [deg]."""
    return (to_deg - from_deg + 180) % 360 - 180


def _quaternion(heading_deg: float, pitch_deg: float, roll_deg: float) -> tuple[float, ...]:
    """X-Plane's quaternion: turns about down, right and ahead, the scalar first.

    Source: "Moving the Plane", developer.x-plane.com.
    """
    cz, cy, cx = (math.cos(math.radians(one) / 2) for one in (heading_deg, pitch_deg, roll_deg))
    sz, sy, sx = (math.sin(math.radians(one) / 2) for one in (heading_deg, pitch_deg, roll_deg))
    return (
        cz * cy * cx + sz * sy * sx,
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
    )


def _number(name: str, value: Value) -> float:
    if isinstance(value, float):
        return value
    raise failed(InfraKind.PROTOCOL, f'{name} is {value!r:.40}, expected a number')


def _short(values: tuple[float, ...]) -> str:
    return ', '.join(f'{one:g}' for one in values[:4]) + (', …' if len(values) > 4 else '')
