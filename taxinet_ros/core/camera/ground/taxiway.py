"""Taxiways and aprons in the ground's texture: of a track, and of a whole airport.

An airport's lines have X-Plane's types (apt.dat 1200); the sizes of their stripes are those of FAA
AC 150/5340-1, chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import (
    STANDARD,
    Grid,
    GroundStyle,
    coverage,
    with_surface,
)
from taxinet_ros.core.camera.texture import Floats, smooth_noise
from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.place import AirportGround
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import PAVED_BEYOND_M, Track, painted_line

LINE_WIDTH_M = 0.30
"""The wider of the circular's sizes, 6 and 12 in."""
_YELLOW = np.array([205.0, 163.0, 52.0], np.float32)
_WHITE = np.array([206.0, 205.0, 200.0], np.float32)
_BLACK = np.array([38.0, 38.0, 38.0], np.float32)
_STEP_M, _OVERLAP_M = 4.0, 0.5
"""Length of the pieces that are filled, and how far they overlap."""
_SHADE = 7.0
"""Darkening of the taxiway's asphalt, in display codes."""
_RUNWAY_EDGE_M = 1.0


class Stripe(NamedTuple):
    """One stripe of a painted line.

    Attributes:
        left_m: distance of its middle to the left of the line [m].
        width_m: width [m].
        dash_m, gap_m: lengths of dashes and gaps of a broken stripe [m]; 0 if it is solid.
        start_m: where the first dash begins [m].
    """

    left_m: float
    width_m: float
    dash_m: float = 0.0
    gap_m: float = 0.0
    start_m: float = 0.0


_YELLOW_LINES = {
    1: (Stripe(0.0, LINE_WIDTH_M),),
    2: (Stripe(0.0, 0.15, 0.9, 0.9),),
    3: (Stripe(0.15, 0.15), Stripe(-0.15, 0.15)),
    4: (
        Stripe(0.9, 0.3), Stripe(0.3, 0.3),
        Stripe(-0.3, 0.3, 0.9, 0.9), Stripe(-0.9, 0.3, 0.9, 0.9),
    ),
    5: (Stripe(0.15, 0.15), Stripe(-0.15, 0.15, 0.9, 0.9)),
    6: (Stripe(0.6, 0.3), Stripe(-0.6, 0.3), Stripe(0.0, 1.2, 0.3, 2.7)),
    7: (
        Stripe(0.0, LINE_WIDTH_M), Stripe(0.375, 0.15, 2.7, 0.9), Stripe(-0.375, 0.15, 2.7, 0.9),
    ),
    8: (Stripe(0.0, 0.15, 1.8, 5.4),),
    9: (Stripe(0.15, 0.15, 1.8, 5.4), Stripe(-0.15, 0.15, 1.8, 5.4)),
}
"""Taxiway centreline, boundary, edge, holding positions (runway, other, ILS), centreline in safety
zone, lanes of a queue."""
_WHITE_LINES = {
    20: (Stripe(0.0, 0.15),),
    21: (Stripe(0.15, 0.3, 0.6, 0.6), Stripe(-0.15, 0.3, 0.6, 0.6, 0.6)),
    22: (Stripe(0.0, 0.15, 4.5, 7.5),),
}
"""Roads: solid, chequered, broken."""
_BORDERED = {50 + style: stripes for style, stripes in _YELLOW_LINES.items()}
"""The yellow ones with a black border."""
_BORDER_M = 0.15
LINES = {**_YELLOW_LINES, **_BORDERED, **_WHITE_LINES}
"""Stripes by type of line."""


def lay_airport(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway, airport: AirportGround
) -> None:
    """Draw the pavements and lines of an airport over the ground.

    Pavement that is neither asphalt nor concrete, and lines of other types than :data:`LINES`,
    are not drawn; crossing runways are drawn elsewhere.

    Args:
        block: colours of the texels of ``grid``, (rows, columns, 3) uint8 RGB.
        grid: where they lie.
        style: shades.
        runway: on which no other pavement is laid, but paint is.
        airport: what is drawn.
    """
    free = _off_runways(grid, runway)
    for surface in ('concrete', 'asphalt'):
        paved = np.zeros(grid.shape, np.float32)
        for area in airport.pavements:
            if area.surface == surface:
                rows, columns, share = coverage(area.outline, grid, area.holes)
                np.maximum(paved[rows, columns], share, out=paved[rows, columns])
        if paved.any():
            _lay_pavement(block, grid, with_surface(style, runway.surface, surface), paved * free)
    lines = [
        line for line in airport.lines if line.style in LINES and _in_view(line.points, grid)
    ]
    for styles, colour, border_m in (
        (_BORDERED.keys(), _BLACK, _BORDER_M),
        (_YELLOW_LINES.keys() | _BORDERED.keys(), _YELLOW, 0.0),
        (_WHITE_LINES.keys(), _WHITE, 0.0),
    ):
        of_colour = [(line.points, LINES[line.style]) for line in lines if line.style in styles]
        _paint(block, grid, style, of_colour, colour, border_m)


def _off_runways(grid: Grid, runway: Runway) -> NDArray[np.bool_]:
    """Texels that are neither on the runway nor on one that crosses it."""
    x, y = grid.centres(slice(0, grid.rows))
    free = ~((np.abs(y) <= runway.half_width_m) & (x >= 0) & (x <= runway.length_m))
    for crossing in runway.crossings:
        aside = (x - crossing.x_m) * math.sin(crossing.yaw_rad) - y * math.cos(crossing.yaw_rad)
        free &= np.abs(aside) > crossing.width_m / 2 + _RUNWAY_EDGE_M
    return free


