"""The ground seen through a pinhole: inverse mapping of a picture into the ground's ripmaps."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import ground
from taxinet_ros.core.ground_sight import Floats, Linear, Sight, Vectors
from taxinet_ros.core.ripmap import whole_power_of_two
from taxinet_ros.core.sky import GROUND_END_TAN

Mark = Callable[[str], None]
"""Is told the name of every stage of a picture at its end, by whoever measures them."""

GROUND_STAGES = ('ray-ground', 'ground lookup', 'grain')

_BORDER = cv2.BORDER_REPLICATE
_SHARPNESS = 0.8
_GRAIN_REACH_M = 26.0
_GRAIN_TILE_M = ground.GRAIN_TEXELS * ground.GRAIN_M
_FINER_CODES = 1.5
"""The grain times the gain leaves codes unused; stretched to them it rounds less."""

_SURELY = 1.001
"""Margin for rounding errors, where rows are spared work that would not change them."""

_LEAST_FALL = GROUND_END_TAN / 2

_BEND = ground.COARSE_M / ground.FINE_M - 1
_COARSE_STEP = np.array(round(math.log2(1 + _BEND)) << 23, np.int32).view(np.float32).item()
"""A number whose bits, added to a power of two's, multiply that by the ruler's change of scale."""

# Texels are counted from the far end of the ripmaps, so that a multiplication changes the level.
# Columns are the coarse ruler's, which the bend once more makes the fine one's.
_ROW_END, _COLUMN_END = 2 * ground.ROWS, 2 * ground.COLUMNS
_ROW_START = -ground.START_X_M / ground.ROW_M - _ROW_END
_END_X_M = ground.START_X_M + (ground.ROWS - 16) * ground.ROW_M
_MIDDLE = (ground.COLUMNS / 2 - _COLUMN_END) / (1 + _BEND)


class GroundView:
    """Renders the unlit ground; owns the buffers that make a frame free of allocations."""

    def __init__(
        self,
        atlas: NDArray[np.uint8],
        grain: NDArray[np.uint8],
        gain: Vectors,
        height: int,
        width: int,
    ) -> None:
        """Prepare the grain and the buffers.

        Args:
            atlas: ripmap of the ground's colours.
            grain: ripmap of the factor on them.
            gain: factor on red, green and blue, at most 1; it rides on the grain for free.
            height: of the pictures [px].
            width: of the pictures [px].
        """
        self._atlas = atlas
        stretched = _FINER_CODES * gain
        self._grain = cv2.multiply(grain, np.append(stretched, 1.0))
        self._rows = np.arange(height, dtype=np.float64)[:, None]
        self._columns = np.arange(width, dtype=np.float64)[None, :]
        self._u = self._columns.astype(np.float32)
        self._colour = np.empty((height, width, 3), np.uint8)
        self._dither = _dither(height, width)
        self._dense = _SURELY / float(self._dither.min())
        names = ('w', 'uw', 'x', 'y', 'px', 'py', 'a', 'b')
        self._buffers = {name: np.empty((height, width), np.float32) for name in names}
        neutral = np.rint(ground.GRAIN_NEUTRAL * stretched).astype(np.uint8)
        self._plain = np.tile(neutral, (height, width, 1))
        self._factor = np.empty_like(self._plain)

    def render(self, rays: Vectors, camera: Vectors, mark: Mark) -> NDArray[np.uint8]:
        """Colours of the ground times the gain, (height, width, 3) uint8; a buffer, used again.

        Args:
            rays: homogenous pixel to a direction in ``map``, (3, 3).
            camera: the camera's place in ``map`` (3,).
            mark: told of every stage's end.
        """
        sight = Sight(
            rays=rays.tolist(), camera=camera.tolist(), rows=self._rows, columns=self._columns
        )
        self._meet_ground(sight)
        self._measure_footprints(sight)
        mark('ray-ground')
        self._sample_ground(sight)
        mark('ground lookup')
        first = sight.first_row_nearer_than(_GRAIN_REACH_M)
        self._factor[:first] = self._plain[:first]
        if first < len(self._rows):
            self._sample_grain(sight, first)
        scale = 1 / (ground.GRAIN_NEUTRAL * _FINER_CODES)
        cv2.multiply(self._colour, self._factor, dst=self._colour, scale=scale)
        mark('grain')
        return self._colour

    def _meet_ground(self, sight: Sight) -> None:
        """Fill w and u w, and b with the footprints' common factor; the sky gets the last ground.

        The dither dissolves the borders between pyramid levels, where blending two levels would
        double the work.
        """
        b = self._buffers
        fall, common = b['a'], b['b']
        by_column, by_row = sight.fall()
        np.add(by_column, by_row, out=fall)
        sky = fall[: sight.rows_below(_LEAST_FALL * _SURELY)]
        np.maximum(sky, np.float32(_LEAST_FALL), out=sky)
        np.divide(np.float32(1), fall, out=b['w'])
        np.multiply(b['w'], self._u, out=b['uw'])
        np.square(fall, out=common)
        np.multiply(common, self._dither, out=common)

    def _measure_footprints(self, sight: Sight) -> None:
        """Largest power of two not above a pixel's density, in pixels per texel, into px and py.

        In texels of 0.4 m along and 0.12 m across; a texel of level i is 2^i of them, and p = 2^-i.
        """
        common = self._buffers['b']
        for axis, texel_m in enumerate((ground.ROW_M, ground.FINE_M)):
            p = self._buffers[('px', 'py')[axis]]
            by_column, by_row = sight.density(axis, texel_m)
            np.minimum(by_row, by_column, out=p)
            np.multiply(p, common, out=p)
            whole_power_of_two(p)

    def _sample_ground(self, sight: Sight) -> None:
        """Look the strip's colours up, through the bent ruler across the runway."""
        b, (x_m, y_m, _) = self._buffers, sight.camera
        row, column = b['x'], b['y']
        self._evaluate(sight.coordinate(0, ground.ROW_M, _ROW_START), row)
        low, high = 16, ground.ROWS - 16
        limit_m = min(x_m - ground.START_X_M - low * ground.ROW_M, _END_X_M - x_m)
        far = slice(sight.rows_beyond(0, self._dense, ground.ROW_M, limit_m / _SURELY))
        p, part = b['a'][far], row[far]
        np.clip(part, np.float32(low - _ROW_END), np.float32(high - _ROW_END), out=part)
        np.clip(b['px'][far], np.float32(2.0 ** (1 - ground.ROW_LEVELS)), np.float32(1), out=p)
        np.multiply(part, p, out=part)
        np.add(row, np.float32(_ROW_END - 0.5), out=row)

        self._evaluate(sight.coordinate(1, ground.COARSE_M, _MIDDLE), column)
        half = ground.FINE_HALF_M / ground.COARSE_M
        inside = np.clip(column, np.float32(_MIDDLE - half), np.float32(_MIDDLE + half), out=b['b'])
        low, high = 4, ground.COLUMNS - 4
        limit_m = ground.HALF_SPAN_M - low * ground.COARSE_M - abs(y_m)
        far = slice(sight.rows_beyond(1, self._dense, ground.FINE_M, limit_m / _SURELY))
        p, part = b['a'][far], column[far]
        cv2.absdiff(part, inside[far], dst=p)
        cv2.scaleAdd(inside, _BEND, column, dst=column)
        cv2.threshold(p, 1e-3, _COARSE_STEP, cv2.THRESH_BINARY, dst=p)
        np.add(p.view(np.int32), b['py'][far].view(np.int32), out=p.view(np.int32))
        np.clip(p, np.float32(2.0 ** (1 - ground.COLUMN_LEVELS)), np.float32(1), out=p)
        np.clip(part, np.float32(low - _COLUMN_END), np.float32(high - _COLUMN_END), out=part)
        np.multiply(part, p, out=part)
        np.add(column, np.float32(_COLUMN_END - 0.5), out=column)
        cv2.remap(self._atlas, column, row, cv2.INTER_LINEAR, dst=self._colour, borderMode=_BORDER)

    def _sample_grain(self, sight: Sight, first: int) -> None:
        """Look the grain up from row ``first`` on; farther away it has averaged out."""
        b = {name: buffer[first:] for name, buffer in self._buffers.items()}
        whole, p = b['a'], b['b']
        for axis, texel_m in enumerate((ground.ROW_M, ground.FINE_M)):
            place, level = b[('x', 'y')[axis]], b[('px', 'py')[axis]]
            nearest_tile = math.floor(sight.place(axis, _GRAIN_TILE_M))
            self._evaluate(sight.coordinate(axis, _GRAIN_TILE_M, -nearest_tile), place)
            np.floor(place, out=whole)
            # A power of two near the ratio of the texels: the footprints' levels serve twice.
            finer = 2.0 ** round(math.log2(texel_m / ground.GRAIN_M))
            unit = ground.GRAIN_TEXELS / finer
            cv2.addWeighted(place, unit, whole, -unit, -2 * unit, dst=place)
            # No limit below: the ripmap's far end repeats its last level.
            cv2.threshold(level, finer, 0, cv2.THRESH_TRUNC, dst=p)
            np.multiply(place, p, out=place)
            np.add(place, np.float32(2 * ground.GRAIN_TEXELS - 0.5), out=place)
        factor = self._factor[first:]
        cv2.remap(self._grain, b['y'], b['x'], cv2.INTER_LINEAR, dst=factor, borderMode=_BORDER)

    def _evaluate(self, linear: Linear, out: Floats) -> None:
        """Value of a linear form in the lowest ``len(out)`` rows of the picture."""
        first = len(self._rows) - len(out)
        uw, w = self._buffers['uw'][first:], self._buffers['w'][first:]
        cv2.addWeighted(uw, linear[0], w, linear[1], linear[2], dst=out)


@cache
def _dither(height: int, width: int) -> Floats:
    """Factor of half an octave up and down, well mixed over the picture.

    Roberts' R2 sequence spreads it evenly; it is fixed to the picture.
    """
    u = np.arange(width)[None, :] * 0.7548776662466927
    v = np.arange(height)[:, None] * 0.5698402909980532
    factor: Floats = (2 / _SHARPNESS * 2.0 ** (0.5 - np.mod(u + v, 1.0))).astype(np.float32)
    return factor
