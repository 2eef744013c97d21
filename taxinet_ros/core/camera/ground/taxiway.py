"""A taxiway in the ground's texture: the pavement along a track, and its yellow centreline."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import STANDARD, Grid, GroundStyle, coverage
from taxinet_ros.core.camera.texture import Floats, smooth_noise
from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import PAVED_BEYOND_M, Track, painted_line

LINE_WIDTH_M = 0.30
"""The wider of the circular's sizes, 6 and 12 in."""
_YELLOW = np.array([205.0, 163.0, 52.0], np.float32)
_STEP_M, _OVERLAP_M = 4.0, 0.5
"""Length of the pieces that are filled, and how far they overlap."""
_SHADE = 7.0
"""Darkening of the taxiway's asphalt, in display codes."""


def lay_taxiway(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway, track: Track
) -> None:
    """Draw pavement and paint of a track over the ground.

    Args:
        block: colours of the texels of ``grid``, (rows, columns, 3) uint8 RGB.
        grid: where they lie.
        style: shades.
        runway: on which no other pavement is laid, but paint is.
        track: that is drawn.
    """
    paved = _cover(grid, _strip(track))
    x, y = grid.centres(slice(0, grid.rows))
    paved *= ~((np.abs(y) <= runway.half_width_m) & (x >= 0) & (x <= runway.length_m))
    mottle = smooth_noise(style.seed + 71, grid.shape, (6 / grid.dx_m, 6 / grid.dy_m))
    there = paved > 0
    shade = style.asphalt - _SHADE + 2.5 * style.mottle * mottle[there]
    _blend(block, there, shade[:, None] * np.array(style.asphalt_tint, np.float32), paved)
    paint = _cover(grid, _ribbons(painted_line(track, runway), LINE_WIDTH_M / 2))
    patchy = smooth_noise(style.seed + 72, grid.shape, (2 / grid.dx_m, 2 / grid.dy_m))
    paint *= np.clip(0.9 - 0.1 * style.wear * (1 + patchy), 0.3, 0.95)
    _blend(block, paint > 0, _YELLOW * (style.paint / STANDARD.paint), paint)


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
