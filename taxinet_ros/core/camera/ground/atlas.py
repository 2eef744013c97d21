"""Ground textures: a whole runway strip as one ripmap, and a tile of fine grain.

The strip starts 100 m before the runway and has rows of 0.4 m. Columns are 0.12 m wide up to a few
metres beyond the runway's edges, for sharp paint, and 0.9 m wide for another 144 m. The atlas of
KMWH 04 (8,192 rows, fine to 19.2 m, coarse to 163 m from the centreline) has 63 MB. Each process
generates it in memory in a few tenths of a second; nothing is stored on disk.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import (
    Grid,
    GroundStyle,
    crossing_rows,
    crossing_surface,
    crossings,
    pavement_colours,
    runway_surface,
    standard_style,
)
from taxinet_ros.core.camera.texture import Floats, build_ripmap, smooth_noise, white_noise
from taxinet_ros.core.place.runway import Runway

ROW_M, ROW_LEVELS = 0.4, 10
START_X_M = -100.0
COLUMN_LEVELS = 6
FINE_M, COARSE_M = 0.12, 0.9
SIDE_COLUMNS = 160
_LEAST_BEYOND_M, _LEAST_BESIDE_M = 60.0, 3.9

GRAIN_TEXELS, GRAIN_M, GRAIN_LEVELS = 512, 0.012, 8
GRAIN_NEUTRAL = 128
"""Neutral grain code: the product is scaled by its inverse."""


@lru_cache(maxsize=4)
def ground_atlas(runway: Runway, *, crossing: bool = True) -> NDArray[np.uint8]:
    """Atlas of a runway in its standard style, made once per process.

    Args:
        runway: the runway.
        crossing: whether crossing runways are drawn.
    """
    return make_ground_atlas(standard_style(runway, crossing=crossing), runway)


def fine_half_m(columns: int) -> float:
    """Distance from the centreline covered by the fine columns of an atlas [m]."""
    return (columns - 2 * SIDE_COLUMNS) / 2 * FINE_M


def _shape(runway: Runway) -> tuple[int, int]:
    """Rows and columns of a runway's atlas: multiples of the coarsest level's texel."""
    rows = (runway.length_m - START_X_M + _LEAST_BEYOND_M) / ROW_M
    fine = 2 * (runway.half_width_m + _LEAST_BESIDE_M) / FINE_M
    row_block, column_block = 2 ** (ROW_LEVELS - 1), 2 ** COLUMN_LEVELS
    return (
        row_block * math.ceil(rows / row_block),
        2 * SIDE_COLUMNS + column_block * math.ceil(fine / column_block),
    )


def make_ground_atlas(style: GroundStyle, runway: Runway) -> NDArray[np.uint8]:
    """Ripmap of the ground's daylight colours, (2 * rows, 2 * columns, 3) uint8 RGB, read-only."""
    rows, columns = _shape(runway)
    half_m = fine_half_m(columns)
    base = np.empty((rows, columns, 3), np.uint8)
    fine = Grid(rows=rows, columns=columns - 2 * SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                y0_m=-half_m, dy_m=FINE_M)  # fmt: skip
    surface = runway_surface(fine, style, runway)
    base[:, SIDE_COLUMNS:-SIDE_COLUMNS] = cv2.LUT(
        cv2.merge([surface] * 3), pavement_colours(style)
    )
    for side in (-1, 1):
        start = half_m if side > 0 else -half_m - SIDE_COLUMNS * COARSE_M
        grid = Grid(rows=rows, columns=SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                    y0_m=start, dy_m=COARSE_M)  # fmt: skip
        target = base[:, :SIDE_COLUMNS] if side < 0 else base[:, -SIDE_COLUMNS:]
        target[:] = _field(grid, style, runway, seed=style.seed + 60 + side)
    _shoulders(base, fine, style, runway)
    atlas = build_ripmap(base, ROW_LEVELS, COLUMN_LEVELS)
    atlas.flags.writeable = False
    return atlas


