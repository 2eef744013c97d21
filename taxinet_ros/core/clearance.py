"""How far the aircraft is from others on the ground, and from hold lines.

These are the signals ``clearance`` and ``collision``, and ``hold_distance``.

Distances are in plan, between parts of the aircraft and of an object at the same height above
ground: a wing passes over a cone, but not over a fin. The pitch is that of straight taxiing, nose
up with a tail wheel; how the aircraft rolls and pitches beside that is neglected. The position is
that of the odometry, so that loop, graph and bags give the same bits. There are no physics of an
impact: the run goes on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.mtl.specs import MOST_CLEARANCE_M, MOST_HOLD_DISTANCE_M, OF_OTHERS
from taxinet_ros.core.rig.camera_model import rotation
from taxinet_ros.core.rig.catalogue import find_aircraft
from taxinet_ros.core.rig.outline import corners_of
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.motion import TrafficMotion
from taxinet_ros.core.traffic.shapes import Outline, Points, hull, outlines
from taxinet_ros.core.traffic.traffic import GroundObject, Pose
from taxinet_ros.core.types import AircraftState, quaternion

Vectors = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]
_THIN_M = 5e-4


class Clearance:
    """Distances from the aircraft to others on the ground in one scenario."""

    def __init__(self, scenario: Scenario) -> None:
        """Take the objects that can be hit."""
        self._traffic, self._objects = scenario.others, scenario.others.solids
        self._motion = TrafficMotion(scenario.others, scenario.period_ns)
        self._aircraft = scenario.aircraft
        self._hold_lines, self._track = scenario.hold_lines, scenario.line
        self._nose_m = scenario.aircraft_model.nose_m if self._hold_lines else math.nan
        if self._objects:  # ahead of the first step, as it may take a second
            _own_parts(scenario.aircraft)

    def may_violate(self, names: Collection[str]) -> bool:
        """Whether there is what each signal about others is about, of the signals named."""
        of_lines, read = 'hold_distance', OF_OTHERS.intersection(names)
        return bool((self._hold_lines or of_lines not in read) and (
            self._objects or read <= {of_lines}
        ))

    def to_hold_line(self, stamp_ns: int, x_m: float, y_m: float) -> float:
        """Least way along the track from the nose to a hold line that is not cleared [m].

        Negative once the nose is past one, until that is cleared. At most
        :data:`~taxinet_ros.core.mtl.specs.MOST_HOLD_DISTANCE_M`, also where none is left; NaN
        where the position is not finite, or the aircraft has no outline.

        Args:
            stamp_ns: simulated time [ns].
            x_m: reference point in ``map``, along the runway [m].
            y_m: left of it [m].
        """
        if not self._hold_lines:
            return MOST_HOLD_DISTANCE_M
        if not all(map(math.isfinite, (x_m, y_m, self._nose_m))):
            return math.nan
        nose_m = self._track.measure(x_m, y_m).distance_m + self._nose_m
        left = (along_m for along_m, until_ns in self._hold_lines if stamp_ns < until_ns)
        return min(MOST_HOLD_DISTANCE_M, next(left, math.inf) - nose_m)

    def of_state(self, stamp_ns: int, state: AircraftState) -> float:
        """As :meth:`at`, of a true state."""
        if not self._objects:  # spares the default scene the arithmetic
            return MOST_CLEARANCE_M
        attitude = quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad)
        return self.at(stamp_ns, state.x_m, state.y_m, attitude)

    def at(self, stamp_ns: int, x_m: float, y_m: float, attitude: Quaternion) -> float:
        """Least distance in plan to anything that can be hit [m], 0 where one is touched.

        At most :data:`~taxinet_ros.core.mtl.specs.MOST_CLEARANCE_M`, also where nobody is; NaN
        where the position is not finite, or the aircraft has no outline. Where others react to the
        aircraft, it has to be called for each control step, in order: NaN from one on that was
        left out.

        Args:
            stamp_ns: simulated time [ns].
            x_m: reference point in ``map``, along the runway [m].
            y_m: left of it [m].
            attitude: as x, y, z, w, as odometry has it.
        """
        if not self._objects:
            return MOST_CLEARANCE_M
        held = self._motion.step(stamp_ns, x_m, y_m)
        own_reach_m = _own_reach_m(self._aircraft)
        if held is None or not all(map(math.isfinite, (x_m, y_m, own_reach_m, *attitude))):
            return math.nan
        x, y, z, w = attitude
        forward = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z)
        length = math.hypot(*forward)
        cos, sin = forward[0] / length, forward[1] / length
        bounds: list[tuple[float, int, GroundObject, Pose]] = []
        for one, pose in self._traffic.solids_at(stamp_ns, held):
            centre_m = math.hypot(pose.x_m - x_m, pose.y_m - y_m)
            bounds.append((centre_m - _reach_m(one) - own_reach_m, len(bounds), one, pose))
        least_m = MOST_CLEARANCE_M
        for bound_m, _, one, pose in sorted(bounds, key=lambda found: found[:2]):
            if bound_m >= least_m:
                break
            turned = _seen_from(pose, x_m, y_m, cos, sin)
            for outline in outlines(one.kind, one.size):
                own = _own_plan(self._aircraft, outline.low_m, outline.high_m)
                if own is not None:
                    least_m = min(least_m, pixels.gap(*own, _placed(outline, turned)))
        return least_m


def _seen_from(pose: Pose, x_m: float, y_m: float, cos: float, sin: float) -> Pose:
    """A pose in the plan of the aircraft, whose reference point is at x, y."""
    dx, dy = pose.x_m - x_m, pose.y_m - y_m
    turn = pose.heading_rad - math.atan2(sin, cos)
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, turn)


def _placed(outline: Outline, pose: Pose) -> Vectors:
    cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return np.array([
        (pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y, 0.0) for x, y in outline.hull
    ])


@lru_cache(maxsize=256)
def _own_plan(
    aircraft: str, low_m: float, high_m: float
) -> tuple[Vectors, list[int]] | None:
    """Plan of what the aircraft has between two heights above ground; None if it has nothing.

    Corners (n, 3) of convex polygons, counter-clockwise, and the first one of each.
    """
    hulls = [
        _plan(points) for part in _own_parts(aircraft)
        if (points := _between(part, low_m, high_m))
    ]
    if not hulls:
        return None
    return corners_of([np.pad(np.array(one), ((0, 0), (0, 1))) for one in hulls])


def _plan(points: Sequence[tuple[float, float]]) -> Points:
    """The hull; what is upright and has no thickness gets one, as it can be hit too."""
    plan = hull(points)
    if len(plan) > 2:
        return plan
    return hull([
        (x + dx, y + dy) for x, y in points for dx in (-_THIN_M, _THIN_M)
        for dy in (-_THIN_M, _THIN_M)
    ])


def _between(part: Vectors, low_m: float, high_m: float) -> list[tuple[float, float]]:
    """Points (x, y) whose hull is the plan of what a convex part has between two heights."""
    found = [(x, y) for x, y, z in part.tolist() if low_m <= z <= high_m]
    for (ax, ay, az), (bx, by, bz) in itertools.combinations(part.tolist(), 2):
        for level in (low_m, high_m):
            if min(az, bz) < level < max(az, bz):
                share = (level - az) / (bz - az)
                found.append((ax + share * (bx - ax), ay + share * (by - ay)))
    return found


@lru_cache(maxsize=64)
def _own_parts(aircraft: str) -> tuple[Vectors, ...]:
    """Convex parts of the aircraft that can touch something, those that cast shadows.

    As they stand on the wheels: x forward and y left of the reference point, z from the ground
    [m]. Height and pitch are rounded, to a centimetre and half a degree, so that a measured
    aircraft has the bits of one whose file states what was measured.
    """
    # JSBSim, which runs with nobody about do not need here.
    from taxinet_ros.core.motion.aircraft import measured_model

    model = find_aircraft(aircraft)
    settled = model.settled or measured_model(model).settled
    assert settled is not None
    turn = rotation(0.0, round(settled.pitch_rad, 2), 0.0)
    raised = 0.0, 0.0, round(settled.z_m, 2)
    return tuple(part.points @ turn.T + raised for part in model.outline if part.shades)


@lru_cache(maxsize=64)
def _own_reach_m(aircraft: str) -> float:
    """Farthest point from the reference point [m]; NaN without an outline."""
    parts = _own_parts(aircraft)
    return max((float(np.hypot(*part[:, :2].T).max()) for part in parts), default=math.nan)


@lru_cache(maxsize=256)
def _reach_m(one: GroundObject) -> float:
    return max(
        math.hypot(*point) for outline in outlines(one.kind, one.size) for point in outline.hull
    )
