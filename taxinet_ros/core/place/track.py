"""A track: the line that a run follows, and coordinates along it (Frenet).

A track is made of straight legs and circular arcs that continue each other without a corner. At any
point of the ground the nearest point of the track gives the distance along it, the cross-track
error (left positive) and the direction that the heading error is measured from. These are functions
of the pose alone, so every process finds the same ones. Before its first and beyond its last point
a track goes on straight.

Of two parts of a track that are equally far away the earlier one counts. Files may only describe
tracks that nowhere come that near to themselves (:func:`check_room`), so within its width a track's
coordinates are unique and continuous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple

from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.runway import Runway

RUNWAY_TRACK = 'runway'
"""Name of the runway's centreline."""

ROOM_AHEAD_M = 150.0
"""Less than this before the end of a track no run begins: 30 s of taxiing."""
LEAST_RADIUS_M = 15.0
"""Below, the caravan's nose wheel at its limit of 15 degrees does not follow."""
PAVED_BEYOND_M = 200.0
"""How far pavement and paint go on straight beyond the ends of a track."""
_EDGE_ROOM_M = 0.24
_LEAD_M, _LEAD_BESIDE_M, _ALIGNED = 60.0, 0.9, 0.5
_PAINT_STEP_M = 0.5
_STRAIGHT_RAD = 1e-6
_CHECKED_EVERY_M = 2.0


class OnTrack(NamedTuple):
    """Where a pose is relative to a track.

    Attributes:
        distance_m: of the nearest point, along the track [m]; negative before its beginning.
        cte_m: cross-track error [m], left positive.
        he_rad: heading error [rad], nose left positive, in -pi..pi.
    """

    distance_m: float
    cte_m: float
    he_rad: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Leg:
    """A straight piece or an arc.

    Attributes:
        x_m, y_m, yaw_rad: where it begins, in ``map``, and in which direction.
        length_m: along it [m].
        curvature: 1 / radius [1/m], of a left turn positive; 0 is straight.
        start_m: distance of its beginning along the track [m].
    """

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    curvature: float
    start_m: float

    def point(self, along_m: float, left_m: float) -> tuple[float, float, float]:
        """x, y [m] and direction [rad] at a distance along the leg, so far to the left of it."""
        turn = self.curvature * along_m
        ahead, left = along_m, left_m
        if self.curvature:
            radius = 1 / self.curvature
            ahead = (radius - left_m) * math.sin(turn)
            left = radius - (radius - left_m) * math.cos(turn)
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return (
            self.x_m + ahead * cos - left * sin, self.y_m + ahead * sin + left * cos,
            self.yaw_rad + turn,
        )

    def nearest(self, x_m: float, y_m: float, low_m: float, high_m: float) -> tuple[float, float]:
        """The distance of its point nearest to (x, y), and how far left of that (x, y) is.

        Only distances along the leg from ``low_m`` to ``high_m`` count.
        """
        dx, dy = x_m - self.x_m, y_m - self.y_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        if not self.curvature:
            along = min(max(ahead, low_m), high_m)
            return along, left if along == ahead else math.copysign(
                math.hypot(ahead - along, left), left
            )
        bend = abs(self.curvature)
        inward = left if self.curvature > 0 else -left
        turn = math.atan2(bend * ahead, 1 - bend * inward)
        if turn < self.length_m * bend / 2 - math.pi:
            turn += math.tau
        along = min(max(turn / bend, low_m), high_m)
        if along == turn / bend:
            distance = 1 / bend - math.hypot(ahead, 1 / bend - inward)
            return along, distance if self.curvature > 0 else -distance
        at_x, at_y, at_yaw = self.point(along, 0.0)
        to_x, to_y = x_m - at_x, y_m - at_y
        side = to_y * math.cos(at_yaw) - to_x * math.sin(at_yaw)
        return along, math.copysign(math.hypot(to_x, to_y), side)