def _field(grid: Grid, style: GroundStyle, runway: Runway, seed: int) -> NDArray[np.uint8]:
    """Ground beside the runway, near tint to far tint, with the crossings; RGB codes."""
    value = _dry_texture(grid, seed)
    _, y = grid.centres(slice(0, 1))
    grass = np.clip((np.abs(y[0]) - 55) / 40, 0, 1)[:, None]
    near, far = (np.array(t, np.float32) for t in (style.near_tint, style.far_tint))
    tint = near + (far - near) * grass
    colour = value[:, :, None] * tint[None]
    for crossing in crossings(style, runway):
        rows = crossing_rows(grid, crossing, max(abs(y[0, 0]), abs(y[0, -1])))
        surface, share = crossing_surface(*grid.centres(rows), COARSE_M, style, crossing)
        tinted = surface[:, :, None] * np.array(style.asphalt_tint, np.float32)
        colour[rows] += share[:, :, None] * (tinted - colour[rows])
    codes: NDArray[np.uint8] = np.clip(colour, 0, 255).astype(np.uint8)
    return codes


def _dry_texture(grid: Grid, seed: int) -> Floats:
    """Brightness factor near 1 of open ground: mottled, with a few dark transverse cracks."""
    value = smooth_noise(seed, grid.shape, (30, 10))
    value *= np.float32(0.02)
    value += np.float32(0.025) * smooth_noise(seed + 10, grid.shape, (300, 30))
    value += np.float32(0.015) * white_noise(seed + 20, grid.shape)
    value += np.float32(1.0)
    rng = np.random.default_rng(seed + 30)
    for row in rng.integers(0, grid.rows, 60):
        value[row : row + 2, :70] *= np.float32(0.88)
    return value


def _shoulders(
    base: NDArray[np.uint8], fine: Grid, style: GroundStyle, runway: Runway
) -> None:
    """Draw the bare ground between the pavement's edge and the end of the fine columns."""
    first = round(fine.column(runway.half_width_m))
    count = fine.columns - first
    for side in (-1, 1):
        seed = style.seed + 80 + side
        noise = white_noise(seed, (fine.rows, count)) * np.float32(0.02)
        noise += smooth_noise(seed + 10, noise.shape, (10, 6)) * np.float32(0.02)
        noise += np.float32(1.0)
        tinted = noise[:, :, None] * np.array(style.near_tint, np.float32)
        colour = np.clip(tinted, 0, 255).astype(np.uint8)
        middle = base.shape[1] // 2
        edge = middle + side * (first - fine.columns // 2)
        columns = slice(edge, edge + count) if side > 0 else slice(edge - count, edge)
        bare = np.ones(fine.rows, bool)
        for crossing in crossings(style, runway):
            paved = (min(max(round(fine.row(x)), 0), fine.rows) for x in crossing.paved_m)
            bare[slice(*paved)] = False
        base[bare, columns] = colour[bare]


@cache
def grain_atlas() -> NDArray[np.uint8]:
    """Ripmap of a 6.1 m tile of fine grain around GRAIN_NEUTRAL; multiplies the colour."""
    size = (GRAIN_TEXELS, GRAIN_TEXELS)
    grey = np.zeros(size, np.float32)
    for seed, blur_texels, amount in ((91, 0.4, 0.062), (92, 1.3, 0.022), (93, 4.0, 0.014)):
        grey += amount * _tile_noise(seed, blur_texels)
    tile = np.stack([grey + 0.012 * _tile_noise(seed, 1.5) for seed in (94, 95, 96)], axis=2)
    coded = np.clip(np.rint(GRAIN_NEUTRAL * (1 + tile)), 0, 255).astype(np.uint8)
    atlas = build_ripmap(coded, GRAIN_LEVELS, GRAIN_LEVELS)
    atlas.flags.writeable = False
    return atlas


def _tile_noise(seed: int, blur_texels: float) -> Floats:
    """Smooth noise of deviation 1, periodic at the tile's borders."""
    noise = np.random.default_rng(seed).standard_normal((GRAIN_TEXELS,) * 2, dtype=np.float32)
    pad = 32
    wide = np.pad(noise, pad, mode='wrap')
    soft = cv2.GaussianBlur(wide, (0, 0), blur_texels)[pad:-pad, pad:-pad]
    scaled: Floats = (soft / soft.std()).astype(np.float32)
    return scaled
