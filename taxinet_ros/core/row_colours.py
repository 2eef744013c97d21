"""A picture whose rows have one colour each: what haze and clouds do to ground seen at a slant."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


class RowColours:
    """Spreads one colour per row over the width of a picture, in a buffer that is used again."""

    def __init__(self, height: int, width: int) -> None:
        """Prepare for up to ``height`` rows of ``width`` pixels."""
        self._planes = np.empty((3, height, width), np.uint8)
        self._picture = np.empty((height, width, 3), np.uint8)

    def spread(self, codes: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Picture (n, width, 3) of row colours ``codes`` (n, 3), rounded and cut to 0..255."""
        count = len(codes)
        # Filling planes is a matter of memset; broadcasting colours would copy 3 bytes at a time.
        planes, picture = self._planes[:, :count], self._picture[:count]
        planes[:] = np.clip(np.rint(codes), 0, 255).astype(np.uint8).T[:, :, None]
        cv2.merge([planes[0], planes[1], planes[2]], dst=picture)
        return picture
