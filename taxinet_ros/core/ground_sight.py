"""How one pose sees the ground: the few numbers from which every pixel's texels follow.

With the ray of pixel (u, v) as d = A (u, v, 1) in ``map`` and the camera at height h over the place
c, the ground point is c + h (dx, dy) w with w = -1/dz. As dz is linear in u and v, so is every
linear ground coordinate in u w and w, whatever its unit and origin: one pass over the picture. The
footprints are exact too: with X = dx w, dX/du = w (A00 + X A20) is w^2 times a linear function of v
alone, and dX/dv is w^2 times one of u alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Vectors = NDArray[np.float64]

Linear = tuple[float, float, float]
"""Factors on u w and on w, and a constant."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sight:
    """One pose's view of the ground.

    Attributes:
        rays: A, homogenous pixel to a direction in ``map``, 3 by 3.
        camera: the camera's place in ``map`` [m].
        rows, columns: the picture's v, (H, 1), and u, (1, W).
    """

    rays: list[list[float]]
    camera: list[float]
    rows: Vectors
    columns: Vectors

    def fall(self) -> tuple[Floats, Floats]:
        """The two parts of -dz: by column (1, W), and by row (H, 1)."""
        f0, f1, f2 = self.rays[2]
        by_row = -f1 * self.rows - f2
        return (-f0 * self.columns).astype(np.float32), by_row.astype(np.float32)

    def rows_below(self, fall: float) -> int:
        """Number of upper rows outside of which -dz is nowhere less than ``fall``."""
        f0, f1, f2 = self.rays[2]
        if f1 >= 0:
            return len(self.rows)
        least = -f2 + min(0.0, -f0 * (self.columns.size - 1))
        return min(max(math.ceil((fall - least) / -f1), 0), len(self.rows))

    def density(self, axis: int, texel_m: float) -> tuple[Floats, Floats]:
        """Factors on (dz)^2 that give pixels per texel along an axis of ``map``.

        Of the footprint's side along v, by column (1, W); and of the one along u, by row (H, 1).
        The smaller one counts.
        """
        turn, by_u, by_v = self._steepness(axis)
        scale = texel_m / self.camera[2]
        by_column = scale / np.maximum(np.abs(turn * self.columns + by_u), 1e-9)
        by_row = scale / np.maximum(np.abs(turn * self.rows + by_v), 1e-9)
        return by_column.astype(np.float32), by_row.astype(np.float32)

    def _steepness(self, axis: int) -> tuple[float, float, float]:
        (a0, a1, a2), (f0, f1, f2) = self.rays[axis], self.rays[2]
        return a0 * f1 - a1 * f0, a2 * f1 - a1 * f2, a0 * f2 - a2 * f0

    def rows_beyond(self, axis: int, density: float, texel_m: float, limit_m: float) -> int:
        """Number of upper rows that may have sparse or distant pixels along an axis of ``map``.

        Args:
            axis: 0 along the runway, 1 across.
            density: pixels per texel that the other rows have at least.
            texel_m: size of a texel [m].
            limit_m: distance from the camera within which the other rows lie [m].
        """
        if limit_m <= 0:
            return len(self.rows)
        turn, by_u, by_v = self._steepness(axis)
        right, bottom = self.columns.size - 1, self.rows.size - 1
        ends = (by_u, turn * right + by_u, by_v, turn * bottom + by_v)
        dense = math.sqrt(density * self.camera[2] / texel_m * max(map(abs, ends)))
        a0, a1, a2 = map(abs, self.rays[axis])
        near = self.camera[2] * (a0 * right + a1 * bottom + a2) / limit_m
        return self.rows_below(max(dense, near))

    def place(self, axis: int, unit_m: float) -> float:
        """Where the camera is along an axis of ``map``, in units of ``unit_m``."""
        return self.camera[axis] / unit_m

    def coordinate(self, axis: int, unit_m: float, origin: float) -> Linear:
        """Ground coordinate along an axis in units of ``unit_m``, plus ``origin``."""
        # A form in u, v and 1 times w; v w follows from the definition of w.
        scale = self.camera[2] / unit_m
        (a0, a1, a2), (f0, f1, f2) = self.rays[axis], self.rays[2]
        per_v = -(a1 * scale) / f1
        shift = self.place(axis, unit_m) + origin
        return a0 * scale + per_v * f0, a2 * scale + per_v * f2, per_v + shift

    def first_row_nearer_than(self, reach_m: float) -> int:
        """First picture row whose middle lies within ``reach_m`` ahead; their number if none is."""
        middle = self.columns.size / 2
        f0, f1, f2 = self.rays[2]
        near = -(f0 * middle + f1 * self.rows[:, 0] + f2) > self.camera[2] / reach_m
        return int(np.argmax(near)) if near.any() else len(near)
