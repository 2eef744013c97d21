"""Bodies of what stands on the ground: what the camera draws, and what the aircraft can hit.

A body is made of parts, each a row of rings (polygons of equal numbers of corners) with its flanks
and two ends. Coordinates: x forward, y left, z up from the ground below the middle [m].
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.traffic.traffic import KINDS, Size

Vectors = NDArray[np.float64]
Points = tuple[tuple[float, float], ...]

PAINT = 'paint'
"""Stands for the colour of the object."""
UNSEEN = ''
"""Stands for a part that is not drawn: what can be hit, of a body of many small parts."""
_OUTSIDE_M = 0.05
_COLOURS = {
    'white': (232, 232, 226), 'yellow': (222, 186, 36), 'orange': (232, 92, 24),
    'red': (176, 34, 30), 'blue': (44, 74, 148), 'green': (56, 112, 62), 'grey': (124, 127, 130),
    'black': (34, 34, 36), 'glass': (38, 48, 58), 'rubber': (24, 24, 26), 'skin': (198, 152, 122),
    'trousers': (40, 46, 66),
}
"""Daylight colours 0..255."""


def daylight_colour(word: str) -> tuple[int, int, int]:
    """Red, green and blue of a colour word in daylight, 0..255."""
    return _COLOURS[word]


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part of a body.

    Attributes:
        corners: (n, 3) [m].
        faces: convex polygons of indices of corners, counter-clockwise seen from outside.
        colour: word of its colour, :data:`PAINT` or :data:`UNSEEN`.
        hits: whether it counts for what the aircraft can hit.
        detail: whether it lies on the part before it in the body, and is drawn right after it.
    """

    corners: Vectors
    faces: tuple[tuple[int, ...], ...]
    colour: str
    hits: bool
    detail: bool = False


@dataclass(frozen=True, kw_only=True)
class Outline:
    """Plan of a part that can be hit.

    Attributes:
        low_m, high_m: its height above ground.
        hull: convex, counter-clockwise, (x, y) in the object's frame [m].
    """

    low_m: float
    high_m: float
    hull: Points


@lru_cache(maxsize=64)
def body(kind: str, size: Size) -> tuple[Part, ...]:
    """The parts of a solid kind, of a size."""
    usual = KINDS[kind].size
    scale = np.array(size) / np.array(usual)
    return tuple(
        dataclasses.replace(part, corners=part.corners * scale)
        for part in _BODIES[kind]()
    )


@lru_cache(maxsize=64)
def outlines(kind: str, size: Size) -> tuple[Outline, ...]:
    """Plans of the parts of a solid kind that can be hit."""
    return tuple(
        Outline(
            low_m=float(part.corners[:, 2].min()), high_m=float(part.corners[:, 2].max()),
            hull=hull(part.corners[:, :2].tolist()),
        )
        for part in body(kind, size) if part.hits
    )


def hull(points: Sequence[Sequence[float]]) -> Points:
    """Convex hull, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})

    def chain(row: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        found: list[tuple[float, float]] = []
        for x, y in row:
            while len(found) > 1:
                (ax, ay), (bx, by) = found[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                found.pop()
            found.append((x, y))
        return found[:-1]

    return tuple(chain(ordered) + chain(ordered[::-1]))


def _loft(
    rings: Sequence[Any], colour: str, *, hits: bool = False, ends: bool = True
) -> Part:
    """A part between rings in a row, ``(corners, 3)`` each; without ends only its flanks."""
    corners = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    count, last = len(rings[0]), len(corners)
    flanks = [
        (start + k, start + (k + 1) % count, start + count + (k + 1) % count, start + count + k)
        for start in range(0, last - count, count) for k in range(count)
    ]
    caps = [tuple(range(count)), tuple(range(last - count, last))] if ends else []
    middle = corners.mean(axis=0)
    faces = [*flanks, *caps]
    return Part(
        corners=corners, colour=colour, hits=hits,
        faces=tuple(_outwards(corners, face, middle) for face in faces),
    )


def _outwards(corners: Vectors, face: tuple[int, ...], middle: Vectors) -> tuple[int, ...]:
    points = corners[list(face)]
    normal = face_normal(points)
    return face if normal @ (points.mean(axis=0) - middle) >= 0 else face[::-1]


def face_normal(points: Vectors) -> Vectors:
    """Unit normal of a polygon (n, 3) by Newell's method; zero where it has no area."""
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)
    length = math.sqrt(float(normal @ normal))
    return np.asarray(normal / length if length > 1e-12 else normal)


