"""Controller ``hold_short``: the shipped law, and a stop before hold lines until they are cleared.

Where it is along the track it knows from the GNSS: a fix is as old as its stamp says, and wheels
(else its own commands) carry it on from there, also through drop-outs. Successive fixes are
averaged over two seconds.
"""

from __future__ import annotations

import math
from dataclasses import replace

from taxinet_ros.core.motion.controller import Controller, SteeringGains, SteeringLaw
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Fix, Measured
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.errors import UsageError

MARGIN_M = 3.0
"""Where the nose is to stop, before a hold line: three times the noise of the standard GNSS [m]."""
DECELERATION_MPS2 = 0.8
"""At which it brakes towards a hold line, a fifth of what dry brakes can do [m/s²]."""
_SLOWEST_MPS = 0.3
"""It stands rather than creep more slowly."""
_AVERAGED_S = 2.0
_WHEEL_AGE_NS = NS_PER_S
"""Older speeds of the wheels do not count."""


class HoldShort(Controller):
    """Steers as the shipped law with its usual gains, and holds short of hold lines."""

    word = 'hold_short'
    fingerprint = ''
    needs_sensors = True

    def __init__(self) -> None:
        """Begin on the default scenario."""
        self._law = SteeringLaw(SteeringGains())
        self.begin()

    def begin(self, scenario: Scenario | None = None) -> None:
        """See :class:`Controller`.

        Raises:
            UsageError: see :func:`check_holding`.
        """
        scenario = scenario or Scenario()
        check_holding(scenario)
        self._law.begin(scenario)
        self._track, self._nose_m = scenario.line, scenario.aircraft_model.nose_m
        self._period_ns, self._told_mps = scenario.period_ns, scenario.speed_mps
        self._ways_m: list[float] = []
        self._measured = Measured()
        self._wheel_ns, self._wheel_mps = -_WHEEL_AGE_NS - 1, 0.0
        self._fixes, self._fixed_ns, self._start_m = 0, 0, math.nan
        self._held_m = math.nan

    def sense(self, measured: Measured) -> None:
        """See :class:`Controller`."""
        self._measured = measured

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the law's command, no faster than the next hold line allows."""
        measured, self._measured = self._measured, Measured()
        self._carry_on(measured)
        for fix in measured.gnss:
            self._take(fix)
        command = self._law.command(estimate)
        if measured.hold_lines_m:
            allowed_mps = self._allowed_mps(measured.hold_lines_m[0])
            command = replace(command, speed_mps=min(command.speed_mps, allowed_mps))
        self._told_mps = command.speed_mps
        return command

    def _carry_on(self, measured: Measured) -> None:
        """Add the way since the step before."""
        now_ns = step_stamp_ns(len(self._ways_m), self._period_ns)
        for one in measured.wheel:
            self._wheel_ns, self._wheel_mps = one.stamp_ns, one.speed_mps
        fresh = now_ns - self._wheel_ns <= _WHEEL_AGE_NS
        speed_mps = self._wheel_mps if fresh else self._told_mps
        way_m = self._ways_m[-1] + speed_mps * self._period_ns / NS_PER_S if self._ways_m else 0.0
        self._ways_m.append(way_m)

    def _take(self, fix: Fix) -> None:
        """Correct where the way began along the track."""
        step, rest_ns = divmod(fix.stamp_ns, self._period_ns)
        before_m = self._ways_m[step]
        after_m = self._ways_m[min(step + 1, len(self._ways_m) - 1)]
        way_m = before_m + (after_m - before_m) * rest_ns / self._period_ns
        start_m = self._track.measure(*fix.position_m).distance_m - way_m
        self._fixes += 1
        age_s = (fix.stamp_ns - self._fixed_ns) / NS_PER_S
        share = max(1 / self._fixes, 1 - math.exp(-age_s / _AVERAGED_S))
        self._start_m = start_m if self._fixes == 1 else (
            self._start_m + share * (start_m - self._start_m))
        self._fixed_ns = fix.stamp_ns

    def _allowed_mps(self, line_m: float) -> float:
        """Greatest speed towards a hold line; 0 while it is unknown where the aircraft is."""
        left_m = line_m - (self._start_m + self._ways_m[-1] + self._nose_m) - MARGIN_M
        if line_m == self._held_m or math.isnan(left_m):
            return 0.0
        allowed_mps = math.sqrt(2 * DECELERATION_MPS2 * max(left_m, 0.0))
        if allowed_mps >= _SLOWEST_MPS:
            return allowed_mps
        self._held_m = line_m  # noise shall not make it creep on
        return 0.0


def check_holding(scenario: Scenario) -> None:
    """Refuse a scenario with hold lines in which the controller cannot know where it is.

    Raises:
        UsageError: there is no GNSS, or the aircraft has no outline, so no nose.
    """
    if not scenario.others.hold_lines:
        return
    if scenario.sensor_set.gnss is None:
        raise UsageError(
            'controller hold_short: finds a hold_line by a gnss among the sensors, and there is '
            'none; set the key sensors, as in sensors=standard'
        )
    if math.isnan(scenario.aircraft_model.nose_m):
        raise UsageError(
            f'controller hold_short: the outline of aircraft {scenario.aircraft_model.name} is '
            'unknown, and with it its nose; give it one (docs/world.md)'
        )
