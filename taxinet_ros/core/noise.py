"""Seeded noise for procedural textures; a pure function of its arguments in every process."""

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
    noise *= np.float32(1.4)  # the interpolation has taken this from the deviation
    return noise


def white_noise(seed: int, shape: tuple[int, int]) -> Floats:
    """Uniform noise of mean 0 and standard deviation 1, every texel on its own."""
    raw = np.random.default_rng(seed).integers(0, 256, size=shape, dtype=np.uint8)
    noise: Floats = raw.astype(np.float32)
    noise -= np.float32(127.5)
    noise *= np.float32(1 / 73.9)
    return noise