def _box(
    x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], colour: str, *,
    hits: bool = False, top: float = 1.0, ahead: float = 0.0, ends: bool = True,
) -> Part:
    """A box; its top is ``top`` times as wide and long, and ``ahead`` further forward [m].

    Without ends it has neither top nor bottom, as bands and windows on another part.
    """
    middle = (sum(x) / 2, sum(y) / 2)
    rings = [
        [
            (middle[0] + share * (a - middle[0]) + shift, middle[1] + share * (b - middle[1]), up)
            for a, b in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))
        ]
        for up, share, shift in ((z[0], 1.0, 0.0), (z[1], top, ahead))
    ]
    return _loft(rings, colour, hits=hits, ends=ends)


def _tube(
    stations: Sequence[tuple[float, float, float, float]], colour: str, *, hits: bool = False,
    sides: int = 12, power: float = 2.6,
) -> Part:
    """A fuselage through stations (x, half width, low, high), a superellipse at each."""
    angles = np.arange(sides) * (2 * math.pi / sides)
    across = np.sign(np.cos(angles)) * np.abs(np.cos(angles)) ** (2 / power)
    upwards = np.sign(np.sin(angles)) * np.abs(np.sin(angles)) ** (2 / power)
    return _loft([
        np.column_stack([
            np.full(sides, x), half * across, (low + high) / 2 + (high - low) / 2 * upwards,
        ])
        for x, half, low, high in stations
    ], colour, hits=hits)


def _pillar(
    centre: tuple[float, float], stations: Sequence[tuple[float, float]], colour: str, *,
    sides: int = 10, hits: bool = False,
) -> Part:
    """A round body around an upright axis, by height and radius [m]."""
    return _loft([
        [
            (centre[0] + radius * math.cos(turn), centre[1] + radius * math.sin(turn), height)
            for turn in (2 * math.pi * k / sides for k in range(sides))
        ]
        for height, radius in stations
    ], colour, hits=hits)


def _wheel(x: float, y: float, radius: float, width: float, *, hits: bool = False) -> Part:
    turns = [2 * math.pi * (k + 0.5) / 10 for k in range(10)]
    return _loft([
        [(x + radius * math.cos(a), y + side, radius + radius * math.sin(a)) for a in turns]
        for side in (-width / 2, width / 2)
    ], 'rubber', hits=hits)


def _bar(start: Sequence[float], end: Sequence[float], width: float, colour: str) -> Part:
    """A beam between two points, in the plane across the aircraft."""
    half = width / 2
    return _loft([
        [(x - half, y, z - half), (x + half, y, z - half), (x + half, y, z + half),
         (x - half, y, z + half)]
        for x, y, z in (start, end)
    ], colour)


def _wing(side: int, root: tuple[float, ...], tip: tuple[float, ...], colour: str) -> Part:
    """A wing between two sections (y, leading edge, trailing edge, low, high)."""
    return _loft([
        [(front, side * y, (low + high) / 2), (front - 0.3 * (front - rear), side * y, high),
         (rear, side * y, (low + high) / 2), (front - 0.3 * (front - rear), side * y, low)]
        for y, front, rear, low, high in (root, tip)
    ], colour, hits=True)


