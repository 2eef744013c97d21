"""Outline of an aircraft as convex parts, for its shadow and for cameras that see it.

Coordinates are in the body frame: x forward, y left, z up from the reference point, in metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.files.plain_values import Section

MOST_PARTS, MOST_POINTS = 120, 40
_REACH_M = 60.0
_WHEEL_CORNERS = 8
_RING_CORNERS = 14
_THICKEST = 0.3
"""Position of a wing's greatest thickness, relative to its chord."""
_LEAST_M = 1e-3
_WHITE = (243, 242, 238)

Points = NDArray[np.float64]
Shape = tuple[Points, tuple[bool, bool]]
_CLOSED = True, True


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Part:
    """A convex part.

    Attributes:
        points: corners (n, 3) of its convex hull [m].
        colour: colour in daylight, RGB 0..255.
        caps: whether the first half of the points, and the last, form a face; False where the next
            part of a body or wing is joined.
        shades: whether it casts a shadow.
        seen: whether cameras see it.
    """

    points: Points
    colour: tuple[int, int, int]
    caps: tuple[bool, bool] = (True, True)
    shades: bool = True
    seen: bool = True


def corners_of(
    parts: Sequence[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], list[int]]:
    """Corners (N, d) of all parts, each given by its own (n, d), and the first one of each."""
    return np.concatenate(parts), np.cumsum([0, *(len(one) for one in parts[:-1])]).tolist()


def read_outline(top: Section) -> tuple[Part, ...]:
    """Read the parts under the key ``outline``.

    Raises:
        UsageError: an invalid value.
    """
    parts: list[Part] = []
    for entry in top.sections('outline', _KEYS):
        kind = entry.word('part', tuple(_KINDS))
        keys, make = _KINDS[kind]
        for key in entry:
            if key not in (*keys, *_OF_EVERY):
                raise entry.wrong(f'unknown key of a {kind}; known: {", ".join(keys)}', key)
        colour = _colour(entry)
        made = list(make(entry))
        if any(_is_line(points) for points, _ in made):
            raise entry.wrong(f'this {kind} is a line or a point, which nobody would see')
        if entry.switch('mirror', False):
            made += [(points * (1.0, -1.0, 1.0), caps) for points, caps in made]
        only = entry.word('only', _ONLY, '')
        parts += [
            Part(
                points=points, caps=caps, colour=colour, shades=only != 'picture',
                seen=only != 'shadow',
            )
            for points, caps in made
        ]
    if len(parts) > MOST_PARTS:
        raise top.wrong(f'makes {len(parts)} convex parts, more than {MOST_PARTS}', 'outline')
    return tuple(parts)


def _is_line(points: Points) -> bool:
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[1] < _LEAST_M / 2)


def _colour(entry: Section) -> tuple[int, int, int]:
    red, green, blue = entry.numbers('colour', 3, 0, 255, _WHITE)
    return round(red), round(green), round(blue)


def _rows(entry: Section, key: str, columns: str, least: int) -> list[tuple[float, ...]]:
    return entry.rows(key, columns, _REACH_M, least, MOST_POINTS)


def _hull(entry: Section) -> Iterator[Shape]:
    yield np.array(_rows(entry, 'points', 'x, y, z', 4)), _CLOSED


def _prism(entry: Section) -> Iterator[Shape]:
    """Eight corners between two rectangles across the aircraft."""
    ends = _rows(entry, 'ends', 'x, y_low, y_high, z_low, z_high', 2)
    if len(ends) != 2:
        raise entry.wrong(f'expected two, the rear one first, got {len(ends)}', 'ends')
    yield np.array([
        (x, y, z) for x, y0, y1, z0, z1 in ends for y in (y0, y1) for z in (z0, z1)
    ]), _CLOSED  # fmt: skip


def _wheel(entry: Section) -> Iterator[Shape]:
    x, y, z = entry.numbers('centre', 3, -_REACH_M, _REACH_M)
    radius = entry.number('radius', 0.02, 3.0)
    half = entry.number('width', 0.02, 3.0) / 2
    yield np.array([
        (x + radius * math.cos(a), y + w, z + radius * math.sin(a))
        for a in np.linspace(0, 2 * math.pi, _WHEEL_CORNERS, endpoint=False)
        for w in (-half, half)
    ]), _CLOSED  # fmt: skip


def _body(entry: Section) -> Iterator[Shape]:
    """Ellipses across the aircraft, joined."""
    angles = np.linspace(0, 2 * math.pi, _RING_CORNERS, endpoint=False)
    rings = [
        np.stack([
            np.full_like(angles, x), y + max(abs(wide), _LEAST_M) * np.cos(angles),
            z + max(abs(high), _LEAST_M) * np.sin(angles),
        ], axis=1)
        for x, y, z, wide, high in _rows(
            entry, 'sections', 'x, y, z, half_width, half_height', 2
        )
    ]
    yield from _joined(rings)


def _wing(entry: Section) -> Iterator[Shape]:
    """Profiles along a wing, a tailplane or a fin, joined."""
    upright = entry.switch('upright', False)
    profiles = [
        np.array([
            (x - share * chord, y + side * half * upright, z + side * half * (not upright))
            for share, half in ((0.0, 0.2 * thick), (_THICKEST, 0.5 * thick), (1.0, 0.05 * thick))
            for side in (-1, 1)
        ])
        for x, y, z, chord, thick in _rows(entry, 'sections', 'x_front, y, z, chord, thickness', 2)
    ]
    yield from _joined(profiles)


def _joined(sections: list[Points]) -> Iterator[Shape]:
    last = len(sections) - 2
    for at, ends in enumerate(pairwise(sections)):
        yield np.concatenate(ends), (at == 0, at == last)


def _rod(entry: Section) -> Iterator[Shape]:
    """A straight strut of a streamlined section."""
    ends = _rows(entry, 'ends', 'x, y, z', 2)
    if len(ends) != 2:
        raise entry.wrong(f'expected two, got {len(ends)}', 'ends')
    chord, thick = entry.number('chord', 0.005, 3.0), entry.number('thickness', 0.005, 3.0)
    first, last = (np.array(end) for end in ends)
    along = (last - first) / max(float(np.linalg.norm(last - first)), _LEAST_M)
    ahead = np.array([1.0, 0.0, 0.0]) - along * along[0]
    if np.linalg.norm(ahead) < _LEAST_M:
        ahead = np.array([0.0, 0.0, 1.0])
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(along, ahead)
    yield np.array([
        end + corner
        for end in (first, last)
        for corner in (chord / 2 * ahead, thick / 2 * aside, -chord / 2 * ahead, -thick / 2 * aside)
    ]), _CLOSED

_OF_EVERY, _ONLY = ('part', 'colour', 'mirror', 'only'), ('shadow', 'picture')
_KINDS = {
    'hull': (('points',), _hull),
    'prism': (('ends',), _prism),
    'wheel': (('centre', 'radius', 'width'), _wheel),
    'body': (('sections',), _body),
    'wing': (('sections', 'upright'), _wing),
    'rod': (('ends', 'chord', 'thickness'), _rod),
}
"""Of each kind of part its keys, and what makes points of them."""
_KEYS = tuple(dict.fromkeys((*_OF_EVERY, *(key for keys, _ in _KINDS.values() for key in keys))))
