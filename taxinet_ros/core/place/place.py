"""A place: a runway and optional airport ground data, as one frozen value with a digest."""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, pairwise

from taxinet_ros.core.documents import NamedDocument
from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import LEAST_RADIUS_M, Track, check_room, make_track, runway_track
from taxinet_ros.errors import UsageError

ROUTE_WIDTH_M, ROUTE_RADIUS_M = 15.0, 30.0
"""Of a track along taxi routes, whose nodes have neither: pavement, and arcs where they fit."""
_ROUTE_DETAIL_M = 0.5
"""Nodes of a route nearer to the straight line between others are left out."""

_Point = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Pavement:
    """A paved area beside the runway: taxiway or apron.

    Attributes:
        surface: one of :data:`~taxinet_ros.core.place.runway.SURFACES`, or ``other``.
        outline: corners (x, y) in ``map`` [m].
        holes: outlines of unpaved areas inside.
    """

    surface: str
    outline: Polygon
    holes: tuple[Polygon, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PaintedLine:
    """A painted line on the ground, such as a taxiway centreline.

    Attributes:
        style: X-Plane line type; 1 is a taxiway's solid yellow centreline.
        points: points (x, y) in ``map`` [m]; a closed line repeats the first at the end.
    """

    style: int
    points: Polygon


@dataclass(frozen=True, kw_only=True, eq=False)
class AirportGround:
    """Pavement and paint beside the runway, compared by identity."""

    pavements: tuple[Pavement, ...]
    lines: tuple[PaintedLine, ...]


@dataclass(frozen=True, kw_only=True)
class TaxiRoute:
    """An edge of the taxi route network.

    Attributes:
        name: name of the taxiway, or ''.
        one_way: whether it is used only from its first point to its last.
        on_runway: whether it is on a runway.
        points: end points (x, y) in ``map`` [m].
    """

    name: str
    one_way: bool
    on_runway: bool
    points: Polygon


@dataclass(frozen=True, kw_only=True)
class Place(NamedDocument):
    """Location of runs.

    Attributes:
        icao: ICAO code of the airport, or ''.
        runway: runway for taxiing.
        pavements, lines, routes: optional ground data of the airport.
        tracks: lines to follow other than the runway's centreline and the routes.
    """

    icao: str
    runway: Runway
    pavements: tuple[Pavement, ...] = ()
    lines: tuple[PaintedLine, ...] = ()
    routes: tuple[TaxiRoute, ...] = ()
    tracks: tuple[Track, ...] = ()

    @cached_property
    def ground(self) -> AirportGround | None:
        """Its pavements and lines; None if it has neither."""
        if not (self.pavements or self.lines):
            return None
        return AirportGround(pavements=self.pavements, lines=self.lines)

    @property
    def track_names(self) -> tuple[str, ...]:
        """All tracks: the runway's centreline, its own, and the names of its taxi routes."""
        routes = sorted({route.name for route in self.routes if route.name and not route.on_runway})
        own = dict.fromkeys(track.name for track in (runway_track(self.runway), *self.tracks))
        return *own, *(name for name in routes if name not in own)

    def track(self, word: str) -> Track:
        """A track by its name, or along taxi routes: ``A``, or ``A+B`` from A into B.

        Where the place has painted lines of its own, a taxi route gets no other.

        Raises:
            UsageError: there is none, or the routes cannot be followed.
        """
        for track in (runway_track(self.runway), *self.tracks):
            if track.name == word:
                return track
        names = word.split('+')
        if not set(names) <= set(self.track_names) - {track.name for track in self.tracks}:
            raise UsageError(
                f'scenario: track is {word!r:.60}, not one of {", ".join(self.track_names)}, '
                f'at {self.reference}'
            )
        try:
            return _track_of_routes(word, self.routes, names, painted=not self.lines)
        except ValueError as error:
            raise UsageError(f'scenario: track {word} at {self.reference}: {error}') from None


def _track_of_routes(
    word: str, routes: Sequence[TaxiRoute], names: Sequence[str], *, painted: bool
) -> Track:
    """The longest way along routes of these names, in this order.

    Of one name alone it begins at the end nearer to the runway.

    Raises:
        ValueError: they do not meet, or the aircraft could not follow.
    """
    roads: defaultdict[_Point, dict[_Point, str]] = defaultdict(dict)
    for route in routes:
        if route.name in names and not route.on_runway:
            for start, stop in pairwise(route.points):
                roads[start][stop] = route.name
                if not route.one_way:
                    roads[stop].setdefault(start, route.name)
    found: list[tuple[float, float, tuple[_Point, ...]]] = []
    for start in list(roads):
        for way in _shortest_ways(roads, start):
            passed = [name for name, _ in groupby(roads[a][b] for a, b in pairwise(way))]
            if passed == list(names):
                # The sum is exact, so a way is as long backwards.
                length_m = math.fsum(math.dist(*ends) for ends in pairwise(way))
                found.append((-round(length_m, 1), abs(start[1]), way))
    if not found:
        raise ValueError('the taxi routes of these names do not meet in this order')
    points = _simplified(min(found)[2])
    track = make_track(
        word, f'taxi route {word}', ROUTE_WIDTH_M, points, _radii(points), painted=painted
    )
    check_room(track)
    return track


def _shortest_ways(
    roads: defaultdict[_Point, dict[_Point, str]], start: _Point
) -> list[tuple[_Point, ...]]:
    """Points of the shortest way to every point (Dijkstra)."""
    ways: dict[_Point, tuple[_Point, ...]] = {}
    waiting: list[tuple[float, tuple[_Point, ...]]] = [(0.0, (start,))]
    while waiting:
        length_m, way = heapq.heappop(waiting)
        if way[-1] in ways:
            continue
        ways[way[-1]] = way
        for point in roads.get(way[-1], ()):
            if point not in ways:
                heapq.heappush(waiting, (length_m + math.dist(way[-1], point), (*way, point)))
    return list(ways.values())


def _simplified(points: Sequence[_Point]) -> tuple[_Point, ...]:
    """The same line with fewer points (Douglas and Peucker)."""
    (x0, y0), (x1, y1) = points[0], points[-1]
    length_m = math.hypot(x1 - x0, y1 - y0) or 1.0
    aside = [abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length_m for x, y in points]
    farthest = max(aside)
    if farthest <= _ROUTE_DETAIL_M:
        return points[0], points[-1]
    at = aside.index(farthest)
    return *_simplified(points[:at + 1])[:-1], *_simplified(points[at:])


def _radii(points: Sequence[_Point]) -> list[float]:
    """The radius at each corner: the usual one, or what there is room for.

    Of a way between two corners each has half.
    """
    rooms = [math.dist(*ends) / 2 for ends in pairwise(points)]
    rooms[0], rooms[-1] = 2 * rooms[0], 2 * rooms[-1]
    radii = []
    for number, (before, corner, after) in enumerate(
        zip(points, points[1:], points[2:], strict=False), start=2
    ):
        turn = math.remainder(
            math.atan2(after[1] - corner[1], after[0] - corner[0])
            - math.atan2(corner[1] - before[1], corner[0] - before[0]), math.tau,
        )
        room_m = min(rooms[number - 2], rooms[number - 1])
        bend = math.tan(min(abs(turn), math.pi - 0.01) / 2)
        radius_m = min(ROUTE_RADIUS_M, room_m / bend) if bend else ROUTE_RADIUS_M
        if radius_m < LEAST_RADIUS_M:
            raise ValueError(
                f'the turn of {abs(math.degrees(turn)):.0f} deg at its point {number} leaves room '
                f'for an arc of {radius_m:.1f} m, expected {LEAST_RADIUS_M:g} m or more'
            )
        radii.append(radius_m)
    return radii