def _with(part: Part, *details: Part) -> tuple[Part, ...]:
    """A part with others on it, in the order in which they cover each other."""
    below = part, *details
    return part, *(
        dataclasses.replace(_outside(one, below[:count]), detail=True)
        for count, one in enumerate(details, 1)
    )


def _outside(part: Part, others: Sequence[Part]) -> Part:
    """A part without the faces that look into others: it would be seen through these."""
    return dataclasses.replace(part, faces=tuple(
        face for face in part.faces
        if not any(_holds(other, _ahead(part, face)) for other in others)
    ))


def _ahead(part: Part, face: tuple[int, ...]) -> Vectors:
    """A point a little outside the middle of a face."""
    points = part.corners[list(face)]
    return np.asarray(points.mean(axis=0) + _OUTSIDE_M * face_normal(points))


def _holds(part: Part, point: Vectors) -> bool:
    """Whether a point is within a part, by the solid angle of its faces (van Oosterom, Strackee).

    A part without ends holds nothing.
    """
    angle = 0.0
    for face in part.faces:
        first, *rest = part.corners[list(face)] - point
        for second, third in itertools.pairwise(rest):
            a, b, c = (math.sqrt(float(one @ one)) for one in (first, second, third))
            volume = float(first @ np.cross(second, third))
            angle += 2 * math.atan2(volume, a * b * c + c * float(first @ second)
                                    + b * float(first @ third) + a * float(second @ third))
    return angle > 3 * math.pi


@cache
def _aircraft() -> tuple[Part, ...]:
    """A single-engine high-wing aircraft, 12.7 m by 15.9 m by 4.5 m, nose at +5.9 m."""
    fin = [
        [(front, -half, z), (front, half, z), (rear, half, z), (rear, -half, z)]
        for z, front, rear, half in ((2.3, -4.7, -6.75, 0.09), (4.5, -6.05, -6.8, 0.04))
    ]
    wing = (0.0, 1.45, -0.53, 2.86, 3.12), (7.95, 1.25, 0.05, 3.22, 3.34)
    tail = (0.0, -5.5, -6.75, 2.35, 2.5), (3.1, -5.75, -6.6, 2.4, 2.46)
    return (
        *_with(
            _tube([
                (5.45, 0.36, 1.35, 2.15), (4.6, 0.58, 1.1, 2.35), (2.9, 0.76, 0.95, 2.5),
                (1.9, 0.8, 0.9, 3.0), (-1.6, 0.8, 0.9, 3.0), (-4.4, 0.42, 1.5, 2.8),
                (-6.7, 0.1, 2.05, 2.5),
            ], 'white', hits=True),
            _tube([(2.86, 0.72, 2.26, 2.56), (1.93, 0.77, 2.3, 2.98)], 'glass', sides=8, power=4.0),
            _box((-1.5, 1.75), (-0.805, 0.805), (2.12, 2.56), 'glass', ends=False),
            _box((-1.55, 2.8), (-0.815, 0.815), (1.45, 1.68), PAINT, ends=False),
        ),
        *_with(
            _box((5.48, 5.56), (-0.09, 0.09), (0.72, 2.78), 'rubber'),
            _tube([(5.5, 0.2, 1.55, 1.95), (5.9, 0.05, 1.7, 1.8)], 'grey', sides=8, power=2.0),
        ),
        *(
            part for side in (1, -1) for part in (
                *_with(
                    _bar((0.85, side * 0.72, 1.25), (0.75, side * 3.8, 2.92), 0.14, 'white'),
                    _wing(side, *wing, 'white'),
                ),
                _wing(side, *tail, 'white'),
                *_with(
                    _wheel(-0.1, side * 1.78, 0.38, 0.24, hits=True),
                    _bar((-0.1, side * 0.5, 1.05), (-0.1, side * 1.72, 0.42), 0.16, 'grey'),
                ),
            )
        ),
        _loft(fin, PAINT, hits=True),
        *_with(
            _wheel(3.85, 0.0, 0.31, 0.2, hits=True),
            _box((3.75, 3.95), (-0.09, 0.09), (0.3, 1.2), 'grey'),
        ),
    )


