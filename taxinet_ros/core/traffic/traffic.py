"""Objects on the ground, where they stand, and how they move along simple paths.

A pose is a function of simulated time and, of those that react to the aircraft, of how long it has
held them (:mod:`.motion`), so graph, loop and every re-simulation have the same objects at the same
places, to the bit.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from taxinet_ros.core.documents import NamedDocument, canonical
from taxinet_ros.core.types import reached_ns

HOLD_LINE = 'hold_line'
"""The kind that is not to be crossed until it is cleared."""
COLOURS = ('white', 'yellow', 'orange', 'red', 'blue', 'green', 'grey', 'black')
NOBODY = 'nobody'
"""The word for no objects."""


class Size(NamedTuple):
    """Length along the heading, width across, and height [m]; flat things have a height of 0."""

    length_m: float
    width_m: float
    height_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """What there may be on the ground.

    Attributes:
        size: unless an object says another.
        colour: unless an object says another, one of :data:`COLOURS`.
        solid: whether it stands on the ground, and can be hit; else it lies on it as paint does.
        many: word for several of them; '' if it ends in ``s``.
    """

    size: Size
    colour: str
    solid: bool = True
    many: str = ''


KINDS = {
    'aircraft': Kind(size=Size(12.7, 15.9, 4.5), colour='blue', many='aircraft'),
    'vehicle': Kind(size=Size(5.4, 2.1, 2.2), colour='yellow'),
    'cone': Kind(size=Size(0.4, 0.4, 0.75), colour='orange'),
    'person': Kind(size=Size(0.35, 0.55, 1.75), colour='yellow'),
    'closed_marking': Kind(size=Size(18.3, 14.0, 0.0), colour='yellow', solid=False),
    'painted_over': Kind(
        size=Size(37.0, 1.3, 0.0), colour='black', solid=False, many='painted over'),
    'tyre_marks': Kind(
        size=Size(40.0, 2.4, 0.0), colour='black', solid=False, many='tyre marks'),
    'patch': Kind(size=Size(8.0, 5.0, 0.0), colour='black', solid=False, many='patches'),
    HOLD_LINE: Kind(size=Size(2.1, 22.0, 0.0), colour='yellow', solid=False),
}
"""By word. The aircraft is of a Caravan's size; the X and the hold line are as long as AC
150/5340-1 has them."""


class Pose(NamedTuple):
    """Place on the ground in ``map`` [m], and heading [rad], counter-clockwise from x."""

    x_m: float
    y_m: float
    heading_rad: float


class Held(NamedTuple):
    """How far the aircraft has held an object until a control step.

    Attributes:
        ns: time that does not count for its path [ns].
        begun: whether it may have begun its path.
        stands: whether it is held until the next step.
    """

    ns: int
    begun: bool
    stands: bool


Holds = Mapping[int, Held]
"""By number of the object, of those that react."""
NOTHING_HELD: Holds = {}
"""At the start of a run, or where nothing reacts."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Leg:
    """A straight part of a path.

    Attributes:
        x_m, y_m: its end in ``map`` [m].
        speed_mps: at which it is travelled.
        wait_s: at its end [s].
    """

    x_m: float
    y_m: float
    speed_mps: float
    wait_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GroundObject:
    """One object on the ground.

    Attributes:
        kind: one of :data:`KINDS`.
        x_m, y_m: where its middle is at the start, in ``map`` [m].
        heading_deg: where it faces at the start [deg], counter-clockwise from the runway's x.
        size: of it.
        colour: one of :data:`COLOURS`.
        wait_s: how long it stands before it begins its path [s].
        path: that it follows to its end, where it stays; it turns as something with a wheel at
            either end does.
        until_s: of a hold line: simulated time from which it may be crossed [s].
        stands_within_m: it stands, and its waits too, while the aircraft's reference point is
            nearer than this to its middle, in plan [m]; 0: it does not.
        starts_within_m: its path and ``wait_s`` begin when the aircraft first is nearer than this
            [m]; 0: with the run.
    """

    kind: str
    x_m: float
    y_m: float
    heading_deg: float
    size: Size
    colour: str
    wait_s: float = 0.0
    path: tuple[Leg, ...] = ()
    until_s: float = math.inf
    stands_within_m: float = 0.0
    starts_within_m: float = 0.0

    @property
    def reacts(self) -> bool:
        """Whether where it is depends on where the aircraft was."""
        return self.stands_within_m > 0 or self.starts_within_m > 0

    @property
    def solid(self) -> bool:
        """Whether it can be hit."""
        return KINDS[self.kind].solid

    @property
    def document(self) -> dict[str, Any]:
        """Plain values that it can be made of again; what is as usual is left out."""
        known = KINDS[self.kind]
        values: dict[str, Any] = {
            'kind': self.kind, 'x_m': self.x_m, 'y_m': self.y_m, 'heading_deg': self.heading_deg,
            **self.size._asdict(), 'colour': self.colour, 'wait_s': self.wait_s,
            'until_s': self.until_s, 'stands_within_m': self.stands_within_m,
            'starts_within_m': self.starts_within_m,
        }
        usual = {
            'heading_deg': 0.0, **known.size._asdict(), 'colour': known.colour, 'wait_s': 0.0,
            'stands_within_m': 0.0, 'starts_within_m': 0.0, 'until_s': math.inf,
        }
        values = {key: one for key, one in values.items() if usual.get(key) != one}
        if self.path:
            values['path'] = [
                {'x_m': leg.x_m, 'y_m': leg.y_m, 'speed_mps': leg.speed_mps}
                | ({'wait_s': leg.wait_s} if leg.wait_s else {})
                for leg in self.path
            ]
        return values

    @property
    def until_ns(self) -> float:
        """Simulated time from which it may be crossed [ns]."""
        return self.until_s if math.isinf(self.until_s) else reached_ns(self.until_s)

    def pose_at(self, stamp_ns: int) -> Pose:
        """Where it is at a simulated time, less that for which it was held [ns]."""
        start_rad = math.radians(self.heading_deg)
        if not self.path:
            return Pose(self.x_m, self.y_m, start_rad)
        way_m = self._way_m(stamp_ns / 1e9)
        x_m, y_m = self._point(way_m)
        half_m = self.size.length_m / 2
        # The front goes ahead of the middle as far as the way behind allows: it starts as it faces.
        front, rear = self._point(way_m + min(way_m, half_m)), self._point(way_m - half_m)
        dx, dy = front[0] - rear[0], front[1] - rear[1]
        if math.hypot(dx, dy) < 1e-6:  # where a path turns back: it faces as it came
            dx, dy = x_m - rear[0], y_m - rear[1]
        return Pose(x_m, y_m, math.atan2(dy, dx))

    @cached_property
    def _corners(self) -> tuple[tuple[float, float], ...]:
        return ((self.x_m, self.y_m), *((leg.x_m, leg.y_m) for leg in self.path))

    @cached_property
    def _ways_m(self) -> tuple[float, ...]:
        """Way to each corner [m]."""
        ways = [0.0]
        for (x, y), leg in zip(self._corners, self.path, strict=False):
            ways.append(ways[-1] + math.hypot(leg.x_m - x, leg.y_m - y))
        return tuple(ways)

    @cached_property
    def _schedule(self) -> tuple[tuple[float, float], ...]:
        """Times [s] and ways [m] between which the way grows evenly."""
        times = [(0.0, 0.0), (self.wait_s, 0.0)]
        for leg, before_m, way_m in zip(self.path, self._ways_m, self._ways_m[1:], strict=False):
            arrival_s = times[-1][0] + (way_m - before_m) / leg.speed_mps
            times += [(arrival_s, way_m), (arrival_s + leg.wait_s, way_m)]
        return tuple(times)

    def _way_m(self, time_s: float) -> float:
        number = bisect_right(self._schedule, (time_s, math.inf))
        if number == len(self._schedule):
            return self._ways_m[-1]
        (begin_s, begin_m), (end_s, end_m) = self._schedule[number - 1:number + 1]
        return begin_m + (end_m - begin_m) * (time_s - begin_s) / (end_s - begin_s)

    def _point(self, way_m: float) -> tuple[float, float]:
        """The point after a way; before the start and beyond the end it goes on straight."""
        if way_m <= 0:
            start_rad = math.radians(self.heading_deg)
            return (
                self.x_m + way_m * math.cos(start_rad), self.y_m + way_m * math.sin(start_rad)
            )
        ways = self._ways_m
        number = min(bisect_right(ways, way_m), len(ways) - 1)
        (x0, y0), (x1, y1) = self._corners[number - 1:number + 1]
        part = (way_m - ways[number - 1]) / (ways[number] - ways[number - 1])
        return x0 + part * (x1 - x0), y0 + part * (y1 - y0)


