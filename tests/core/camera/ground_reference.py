"""The ground through a pinhole, pixel by pixel, by the rules that are written down: numpy only.

A thousand times as slow as :mod:`taxinet_ros.core.camera.pixels`, which gives the same bytes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground import atlas as ground
from taxinet_ros.core.camera.ground import view as ground_view
from taxinet_ros.core.camera.ground.atlas import Layout
from taxinet_ros.core.camera.pixels import Sight

Floats = NDArray[np.float32]
Image = NDArray[np.uint8]
Form = tuple[float, float, float]

ONE = np.float32(1)


def fused(a: Floats | np.float32, b: Floats | np.float32, c: Floats | np.float32) -> Floats:
    """A b + c in single precision, rounded once."""
    a, b, c = (np.asarray(x, np.longdouble) for x in (a, b, c))
    return (a * b + c).astype(np.float32)


def evaluate(form: Form, uw: Floats, w: Floats) -> Floats:
    by_uw, by_w, constant = (np.float32(x) for x in form)
    return fused(uw, by_uw, fused(w, by_w, constant))


def power_of_two(numbers: Floats) -> Floats:
    """Largest one not above each number."""
    return np.float32(2) ** (np.frexp(numbers)[1] - 1).astype(np.float32)


def clipped(numbers: Floats, least: float, most: float) -> Floats:
    return np.minimum(np.maximum(numbers, np.float32(least)), np.float32(most))


def looked_up(texture: Image, rows: Floats, columns: Floats) -> NDArray[np.int64]:
    """Between four texels, in steps of 1/32 of one; beyond the border the border goes on."""
    y, x = (np.rint(c * np.float32(32)).astype(np.int64) for c in (rows, columns))
    down, right = (y % 32)[..., None], (x % 32)[..., None]

    def texels(below: int, beside: int) -> NDArray[np.int64]:
        row = np.clip(y // 32 + below, 0, texture.shape[0] - 1)
        column = np.clip(x // 32 + beside, 0, texture.shape[1] - 1)
        return texture[row, column].astype(np.int64)

    upper = texels(0, 0) * (32 - right) + texels(0, 1) * right
    lower = texels(1, 0) * (32 - right) + texels(1, 1) * right
    return (upper * (32 - down) + lower * down + 512) // 1024


def ground_picture(
    atlas: Image, grain: Image, neutral: Image, sight: Sight, camera: NDArray[np.float64],
    dither: Floats, layout: Layout,
) -> Image:
    """What a view shows of these textures; ``grain`` and ``neutral`` have the gain in them."""
    width = dither.shape[1]
    columns, rows = sight.fall()
    fall = columns[None, :] + rows[:, None]
    fall = np.maximum(fall, np.float32(ground_view._LEAST_FALL))
    w = ONE / fall
    uw = w * np.arange(width, dtype=np.float32)
    common = fall * fall * dither
    levels = []
    for axis, texel_m in enumerate((layout.row_m, layout.fine_m)):
        by_column, by_row = sight.density(axis, texel_m)
        levels.append(
            power_of_two(np.minimum(by_row[:, None], by_column[None, :]) * common)
        )

    colour = looked_up(atlas, *_on_strip(layout, sight, levels, uw, w))
    factor = np.broadcast_to(neutral.astype(np.int64), colour.shape).copy()
    first = sight.first_row_nearer_than(ground_view._GRAIN_REACH_M)
    factor[first:] = looked_up(grain, *_in_tile(layout, sight, camera, levels, uw, w))[first:]
    scale = np.float32(1 / (ground.GRAIN_NEUTRAL * ground_view._FINER_CODES))
    product = colour.astype(np.float32) * scale * factor.astype(np.float32)
    return np.clip(np.rint(product), 0, 255).astype(np.uint8)


def _on_strip(
    layout: Layout, sight: Sight, levels: list[Floats], uw: Floats, w: Floats
) -> tuple[Floats, Floats]:
    rows, columns = layout.rows, layout.columns
    end = 2 * rows
    along = evaluate(
        sight.coordinate(0, layout.row_m, -layout.start_x_m / layout.row_m - end), uw, w
    )
    scale = clipped(levels[0], 2.0 ** (1 - ground.ROW_LEVELS), 1)
    row = clipped(along, 16 - end, rows - 16 - end) * scale + np.float32(end - 0.5)

    # The ruler across is coarse beyond the fine half on both sides of the middle, and bent there.
    end, finer = 2 * columns, ground.COARSE_M / ground.FINE_M
    middle, half = (columns / 2 - end) / finer, layout.fine_half_m / layout.coarse_m
    begin = middle - layout.middle_y_m / layout.coarse_m
    across = evaluate(sight.coordinate(1, layout.coarse_m, begin), uw, w)
    inside = clipped(across, middle - half, middle + half)
    coarser = np.float32(2.0 ** round(math.log2(finer)))
    beyond = np.abs(across - inside) > np.float32(1e-3)
    scale = np.where(beyond, levels[1] * coarser, levels[1]).astype(np.float32)
    scale = clipped(scale, 2.0 ** (1 - layout.column_levels), 1)
    bent = fused(inside, np.float32(finer - 1), across)
    column = clipped(bent, 4 - end, columns - 4 - end) * scale + np.float32(end - 0.5)
    return row, column


def _in_tile(
    layout: Layout, sight: Sight, camera: NDArray[np.float64], levels: list[Floats], uw: Floats,
    w: Floats,
) -> tuple[Floats, Floats]:
    texels = ground.GRAIN_TEXELS
    tile_m = texels * ground.GRAIN_M
    found = []
    for axis, texel_m in enumerate((layout.row_m, layout.fine_m)):
        finer = 2.0 ** round(math.log2(texel_m / ground.GRAIN_M))
        nearest = math.floor(camera[axis] / tile_m)
        place = evaluate(sight.coordinate(axis, tile_m, -nearest), uw, w)
        unit = np.float32(texels / finer)
        part = fused(place, unit, fused(np.floor(place), -unit, np.float32(-2) * unit))
        scale = np.minimum(levels[axis], np.float32(finer))
        found.append(part * scale + np.float32(2 * texels - 0.5))
    return found[0], found[1]