@cache
def _vehicle() -> tuple[Part, ...]:
    """An airport's van, 5.4 m by 2.1 m by 2.2 m."""
    body = _box((-2.65, 2.65), (-1.02, 1.02), (0.3, 1.12), PAINT)
    return (
        *(
            _outside(_wheel(x, y, 0.37, 0.26), [body])
            for x in (-1.7, 1.75) for y in (-0.92, 0.92)
        ),
        *_with(
            body,
            _box((-2.68, 2.68), (-1.03, 1.03), (0.42, 0.6), 'rubber', ends=False),
            _box((2.6, 2.69), (0.6, 0.95), (0.72, 0.92), 'white'),
            _box((2.6, 2.69), (-0.95, -0.6), (0.72, 0.92), 'white'),
            _box((-2.69, -2.6), (0.75, 0.98), (0.75, 1.1), 'red'),
            _box((-2.69, -2.6), (-0.98, -0.75), (0.75, 1.1), 'red'),
            _box((-2.6, 2.15), (-1.0, 1.0), (1.12, 1.98), PAINT, top=0.86, ahead=-0.35),
            _box((-0.1, 1.2), (-0.99, 0.99), (1.22, 1.82), 'glass', top=0.9, ahead=-0.1,
                 ends=False),
            _box((1.0, 2.1), (-0.84, 0.84), (1.18, 1.86), 'glass', top=0.8, ahead=-0.42,
                 ends=False),
            _box((-2.58, -2.3), (-0.8, 0.8), (1.3, 1.75), 'glass', top=0.95, ends=False),
            _box((-0.6, -0.2), (-0.55, 0.55), (1.98, 2.16), 'orange', top=0.9),
        ),
        _box((-2.7, 2.7), (-1.05, 1.05), (0.0, 2.2), UNSEEN, hits=True),
    )


@cache
def _cone() -> tuple[Part, ...]:
    return (
        *_with(
            _box((-0.2, 0.2), (-0.2, 0.2), (0.0, 0.05), 'rubber'),
            _pillar((0.0, 0.0), [(0.05, 0.14), (0.30, 0.10)], PAINT),
            _pillar((0.0, 0.0), [(0.30, 0.10), (0.52, 0.066)], 'white'),
            _pillar((0.0, 0.0), [(0.52, 0.066), (0.75, 0.03)], PAINT),
        ),
        _box((-0.2, 0.2), (-0.2, 0.2), (0.0, 0.75), UNSEEN, hits=True),
    )


@cache
def _person() -> tuple[Part, ...]:
    return (
        _box((-0.10, 0.10), (0.03, 0.18), (0.0, 0.85), 'trousers'),
        _box((-0.10, 0.10), (-0.18, -0.03), (0.0, 0.85), 'trousers'),
        *_with(
            _box((-0.12, 0.12), (-0.20, 0.20), (0.80, 1.45), PAINT, top=1.08),
            _box((-0.125, 0.125), (-0.212, 0.212), (1.04, 1.12), 'white', ends=False),
            _pillar((0.0, 0.0), [(1.45, 0.05), (1.52, 0.09), (1.64, 0.1)], 'skin', sides=8),
            _pillar((0.0, 0.0), [(1.62, 0.115), (1.70, 0.11), (1.75, 0.05)], 'white', sides=8),
        ),
        _box((-0.08, 0.08), (0.21, 0.275), (0.82, 1.42), PAINT, top=0.95),
        _box((-0.08, 0.08), (-0.275, -0.21), (0.82, 1.42), PAINT, top=0.95),
        _box((-0.175, 0.175), (-0.275, 0.275), (0.0, 1.75), UNSEEN, hits=True),
    )


_BODIES = {
    'aircraft': _aircraft, 'vehicle': _vehicle, 'cone': _cone, 'person': _person,
}