@dataclass(frozen=True, kw_only=True, slots=True)
class Track:
    """A line to follow.

    Attributes:
        name: of it at its place; :data:`RUNWAY_TRACK` is the runway's centreline.
        title: display name.
        width_m: of the pavement along it [m].
        legs: in order; the first and the last one are straight.
        last_start_m: greatest distance along it at which a run may begin [m].
        painted: whether it is marked as a taxiway's centreline, in yellow.
    """

    name: str
    title: str
    width_m: float
    legs: tuple[Leg, ...]
    last_start_m: float
    painted: bool = True

    @property
    def is_runway(self) -> bool:
        """Whether it is the runway's centreline, the x axis of ``map``."""
        return self.name == RUNWAY_TRACK

    @property
    def length_m(self) -> float:
        """From its first to its last point [m]."""
        return self.legs[-1].start_m + self.legs[-1].length_m

    @property
    def half_width_m(self) -> float:
        """Distance of the pavement's edges from it [m]."""
        return self.width_m / 2

    @property
    def farthest_start_m(self) -> float:
        """Greatest distance to either side at which a run may begin [m]."""
        return round(self.half_width_m - _EDGE_ROOM_M, 6)

    def measure(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> OnTrack:
        """Where a pose in ``map`` is along and beside the track."""
        if self.is_runway:
            return OnTrack(x_m, y_m, yaw_rad)
        best = math.inf, 0.0, 0.0, self.legs[0]
        last = len(self.legs) - 1
        for number, leg in enumerate(self.legs):
            along, left = leg.nearest(
                x_m, y_m, 0.0 if number else -math.inf, leg.length_m if number < last else math.inf
            )
            if abs(left) < best[0]:
                best = abs(left), along, left, leg
        _, along, left, leg = best
        direction = leg.yaw_rad + leg.curvature * along
        return OnTrack(leg.start_m + along, left, math.remainder(yaw_rad - direction, math.tau))

    def pose(
        self, distance_m: float, cte_m: float = 0.0, he_rad: float = 0.0
    ) -> tuple[float, float, float]:
        """x, y [m] and yaw [rad] in ``map``; the inverse of :meth:`measure`."""
        if self.is_runway:
            return distance_m, cte_m, he_rad
        leg = next(
            (leg for leg in reversed(self.legs) if leg.start_m <= distance_m), self.legs[0]
        )
        x_m, y_m, direction = leg.point(distance_m - leg.start_m, cte_m)
        return x_m, y_m, math.remainder(direction + he_rad, math.tau)

    def samples(self, every_m: float, beyond_m: float = 0.0) -> list[float]:
        """Distances along it, at most ``every_m`` apart, from so far before it to so far beyond."""
        whole_m = self.length_m + 2 * beyond_m
        count = math.ceil(whole_m / every_m)
        return [whole_m * number / count - beyond_m for number in range(count + 1)]

    def strip(self, half_m: float) -> Polygon:
        """Outline of what lies within a distance of it, as far as its pavement goes."""
        distances_m = self.samples(4.0, PAVED_BEYOND_M)
        return *self.edge(-half_m, distances_m), *reversed(self.edge(half_m, distances_m))

    def edge(self, left_m: float, distances_m: Sequence[float]) -> Polygon:
        """The points so far to the left of it."""
        return tuple(self.pose(at, left_m)[:2] for at in distances_m)


def runway_track(runway: Runway) -> Track:
    """The centreline of a runway."""
    leg = Leg(
        x_m=0.0, y_m=0.0, yaw_rad=0.0, length_m=runway.length_m, curvature=0.0, start_m=0.0
    )
    return Track(
        name=RUNWAY_TRACK, title='centreline of the runway', width_m=runway.width_m, legs=(leg,),
        last_start_m=runway.last_start_m, painted=False,
    )


def make_track(
    name: str, title: str, width_m: float, points: Polygon, radii_m: Sequence[float], *,
    painted: bool = True,
) -> Track:
    """A track through two or more points (x, y) in ``map`` [m], its corners rounded by arcs.

    ``radii_m`` are those of the arcs at each point between the first and the last [m]; for the
    others see :class:`Track`.

    Raises:
        ValueError: two points in succession are one, an arc does not fit, or it is too short for a
            run. Whether it comes too near to itself is for :func:`check_room`.
    """
    legs = _rounded(points, radii_m)
    track = Track(
        name=name, title=title, width_m=width_m, legs=legs, painted=painted,
        last_start_m=math.floor(legs[-1].start_m + legs[-1].length_m - ROOM_AHEAD_M),
    )
    if track.last_start_m < 0:
        raise ValueError(f'is {track.length_m:.0f} m long, expected {ROOM_AHEAD_M:g} m or more')
    return track


def painted_line(track: Track, runway: Runway) -> tuple[Polygon, ...]:
    """The yellow line of a track, as points at most half a metre apart.

    It goes on beyond the ends as far as the pavement (:data:`PAVED_BEYOND_M`). Where the track runs
    along the runway's centreline only the last 60 m before it leaves are marked, and the first
    after it joins, 0.9 m beside the white centreline (FAA AC 150/5340-1, lead-off lines).
    """
    if not track.painted:
        return ()
    poses = [track.pose(at) for at in track.samples(_PAINT_STEP_M, PAVED_BEYOND_M)]
    along = [
        0 <= x <= runway.length_m and abs(y) < _LEAD_BESIDE_M and abs(math.sin(yaw)) < _ALIGNED
        for x, y, yaw in poses
    ]
    lines: list[list[tuple[float, float]]] = []
    start = 0
    for on_centreline, group in groupby(along):
        end = start + len(list(group))
        if not on_centreline:
            lines.append([(x, y) for x, y, _ in poses[start:end]])
            leads = round(_LEAD_M / _PAINT_STEP_M)
            beside = [math.copysign(_LEAD_BESIDE_M, poses[at][1]) for at in (start, end - 1)]
            lines[-1][:0] = [(x, beside[0]) for x, _, _ in poses[max(start - leads, 0):start]]
            lines[-1] += [(x, beside[1]) for x, _, _ in poses[end:end + leads]]
        start = end
    return tuple(map(tuple, lines))


def _rounded(points: Polygon, radii_m: Sequence[float]) -> tuple[Leg, ...]:
    """Straight legs and arcs through points."""
    ways = [(x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in pairwise(points)]
    lengths = [math.hypot(*way) for way in ways]
    yaws = [math.atan2(dy, dx) for dx, dy in ways]
    for number, length_m in enumerate(lengths):
        if length_m < 0.01:
            raise ValueError(f'the points {number + 1} and {number + 2} are the same')
    turns = [math.remainder(after - before, math.tau) for before, after in pairwise(yaws)]
    # How much of the way before and after a corner its arc replaces.
    cuts = [
        radius_m * math.tan(abs(turn) / 2) if abs(turn) < math.pi - 0.01 else math.inf
        for turn, radius_m in zip(turns, radii_m, strict=True)
    ]
    legs: list[Leg] = []
    start_m = 0.0
    for number, length_m in enumerate(lengths):
        before = cuts[number - 1] if number else 0.0
        after = cuts[number] if number < len(cuts) else 0.0
        if before + after > length_m + 1e-9:
            raise ValueError(
                f'between the points {number + 1} and {number + 2} are {length_m:.1f} m, '
                f'and the arcs there need {before + after:.1f} m'
            )
        yaw = yaws[number]
        x_m, y_m = (
            at + before / length_m * way
            for at, way in zip(points[number], ways[number], strict=True)
        )
        straight_m = max(length_m - before - after, 0.0)
        legs.append(Leg(
            x_m=x_m, y_m=y_m, yaw_rad=yaw, length_m=straight_m, curvature=0.0, start_m=start_m
        ))
        start_m += straight_m
        if number < len(turns) and abs(turns[number]) > _STRAIGHT_RAD:
            corner_x, corner_y = points[number + 1]
            radius_m = radii_m[number]
            arc_m = abs(turns[number]) * radius_m
            legs.append(Leg(
                x_m=corner_x - after * math.cos(yaw), y_m=corner_y - after * math.sin(yaw),
                yaw_rad=yaw, length_m=arc_m, curvature=math.copysign(1 / radius_m, turns[number]),
                start_m=start_m,
            ))
            start_m += arc_m
    return tuple(legs)


def check_room(track: Track) -> None:
    """Check that a track is farther from itself than it is wide.

    Raises:
        ValueError: a point of its edges is nearer to another part of it.
    """
    for distance_m in track.samples(_CHECKED_EVERY_M):
        for side_m in (-track.half_width_m, track.half_width_m):
            x_m, y_m, _ = track.pose(distance_m, side_m)
            found_m = track.measure(x_m, y_m).distance_m
            if abs(found_m - distance_m) > 1e-3:
                raise ValueError(
                    f'its edge beside {distance_m:.0f} m is nearer to what it is at {found_m:.0f} m'
                )