@dataclass(frozen=True, kw_only=True)
class Traffic(NamedDocument):
    """All objects on the ground of a scenario; see :func:`traffic_of`.

    Its name is their number, so that tables have ``3_objects@0123456789ab``; ``nobody`` where
    there are none.
    """

    objects: tuple[GroundObject, ...] = ()

    def pose(self, number: int, stamp_ns: int, held: Holds) -> Pose:
        """Where an object is at a simulated time [ns]; ``held``: at its control step.

        Raises:
            KeyError: it reacts to the aircraft, and how long it was held is not said.
        """
        one = self.objects[number]
        # At the start of a run nothing has been held.
        return one.pose_at(stamp_ns - (held[number].ns if one.reacts and stamp_ns else 0))

    def solids_at(self, stamp_ns: int, held: Holds) -> list[tuple[GroundObject, Pose]]:
        """Those that can be hit, and where, as :meth:`pose`."""
        return [
            (one, self.pose(number, stamp_ns, held))
            for number, one in enumerate(self.objects) if one.solid
        ]

    @property
    def words(self) -> str:
        """Number and kinds of its objects: ``2 cones and 1 hold line``."""
        numbers = Counter(one.kind for one in self.objects)
        *most, last = [
            f'{number} {kind if number == 1 else KINDS[kind].many or f"{kind}s"}'.replace('_', ' ')
            for kind, number in numbers.items()
        ] or [NOBODY]
        return f'{", ".join(most)} and {last}' if most else last

    @cached_property
    def reacting(self) -> str:
        """The first that reacts to the aircraft, in words for refusals; '' if none does."""
        return next((
            f'objects[{number}] of traffic reacts to the aircraft'
            for number, one in enumerate(self.objects) if one.reacts
        ), '')

    @cached_property
    def solids(self) -> tuple[GroundObject, ...]:
        """Those that can be hit."""
        return tuple(one for one in self.objects if one.solid)

    @cached_property
    def marks(self) -> tuple[GroundObject, ...]:
        """Those that lie flat on the ground."""
        return tuple(one for one in self.objects if not one.solid)

    @cached_property
    def hold_lines(self) -> tuple[GroundObject, ...]:
        """Those that are not to be crossed until they are cleared."""
        return tuple(one for one in self.objects if one.kind == HOLD_LINE)


def traffic_of(objects: Sequence[GroundObject]) -> Traffic:
    """Collect the objects of a scenario."""
    return Traffic(
        name=f'{len(objects)}_objects' if objects else NOBODY,
        title='others on the ground',
        document=canonical({'objects': [one.document for one in objects]}),
        shipped=not objects,
        objects=tuple(objects),
    )
