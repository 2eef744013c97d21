"""How others on the ground that react to the aircraft have moved until a control step.

Such an object has a clock of its own for its path, which stands for a control period whenever the
aircraft holds it at the step. So its pose follows from where the aircraft was at every step since
the start: whoever knows the odometry (world, monitor, bag) has the same one, to the bit.
"""

from __future__ import annotations

import math

from taxinet_ros.core.traffic.traffic import GroundObject, Held, Holds, Traffic


class TrafficMotion:
    """Where the aircraft holds others on the ground, followed step by step."""

    def __init__(self, traffic: Traffic, period_ns: int) -> None:
        """Begin ahead of the first step; ``period_ns`` is the control period [ns]."""
        self._reacting = {
            number: one for number, one in enumerate(traffic.objects) if one.reacts
        }
        self._period_ns, self._stamp_ns = period_ns, -1
        self._before: Holds | None = None
        self._held: Holds | None = None

    def step(self, stamp_ns: int, x_m: float, y_m: float) -> Holds | None:
        """Follow the aircraft to the next step; 0 begins anew, the same step again replaces it.

        Args:
            stamp_ns: of the step [ns].
            x_m: reference point of the aircraft in ``map``, along the runway [m].
            y_m: left of it [m].

        Returns:
            What is held at this step, as :meth:`.Traffic.pose` needs it; None from a step on that
            was missed, or where the aircraft's position is not finite: nobody can know then.
        """
        if not self._reacting:
            return {}
        if stamp_ns == 0:
            self._before = dict.fromkeys(self._reacting, Held(0, begun=False, stands=False))
        elif stamp_ns != self._stamp_ns:
            # Periods of 30 Hz differ by a nanosecond.
            passed_ns = stamp_ns - self._stamp_ns
            missed = not 0 < passed_ns <= self._period_ns + 1
            self._before = None if missed else self._held
            if self._before is not None:
                self._before = {
                    number: held._replace(ns=held.ns + held.stands * passed_ns)
                    for number, held in self._before.items()
                }
        self._stamp_ns, self._held = stamp_ns, None
        if self._before is not None and math.isfinite(x_m) and math.isfinite(y_m):
            self._held = {
                number: _held(one, self._before[number], stamp_ns, x_m, y_m)
                for number, one in self._reacting.items()
            }
        return self._held


def _held(one: GroundObject, before: Held, stamp_ns: int, x_m: float, y_m: float) -> Held:
    pose = one.pose_at(stamp_ns - before.ns)
    away_m = math.hypot(pose.x_m - x_m, pose.y_m - y_m)
    begun = before.begun or not one.starts_within_m or away_m < one.starts_within_m
    return Held(before.ns, begun, not begun or away_m < one.stands_within_m)
