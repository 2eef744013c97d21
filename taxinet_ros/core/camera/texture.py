"""Procedural textures: seeded noise, and anisotropic mip pyramids ("ripmaps") in one atlas.

Noise is a pure function of its arguments in every process. Ripmaps give alias-free lookup.

Level (i, j) of a texture of H rows and W columns is reduced by 2^i along the rows' axis and by 2^j
along the columns' axis; it starts at row H(2 - 2^(1-i)) and column W(2 - 2^(1-j)) of an atlas of
2H x 2W. Runway features are long along two axes, so a filter with one width per axis suits them
better than an isotropic pyramid, and one atlas allows one lookup per pixel. Row t (in level-0 rows,
from the upper edge) at level i is at 2H + p(t - 2H) with p = 2^-i.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def smooth_noise(seed: int, shape: tuple[int, int], cell: tuple[float, float]) -> Floats:
    """Noise of mean 0 and deviation near 1, smooth over ``cell`` (rows, columns) texels."""
    rows, columns = (max(2, round(n / c) + 1) for n, c in zip(shape, cell, strict=True))
    coarse = np.random.default_rng(seed).standard_normal((rows, columns), dtype=np.float32)
    size = (shape[1], shape[0])
    noise: Floats = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR).astype(
        np.float32, copy=False
    )
    noise *= np.float32(1.4)  # compensates for the deviation lost by interpolation
    return noise


def white_noise(seed: int, shape: tuple[int, int]) -> Floats:
    """Uniform noise of mean 0 and standard deviation 1, independent per texel."""
    raw = np.random.default_rng(seed).integers(0, 256, size=shape, dtype=np.uint8)
    noise: Floats = raw.astype(np.float32)
    noise -= np.float32(127.5)
    noise *= np.float32(1 / 73.9)
    return noise


Image = NDArray[np.uint8]


def build_ripmap(base: Image, row_levels: int, column_levels: int) -> Image:
    """Atlas of ``base`` (H, W, 3), shape (2H, 2W, 3); H and W are divisible by 2^(levels - 1)."""
    height, width = base.shape[:2]
    atlas = np.zeros((2 * height, 2 * width, base.shape[2]), np.uint8)
    atlas[:height, :width] = base
    row, rows = 0, height
    for _ in range(row_levels - 1):
        level = atlas[row : row + rows, :width]
        row, rows = row + rows, rows // 2
        cv2.addWeighted(level[0::2], 0.5, level[1::2], 0.5, 0, dst=atlas[row : row + rows, :width])
    atlas[row + rows :, :width] = atlas[row + rows - 1, :width]
    column, columns = 0, width
    for _ in range(column_levels - 1):
        level = atlas[:, column : column + columns]
        column, columns = column + columns, columns // 2
        target = atlas[:, column : column + columns]
        # Halving by bilinear interpolation is the mean of two, and faster than INTER_AREA.
        cv2.resize(level, (columns, 2 * height), dst=target, interpolation=cv2.INTER_LINEAR_EXACT)
    # Fill beyond the last level, because interpolation may read across the border.
    atlas[:, column + columns :] = atlas[:, column + columns - 1 : column + columns]
    return atlas
