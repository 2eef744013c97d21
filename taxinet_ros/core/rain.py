"""Rain as the camera sees it: bright streaks, another pattern in every frame.

The pattern is a pure function of the frame's stamp and the rain's intensity, so that a frame can be
rendered again in another process, alone and out of order.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.light import Light

_SHEET_HEIGHT, _SHEET_WIDTH = 400, 720
_SLANT = 0.12
_LEVELS = 20
"""Steps of intensity. A process keeps a sheet of each, a quarter of a megabyte: they take 0.1 s to
draw, and the scenes of a campaign need all of them."""

_MASK64 = (1 << 64) - 1


def scramble(number: int) -> int:
    """Steele, Lea and Flood's splitmix64: spreads neighbouring numbers over 64 bits."""
    mixed = (number + 0x9E3779B97F4A7C15) & _MASK64
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & _MASK64
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & _MASK64
    return mixed ^ (mixed >> 31)


class RainSheet:
    """Streaks of one scenario's rain, as light to be added to a picture."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare the streaks; ``height`` and ``width`` are the picture's [px]."""
        brightness = 0.16 * light.sky_low * (0.4 + 0.6 * light.rain)
        shares = np.arange(256)[:, None] * (brightness / 255)
        table = np.clip(np.rint(shares), 0, 255).astype(np.uint8)[None]
        streaks = _streaks(round(light.rain * _LEVELS))
        self._sheet = np.asarray(cv2.LUT(cv2.merge([streaks] * 3), table), np.uint8)
        self._size = (height, width)

    def at(self, stamp_ns: int) -> NDArray[np.uint8]:
        """Light to add at a stamp, (height, width, 3); a view, not to be written to."""
        height, width = self._size
        bits = scramble(stamp_ns)
        top = bits % (_SHEET_HEIGHT - height + 1)
        left = (bits >> 20) % (_SHEET_WIDTH - width + 1)
        return self._sheet[top : top + height, left : left + width]


@lru_cache(maxsize=_LEVELS + 1)
def _streaks(level: int) -> NDArray[np.uint8]:
    """Streaks of one of the :data:`_LEVELS` steps of intensity; near drops are long and broad."""
    rng = np.random.default_rng(500)
    sheet = np.zeros((_SHEET_HEIGHT, _SHEET_WIDTH), np.float32)
    for thickness, length, count, weight in (
        (1, 9, 2600, 0.5),
        (1, 22, 700, 0.9),
        (2, 46, 130, 0.7),
    ):
        layer = np.zeros((_SHEET_HEIGHT, _SHEET_WIDTH), np.uint8)
        for _ in range(math.ceil(count * level / _LEVELS)):
            x, y = rng.uniform(0, _SHEET_WIDTH), rng.uniform(-length, _SHEET_HEIGHT)
            run = length * rng.uniform(0.6, 1.3)
            ends = [(round((x + s * run * _SLANT) * 16), round((y + s * run) * 16)) for s in (0, 1)]
            shade = int(rng.integers(90, 255))
            cv2.line(layer, ends[0], ends[1], (shade,), thickness, cv2.LINE_AA, 4)
        sheet += weight * cv2.GaussianBlur(layer, (0, 0), 0.6).astype(np.float32)
    return np.clip(sheet, 0, 255).astype(np.uint8)
