"""The ground seen through a pinhole: inverse mapping of a picture into the ground's ripmaps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import ground
from taxinet_ros.core.ripmap import shrink_factor, to_atlas
from taxinet_ros.core.sky import GROUND_END_TAN

Floats = NDArray[np.float32]

_BORDER = cv2.BORDER_REPLICATE
_RULER_STEP = np.float32(1e-3)
_RULER_SLOPE = np.float32((1 / ground.COARSE_M - 1 / ground.FINE_M) / 1e-3)
_SHARPNESS = 0.8
_GRAIN_REACH_M = 26.0


class GroundView:
    """Renders the unlit ground; owns the buffers that make a frame free of allocations.

    With the ray of pixel (u, v) as d = A (u, v, 1) in ``map`` and the camera at height h, the
    ground point is h (X, Y) from the camera's foot, X = dx w, Y = dy w, w = -1/dz. Differentiating,
    dX/du = w (A00 + X A20), and so on: exact footprints for the price of a few multiplications.
    """

    def __init__(
        self, atlas: NDArray[np.uint8], grain: NDArray[np.uint8], height: int, width: int
    ) -> None:
        """Prepare buffers for pictures of ``height`` by ``width`` pixels."""
        self._atlas, self._grain = atlas, grain
        self._rows = np.arange(height, dtype=np.float32)[:, None]
        self._columns = np.arange(width, dtype=np.float32)[None, :]
        names = ('w', 'x', 'y', 'fx', 'fy', 'a', 'b', 'c', 'd')
        self._buffers = {name: np.empty((height, width), np.float32) for name in names}
        self._colour = np.empty((height, width, 3), np.uint8)
        self._grain_colour = np.empty((height, width, 3), np.uint8)
        self._jitter = _jitter(height, width)

    def render(self, rays: NDArray[np.float64], camera: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Daylight colours of the ground, (height, width, 3) uint8; the buffer is used again.

        Args:
            rays: A, (3, 3): homogenous pixel to a direction in ``map``.
            camera: the camera's place in ``map`` (3,).
        """
        a = rays.astype(np.float32)
        self._meet_ground(a, float(camera[2]))
        self._measure_footprints(a)
        b = self._buffers
        np.add(b['x'], np.float32(camera[0]), out=b['x'])
        np.add(b['y'], np.float32(camera[1]), out=b['y'])
        self._sample_ground()
        self._sample_grain(a, float(camera[2]))
        return self._colour

    def _linear(self, row: Floats, out: Floats) -> None:
        """row[0] u + row[1] v + row[2] for all pixels."""
        np.add(self._columns * row[0], self._rows * row[1] + row[2], out=out)

    def _meet_ground(self, a: Floats, height_m: float) -> None:
        """Fill w, and x, y relative to the camera's foot [m]; the sky gets the farthest ground."""
        b = self._buffers
        self._linear(-a[2], b['w'])
        np.maximum(b['w'], np.float32(GROUND_END_TAN / 2), out=b['w'])
        np.divide(np.float32(height_m), b['w'], out=b['w'])
        for name, row in (('x', a[0]), ('y', a[1])):
            self._linear(row, b[name])
            np.multiply(b[name], b['w'], out=b[name])
        self._height = np.float32(height_m)

    def _measure_footprints(self, a: Floats) -> None:
        """Extent of every pixel on the ground along x and along y [m], into fx and fy."""
        b = self._buffers
        np.multiply(b['w'], self._jitter, out=b['w'])
        for axis, (name, foot) in enumerate((('x', 'fx'), ('y', 'fy'))):
            # w carries h already, and x = h X: divide h out of the slope instead of the arrays.
            for step, target in ((1, foot), (0, 'a')):
                np.multiply(b[name], a[2, step] / self._height, out=b[target])
                np.add(b[target], a[axis, step], out=b[target])
                np.abs(b[target], out=b[target])
            np.maximum(b[foot], b['a'], out=b[foot])
            np.multiply(b[foot], b['w'], out=b[foot])

    def _sample_ground(self) -> None:
        """Look the strip's colours up, through the bent ruler across the runway."""
        b = self._buffers
        np.subtract(b['x'], np.float32(ground.START_X_M), out=b['a'])
        np.multiply(b['a'], np.float32(1 / ground.ROW_M), out=b['a'])
        np.clip(b['a'], 16, ground.ROWS - 16, out=b['a'])
        np.clip(b['y'], -ground.FINE_HALF_M, ground.FINE_HALF_M, out=b['b'])
        np.subtract(b['y'], b['b'], out=b['c'])
        np.abs(b['c'], out=b['d'])
        np.minimum(b['d'], _RULER_STEP, out=b['d'])
        columns = np.multiply(b['b'], np.float32(1 / ground.FINE_M), out=b['b'])
        np.multiply(b['c'], np.float32(1 / ground.COARSE_M), out=b['c'])
        columns += b['c']
        columns += np.float32(ground.COLUMNS / 2)
        np.clip(columns, 4, ground.COLUMNS - 4, out=columns)
        row_foot = np.multiply(b['fx'], np.float32(1 / ground.ROW_M), out=b['c'])
        # Columns per metre: fine inside, coarse beyond a step of a millimetre.
        ruler = np.multiply(b['d'], _RULER_SLOPE, out=b['d'])
        ruler += np.float32(1 / ground.FINE_M)
        ruler *= b['fy']
        to_atlas(b['a'], shrink_factor(row_foot, ground.ROW_LEVELS), ground.ROWS)
        to_atlas(b['b'], shrink_factor(ruler, ground.COLUMN_LEVELS), ground.COLUMNS)
        cv2.remap(
            self._atlas, b['b'], b['a'], cv2.INTER_LINEAR, dst=self._colour, borderMode=_BORDER
        )

    def _sample_grain(self, a: Floats, height_m: float) -> None:
        """Multiply the near ground by the repeating grain; far away it has averaged out."""
        first = self._first_row_nearer_than(a, height_m)
        if first >= len(self._rows):
            return
        b = {name: buffer[first:] for name, buffer in self._buffers.items()}
        tile_m = np.float32(ground.GRAIN_TEXELS * ground.GRAIN_M)
        for name, foot in (('x', 'fx'), ('y', 'fy')):
            np.multiply(b[name], 1 / tile_m, out=b[name])
            np.floor(b[name], out=b['c'])
            np.subtract(b[name], b['c'], out=b[name])
            np.multiply(b[name], np.float32(ground.GRAIN_TEXELS), out=b[name])
            np.multiply(b[foot], np.float32(1 / ground.GRAIN_M), out=b[foot])
            shrink = shrink_factor(b[foot], ground.GRAIN_LEVELS)
            to_atlas(b[name], shrink, ground.GRAIN_TEXELS)
        near, grain = self._colour[first:], self._grain_colour[first:]
        cv2.remap(self._grain, b['y'], b['x'], cv2.INTER_LINEAR, dst=grain, borderMode=_BORDER)
        cv2.multiply(near, grain, dst=near, scale=1 / ground.GRAIN_NEUTRAL)

    def _first_row_nearer_than(self, a: Floats, height_m: float) -> int:
        """First picture row whose middle lies within the grain's reach."""
        middle = self._columns.shape[1] / 2
        fall = -(a[2, 0] * middle + a[2, 1] * self._rows[:, 0] + a[2, 2])
        near = fall > height_m / _GRAIN_REACH_M
        return int(np.argmax(near)) if near.any() else len(near)


def _jitter(height: int, width: int) -> Floats:
    """Factor of half an octave up and down, well mixed over the picture.

    It dissolves the borders between pyramid levels, at no cost per frame, where blending two levels
    would double the work. Roberts' R2 sequence spreads it evenly; it is fixed to the picture.
    """
    u = np.arange(width)[None, :] * 0.7548776662466927
    v = np.arange(height)[:, None] * 0.5698402909980532
    factor: Floats = (_SHARPNESS * 2.0 ** (np.mod(u + v, 1.0) - 0.5)).astype(np.float32)
    return factor
