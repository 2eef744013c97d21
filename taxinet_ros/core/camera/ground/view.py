"""Ground in a pinhole camera: inverse mapping of image pixels into the ground's ripmaps."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.ground.atlas import (
    COARSE_M,
    FINE_M,
    GRAIN_M,
    GRAIN_NEUTRAL,
    GRAIN_TEXELS,
    ROW_LEVELS,
    Layout,
)
from taxinet_ros.core.camera.sky import GROUND_END_TAN

Floats = NDArray[np.float32]
Vectors = NDArray[np.float64]

_SHARPNESS = 0.8
_GRAIN_REACH_M = 26.0
_FINER_CODES = 1.5
"""Stretches grain times gain to the full range of codes, which reduces rounding errors."""

_LEAST_FALL = GROUND_END_TAN / 2

_BEND = COARSE_M / FINE_M - 1
_BESIDE_BEND = 1e-3


def _ruler(layout: Layout) -> pixels.Ruler:
    """Part of the pixel-to-texel mapping that depends on neither pose nor light."""
    # Texels are counted from the far end of the ripmaps, so that a change of level is a
    # multiplication. Columns are in coarse units; the bend converts them to fine ones.
    rows, columns = layout.rows, layout.columns
    row_end, column_end = 2 * rows, 2 * columns
    middle = (columns / 2 - column_end) / (1 + _BEND)
    half = layout.fine_half_m / layout.coarse_m
    tile = GRAIN_TEXELS
    # Power of two near the ratio of the ground's texels (along, across) to the grain's, so that the
    # levels computed for the ground serve for the grain too.
    grain_along, grain_across = (
        (tile / finer, 2 * tile / finer, finer, 2 * tile - 0.5)
        for texel_m in (layout.row_m, layout.fine_m)
        for finer in [2.0 ** round(math.log2(texel_m / GRAIN_M))]
    )
    return pixels.Ruler(
        least_fall=_LEAST_FALL,
        along=(layout.row_m, -layout.start_x_m / layout.row_m - row_end, layout.row_m),
        along_limits=(16 - row_end, rows - 16 - row_end, row_end - 0.5,
                      2.0 ** (1 - ROW_LEVELS)),
        across=(layout.coarse_m, middle - layout.middle_y_m / layout.coarse_m, layout.fine_m),
        across_limits=(4 - column_end, columns - 4 - column_end, column_end - 0.5,
                       2.0 ** (1 - layout.column_levels)),
        bend=(middle - half, middle + half, _BEND, _BESIDE_BEND),
        bend_levels=round(math.log2(1 + _BEND)),
        grain_along=grain_along,
        grain_across=grain_across,
        tile_m=GRAIN_TEXELS * GRAIN_M,
        grain_reach_m=_GRAIN_REACH_M,
    )  # fmt: skip


class GroundView:
    """Renders the unlit ground; owns the buffers, so frames need no allocations."""

    def __init__(
        self,
        atlas: NDArray[np.uint8],
        grain: NDArray[np.uint8],
        gain: Vectors,
        hidden: NDArray[np.int32],
        width: int,
        layout: Layout | None = None,
    ) -> None:
        """Prepare the grain and the buffer.

        Args:
            atlas: ripmap of the ground's colours.
            grain: ripmap of the grain factor on them.
            gain: factor on red, green and blue, at most 1; merged into the grain.
            hidden: number of columns at the left of each image row, (height,), that will be
                covered; their content is undefined.
            width: width of the images [px].
            layout: of the atlas; None for that of a runway.
        """
        height = len(hidden)
        rows, columns = atlas.shape[0] // 2, atlas.shape[1] // 2
        stretched = _FINER_CODES * gain
        red, green, blue = (GRAIN_NEUTRAL * stretched).tolist()
        self._size = height, width
        self._hidden = hidden
        self._colour = np.zeros((height, width, 3), np.uint8)
        self._ground = pixels.Ground(
            atlas,
            np.asarray(cv2.multiply(grain, np.append(stretched, 1.0)), np.uint8),
            _dither(height, width),
            _ruler(layout or Layout(rows=rows, columns=columns)),
            (round(red), round(green), round(blue)),
            1 / (GRAIN_NEUTRAL * _FINER_CODES),
        )

    def render(self, rays: Vectors, camera: Vectors) -> NDArray[np.uint8]:
        """Render the ground times the gain, (height, width, 3) uint8, into a reused buffer.

        Hidden columns, and rows at the top that see nothing but sky, keep what they have.

        Args:
            rays: maps a homogeneous pixel to a direction in ``map``, (3, 3).
            camera: camera position in ``map`` (3,).
        """
        height, width = self._size
        sight = pixels.Sight(rays, camera, height, width)
        self._ground.sample(self._colour, sight, self._hidden)
        return self._colour


@cache
def _dither(height: int, width: int) -> Floats:
    """Dither factor of up to half an octave in both directions, fixed in the image.

    It hides the borders between ripmap levels at half the cost of blending. Roberts' R2 sequence
    distributes it evenly.
    """
    u = np.arange(width)[None, :] * 0.7548776662466927
    v = np.arange(height)[:, None] * 0.5698402909980532
    factor: Floats = (2 / _SHARPNESS * 2.0 ** (0.5 - np.mod(u + v, 1.0))).astype(np.float32)
    return factor
