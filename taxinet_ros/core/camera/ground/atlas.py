"""Ground textures: the whole runway strip as one ripmap, and a tile of fine grain.

The strip spans x = -100..3,176.8 m in rows of 0.4 m. Its columns follow a bent ruler: 0.12 m each
within 19.2 m of the centreline, 0.9 m beyond, out to 163 m. So the paint is sharp, the atlas is
63 MB, and it is made in the memory of every process in a few tenths of a second; nothing is stored.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import (
    STANDARD,
    Grid,
    GroundStyle,
    crossing_surface,
    pavement_colours,
    runway_surface,
)
from taxinet_ros.core.camera.texture import Floats, build_ripmap, smooth_noise, white_noise
from taxinet_ros.core.place.runway import HALF_WIDTH_M

ROWS, ROW_M, ROW_LEVELS = 8192, 0.4, 10
START_X_M = -100.0
COLUMNS, COLUMN_LEVELS = 640, 6
FINE_M, COARSE_M = 0.12, 0.9
FINE_HALF_M = 19.2
_SIDE_COLUMNS = 160
HALF_SPAN_M = FINE_HALF_M + _SIDE_COLUMNS * COARSE_M

GRAIN_TEXELS, GRAIN_M, GRAIN_LEVELS = 512, 0.012, 8
GRAIN_NEUTRAL = 128
"""Neutral grain code: the product is scaled by its inverse."""


@cache
def ground_atlas() -> NDArray[np.uint8]:
    """The atlas of the standard look, made once per process."""
    return make_ground_atlas(STANDARD)


@cache
def uncrossed_atlas() -> NDArray[np.uint8]:
    """The atlas without the crossing runway, made on first use."""
    return make_ground_atlas(dataclasses.replace(STANDARD, crossing=False))


def make_ground_atlas(style: GroundStyle) -> NDArray[np.uint8]:
    """Ripmap of the ground's daylight colours, (2 * ROWS, 2 * COLUMNS, 3) uint8 RGB, read-only."""
    base = np.empty((ROWS, COLUMNS, 3), np.uint8)
    fine = Grid(rows=ROWS, columns=COLUMNS - 2 * _SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                y0_m=-FINE_HALF_M, dy_m=FINE_M)  # fmt: skip
    surface = runway_surface(fine, style)
    base[:, _SIDE_COLUMNS:-_SIDE_COLUMNS] = cv2.LUT(
        cv2.merge([surface] * 3), pavement_colours(style)
    )
    for side in (-1, 1):
        start = -HALF_SPAN_M if side < 0 else FINE_HALF_M
        grid = Grid(rows=ROWS, columns=_SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                    y0_m=start, dy_m=COARSE_M)  # fmt: skip
        target = base[:, :_SIDE_COLUMNS] if side < 0 else base[:, -_SIDE_COLUMNS:]
        target[:] = _field(grid, style, seed=style.seed + 60 + side)
    _shoulders(base, fine, style)
    atlas = build_ripmap(base, ROW_LEVELS, COLUMN_LEVELS)
    atlas.flags.writeable = False
    return atlas


def _field(grid: Grid, style: GroundStyle, seed: int) -> NDArray[np.uint8]:
    """Dry ground beside the runway, tan near it, olive grass farther out; and the crossing."""
    value = _dry_texture(grid, seed)
    _, y = grid.centres(slice(0, 1))
    grass = np.clip((np.abs(y[0]) - 55) / 40, 0, 1)[:, None]
    near, far = (np.array(t, np.float32) for t in (style.near_tint, style.far_tint))
    tint = near + (far - near) * grass
    colour = value[:, :, None] * tint[None]
    # Around the crossing only, in two halves.
    for first in (3300, 4000) if style.crossing else ():
        rows = slice(first, first + 700)
        surface, share = crossing_surface(*grid.centres(rows), COARSE_M, style)
        tinted = surface[:, :, None] * np.array(style.asphalt_tint, np.float32)
        colour[rows] += share[:, :, None] * (tinted - colour[rows])
    codes: NDArray[np.uint8] = np.clip(colour, 0, 255).astype(np.uint8)
    return codes


def _dry_texture(grid: Grid, seed: int) -> Floats:
    """Brightness factor near 1 of open ground: mottled, with a few dark cracks across it."""
    value = smooth_noise(seed, grid.shape, (30, 10))
    value *= np.float32(0.02)
    value += np.float32(0.025) * smooth_noise(seed + 10, grid.shape, (300, 30))
    value += np.float32(0.015) * white_noise(seed + 20, grid.shape)
    value += np.float32(1.0)
    rng = np.random.default_rng(seed + 30)
    for row in rng.integers(0, grid.rows, 60):
        value[row : row + 2, :70] *= np.float32(0.88)
    return value


def _shoulders(base: NDArray[np.uint8], fine: Grid, style: GroundStyle) -> None:
    """Bare tan ground between the pavement's edge and the end of the fine columns."""
    first = round(fine.column(HALF_WIDTH_M))
    count = fine.columns - first
    for side in (-1, 1):
        seed = style.seed + 80 + side
        noise = white_noise(seed, (fine.rows, count)) * np.float32(0.02)
        noise += smooth_noise(seed + 10, noise.shape, (10, 6)) * np.float32(0.02)
        noise += np.float32(1.0)
        tinted = noise[:, :, None] * np.array(style.near_tint, np.float32)
        colour = np.clip(tinted, 0, 255).astype(np.uint8)
        middle = COLUMNS // 2
        edge = middle + side * (first - fine.columns // 2)
        columns = slice(edge, edge + count) if side > 0 else slice(edge - count, edge)
        parts = (slice(0, 3480), slice(4300, fine.rows)) if style.crossing else (slice(None),)
        for rows in parts:
            base[rows, columns] = colour[rows]


@cache
def grain_atlas() -> NDArray[np.uint8]:
    """Ripmap of a 6.1 m tile of fine grain around GRAIN_NEUTRAL, a factor on the colour."""
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