def _in_view(points: Polygon, grid: Grid) -> bool:
    rows, columns = [grid.row(x) for x, _ in points], [grid.column(y) for _, y in points]
    return (
        max(rows) >= 0 and min(rows) <= grid.rows and max(columns) >= 0
        and min(columns) <= grid.columns
    )


def _paint(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle,
    lines: Iterable[tuple[Polygon, Iterable[Stripe]]], colour: Floats, border_m: float = 0.0,
) -> None:
    """Paint the stripes of lines in one colour, each wider by a border on both sides."""
    cover = _cover(grid, (
        ribbon for points, stripes in lines for stripe in stripes
        for ribbon in _ribbons(
            _dashes(_beside(points, stripe.left_m), stripe), stripe.width_m / 2 + border_m
        )
    ))
    if cover.any():
        _lay_paint(block, grid, style, cover, colour)


def _beside(points: Polygon, left_m: float) -> Polygon:
    """A line parallel to another, at a distance to its left [m]."""
    if not left_m:
        return points
    way = np.array([point for point, following in pairwise((*points, None)) if point != following])
    ahead = np.diff(way, axis=0)
    ahead /= np.hypot(*ahead.T)[:, None]
    at = np.concatenate([ahead[:1], ahead[:-1] + ahead[1:], ahead[-1:]])
    at /= np.maximum(np.hypot(*at.T), 0.2)[:, None]
    moved = way + left_m * np.stack([-at[:, 1], at[:, 0]], axis=1)
    return tuple(map(tuple, moved.tolist()))


def _dashes(points: Polygon, stripe: Stripe) -> Iterable[Polygon]:
    """The pieces of a line that a stripe paints."""
    if not (stripe.dash_m and points):
        yield points
        return
    way = np.array(points)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    for start in np.arange(stripe.start_m, along[-1], stripe.dash_m + stripe.gap_m):
        end = min(start + stripe.dash_m, along[-1])
        within = along[(along > start) & (along < end)]
        at = np.concatenate([[start], within, [end]])
        yield tuple(zip(
            np.interp(at, along, way[:, 0]).tolist(), np.interp(at, along, way[:, 1]).tolist(),
            strict=True,
        ))


def pave_track(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway, track: Track
) -> None:
    """Draw the pavement of a track over the ground, except on runways.

    Args:
        block: colours of the texels of ``grid``, (rows, columns, 3) uint8 RGB.
        grid: where they lie.
        style: shades.
        runway: on which no other pavement is laid.
        track: that is drawn.
    """
    _lay_pavement(block, grid, style, _cover(grid, _strip(track)) * _off_runways(grid, runway))


def paint_track(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway, track: Track
) -> None:
    """Paint the centreline of a track, also on the runway; arguments as :func:`pave_track`."""
    paint = _cover(grid, _ribbons(painted_line(track, runway), LINE_WIDTH_M / 2))
    _lay_paint(block, grid, style, paint, _YELLOW)


def _lay_pavement(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, paved: Floats
) -> None:
    mottle = smooth_noise(style.seed + 71, grid.shape, (6 / grid.dx_m, 6 / grid.dy_m))
    there = paved > 0
    shade = style.asphalt - _SHADE + 2.5 * style.mottle * mottle[there]
    _blend(block, there, shade[:, None] * np.array(style.asphalt_tint, np.float32), paved)


def _lay_paint(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, cover: Floats, colour: Floats
) -> None:
    patchy = smooth_noise(style.seed + 72, grid.shape, (2 / grid.dx_m, 2 / grid.dy_m))
    cover *= np.clip(0.9 - 0.1 * style.wear * (1 + patchy), 0.3, 0.95)
    _blend(block, cover > 0, colour * (style.paint / STANDARD.paint), cover)


def _blend(
    block: NDArray[np.uint8], there: NDArray[np.bool_], colour: Floats, share: Floats
) -> None:
    ground = block[there].astype(np.float32)
    ground += share[there][:, None] * (colour.astype(np.float32) - ground)
    block[there] = np.clip(ground, 0, 255)


def _cover(grid: Grid, polygons: Iterable[Polygon]) -> Floats:
    """Share of each texel under the union of polygons, which overlap where they continue."""
    cover = np.zeros(grid.shape, np.float32)
    for polygon in polygons:
        rows, columns, share = coverage(polygon, grid)
        np.maximum(cover[rows, columns], share, out=cover[rows, columns])
    return cover


def _strip(track: Track) -> Iterable[Polygon]:
    """The pavement in pieces from edge to edge."""
    for start_m, end_m in pairwise(track.samples(_STEP_M, PAVED_BEYOND_M)):
        ends = start_m - _OVERLAP_M, end_m
        right, left = (track.edge(side * track.half_width_m, ends) for side in (-1, 1))
        yield *right, *reversed(left)


def _ribbons(lines: Iterable[Polygon], half_m: float) -> Iterable[Polygon]:
    """Lines of a width, in pieces."""
    for line in lines:
        for (x0, y0), (x1, y1) in pairwise(line):
            length_m = math.hypot(x1 - x0, y1 - y0)
            if not length_m:
                continue
            ahead_x, ahead_y = (x1 - x0) / length_m, (y1 - y0) / length_m
            left_x, left_y = -ahead_y * half_m, ahead_x * half_m
            x0, y0 = x0 - _OVERLAP_M / 5 * ahead_x, y0 - _OVERLAP_M / 5 * ahead_y
            yield (
                (x0 - left_x, y0 - left_y), (x1 - left_x, y1 - left_y),
                (x1 + left_x, y1 + left_y), (x0 + left_x, y0 + left_y),
            )
