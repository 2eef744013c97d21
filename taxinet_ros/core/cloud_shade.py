"""Shadows of single clouds on the ground: sun and shade drift by as the aircraft rolls along.

Clouds stand still over the runway. A cloud's shadow has no sharp edge and is longer than the near
ground is deep, so it is laid over the picture row by row, after the ground under its middle column.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import pixels
from taxinet_ros.core.light import Light
from taxinet_ros.core.noise import Floats, smooth_noise

_CELL_M = 8.0
_SHAPE = (416, 80)  # x and y cells: -100..3,228 m and -320..320 m
_START_X_M, _START_Y_M = -100.0, -320.0
_COVER = {'scattered': (0.75, 0.60), 'broken': (-0.15, 0.45)}
"""Noise level above which there is cloud, and the share of the beam that a cloud lets through."""


class CloudShade:
    """How much of the sun's beam the clouds let through, and the shade that this makes."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare for pictures of ``height`` by ``width`` pixels."""
        self._light = light
        casts = light.clouds in _COVER and light.direct.max() > 0.01 * light.total.max()
        self._beam = _beam(light.clouds) if casts else None
        rows = np.arange(height, dtype=np.float64)
        self._middle = np.stack([np.full_like(rows, (width - 1) / 2), rows, np.ones_like(rows)])

    @property
    def casts(self) -> bool:
        """Whether there are single clouds, and a sun that they hide."""
        return self._beam is not None

    def sun_share(self, x_m: float, y_m: float) -> float:
        """Share (0..1) of the beam that reaches the ground at a place in ``map``."""
        if self._beam is None:
            return 1.0
        return float(self._look_up(np.array([x_m]), np.array([y_m]))[0])

    def shade(
        self, colour: NDArray[np.uint8], rays: NDArray[np.float64], camera: NDArray[np.float64]
    ) -> None:
        """Darken the unlit ground ``colour`` (height, width, 3) in place where clouds hide the sun.

        Args:
            colour: daylight colours of the ground.
            rays: homogenous pixel to a direction in ``map``, (3, 3).
            camera: the camera's place in ``map`` (3,).
        """
        if self._beam is None:
            return
        ray = rays @ self._middle
        reach = camera[2] / np.maximum(-ray[2], 1e-3)
        share = self._look_up(camera[0] + ray[0] * reach, camera[1] + ray[1] * reach)
        full, dark = 1.0, self._light.shade_factor()
        # Linear between shade and sun in display codes: within 2 codes of the exact power law.
        factor = dark + (full - dark) * share[:, None]
        pixels.tint_rows(colour, 255 * factor)

    def _look_up(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        assert self._beam is not None
        columns = ((y - _START_Y_M) / _CELL_M).astype(np.float32)[None]
        rows = ((x - _START_X_M) / _CELL_M).astype(np.float32)[None]
        found = cv2.remap(
            self._beam, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found[0], np.float64)


@lru_cache(maxsize=4)
def _beam(clouds: str) -> Floats:
    """Map of the beam's share under single clouds, ``_SHAPE`` cells."""
    start, through = _COVER[clouds]
    noise = smooth_noise(401, _SHAPE, (20, 14)) + 0.4 * smooth_noise(402, _SHAPE, (6, 5))
    cloud = np.clip((cv2.GaussianBlur(noise, (0, 0), 1.5) - start) / 0.45, 0, 1)
    beam: Floats = (1 - (1 - through) * cloud).astype(np.float32)
    return beam
