"""X-Plane as the whole world: its aircraft, its ground, its picture. ``--world xplane``.

The run goes in steps of 0.1 s of X-Plane's own time, as far as its frames allow: it is paused at
the first frame that reaches the end of a step. The next step ends at its own due time, so late
frames do not add up. The clock of the wall plays no part.
"""

from __future__ import annotations

import dataclasses
import math

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation, last_step
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    CROSSING,
    GUST,
    SHADOWS,
    SLOPE,
    TRAFFIC,
)
from taxinet_ros.core.types import AircraftState, TaxiCommand
from taxinet_ros.core.world import World
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.extras.xplane.camera import Display, OpenScreen, ViewFromXPlane
from taxinet_ros.extras.xplane.setup import XPlaneSetup, chosen_setup
from taxinet_ros.extras.xplane.simulator import (
    HELD,
    MOST_AWAY_M,
    POSITION,
    XPlane,
    pose_of,
)
from taxinet_ros.extras.xplane.wire import failed

PERIOD_S = CONTROL_PERIOD_NS / 1e9
_HIDDEN = (SHADOWS, CROSSING, TRAFFIC, AIRCRAFT_MODEL, GUST, SLOPE)
"""What X-Plane does not get from a scenario."""
_USUAL = Scenario()

_OWN_STEERING = 'sim/operation/override/override_wheel_steer'
_STEERING = 'sim/flightmodel2/gear/tire_steer_command_deg[0]'
_THROTTLE = 'sim/cockpit2/engine/actuators/throttle_ratio_all'
_BRAKE = 'sim/cockpit2/controls/parking_brake_ratio'

CONTROLS = (_OWN_STEERING, _STEERING, _THROTTLE, _BRAKE)
"""Datarefs by which the aircraft is driven."""

_IDLE_THROTTLE, _THROTTLE_PER_MPS, _THROTTLE_PER_M = 0.1, 0.15, 0.02
"""Speed hold: throttle at no error, per m/s of error, per metre of lag (its integral)."""
_MOST_LAG_M = 20.0
_BRAKE_PER_MPS, _BRAKE_OVER_MPS = 0.2, 0.5
_STUCK_S, _STUCK_MPS = 5.0, 0.2
_MOST_MPS = 100.0


class XPlaneWorld(World):
    """The world of one run."""

    reproducible = False
    takes_datarefs = True

    def __init__(
        self, scenario: Scenario, *, pictures: bool = True, setup: XPlaneSetup | None = None,
        open_screen: OpenScreen = Display,
    ) -> None:
        """Place the aircraft, set light, weather and wind, and release it at its speed."""
        hidden = [
            one.key for one in _HIDDEN
            if getattr(scenario, one.attribute) != getattr(_USUAL, one.attribute)
        ]
        if hidden:
            raise UsageError(
                f'world xplane: {", ".join(hidden)} would have no effect; leave it at its default'
            )
        self.last_seq = last_step(scenario)
        self._scenario, self._seq = scenario, 0
        self._lag_m = self._stuck_s = 0.0
        setup = setup or chosen_setup()
        start = dataclasses.replace(Aircraft(scenario).state, speed_mps=scenario.speed_mps)
        self._xplane = XPlane(setup)
        self._screen: Display | None = None
        self._view: ViewFromXPlane | None = None
        try:
            if pictures:
                self._screen = open_screen(setup.display, setup.region_px)
            self._xplane.begin(scenario, pose_of(scenario, start), moves=True)
            if self._screen is not None:
                self._view = ViewFromXPlane(self._xplane, scenario.camera_model, self._screen)
            self._release(scenario.speed_mps)
        except BaseException:
            self.close()
            raise
        self._state = self._read()

    def _release(self, speed_mps: float) -> None:
        link = self._xplane.link
        (heading_deg,) = self._xplane.numbers(f'{POSITION}psi')
        sin, cos = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
        for name, value in (
            (f'{POSITION}local_vx', speed_mps * sin), (f'{POSITION}local_vy', 0.0),
            (f'{POSITION}local_vz', -speed_mps * cos), (f'{POSITION}P', 0.0),
            (f'{POSITION}Q', 0.0), (f'{POSITION}R', 0.0), (_OWN_STEERING, 1.0), (_STEERING, 0.0),
            (_THROTTLE, _IDLE_THROTTLE), (_BRAKE, 0.0), (HELD, 0.0),
        ):
            link.write(name, value)
        self._xplane.frames(1)
        self._began_s = self._now_s = self._xplane.time_s()

    def observe(self, *, picture: bool = True) -> Observation:
        """Observe the current step, X-Plane paused."""
        image = None
        if picture and self._view is not None:
            image = self._view.take(self._state, self._now_s)
        return Observation(
            seq=self._seq, stamp_ns=self._seq * CONTROL_PERIOD_NS, state=self._state, image=image,
            track=self._scenario.line,
        )

    def advance(self, command: TaxiCommand) -> None:
        """Hold a command for 0.1 s of X-Plane's time."""
        self._seq += 1
        self._steer(command)
        due_s = self._began_s + self._seq * PERIOD_S
        self._now_s = self._xplane.run_until(due_s, self._now_s)
        late_s = self._now_s - due_s
        if late_s >= PERIOD_S:
            raise failed(
                InfraKind.TIMEOUT, f'step {self._seq} ended {late_s:.2f} s of its time late; give '
                'it more frames a second'
            )
        self._state = self._read()
        slow = self._state.speed_mps < _STUCK_MPS < command.speed_mps
        self._stuck_s = self._stuck_s + PERIOD_S if slow else 0.0
        if self._stuck_s >= _STUCK_S:
            raise failed(
                InfraKind.SIM, f'the aircraft has not moved for {_STUCK_S:g} s: does its engine '
                'run, are its brakes off?'
            )

    def _steer(self, command: TaxiCommand) -> None:
        error_mps = command.speed_mps - self._state.speed_mps
        lag_m = self._lag_m + error_mps * PERIOD_S
        self._lag_m = min(max(lag_m, -_MOST_LAG_M), _MOST_LAG_M)
        throttle = (
            _IDLE_THROTTLE + _THROTTLE_PER_MPS * error_mps + _THROTTLE_PER_M * self._lag_m
            if command.speed_mps else 0.0
        )
        over_mps = -error_mps - _BRAKE_OVER_MPS
        brake = 1.0 if not command.speed_mps else _BRAKE_PER_MPS * over_mps
        for name, value in (
            (_STEERING, -math.degrees(command.steering_rad)),
            (_THROTTLE, min(max(throttle, 0.0), 1.0)), (_BRAKE, min(max(brake, 0.0), 1.0)),
        ):
            self._xplane.link.write(name, value)

    def _read(self) -> AircraftState:
        speed_mps, rate_degps = self._xplane.numbers(f'{POSITION}groundspeed', f'{POSITION}R')
        state = self._xplane.pose().state(self._scenario, speed_mps, rate_degps)
        if not (0 <= speed_mps <= _MOST_MPS and math.hypot(state.x_m, state.y_m) <= MOST_AWAY_M):
            raise failed(
                InfraKind.SIM, f'the aircraft is at {state.x_m:.4g}, {state.y_m:.4g} m with '
                f'{speed_mps:.4g} m/s, which is no taxiing'
            )
        return state

    def close(self) -> None:
        """Give X-Plane back, running, its controls its own."""
        if self._screen is not None:
            self._screen.close()
        self._xplane.close(_OWN_STEERING)
