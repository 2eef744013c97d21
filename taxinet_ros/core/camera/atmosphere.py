"""Atmospheric effects: haze, sky reflections, glare, skyline and rain."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels, sky
from taxinet_ros.core.camera.light import Light

_SHEET_HEIGHT, _SHEET_WIDTH = 400, 720
_SLANT = 0.12
_LEVELS = 20
"""Number of intensity steps. A process caches one sheet (0.25 MB) per step: drawing one takes
0.1 s, and a campaign needs all of them.
"""
_MASK64 = (1 << 64) - 1


def scramble(number: int) -> int:
    """Hash a number to 64 bits (splitmix64; Steele, Lea and Flood)."""
    mixed = (number + 0x9E3779B97F4A7C15) & _MASK64
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & _MASK64
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & _MASK64
    return mixed ^ (mixed >> 31)


class RainSheet:
    """Rain streaks of one scenario, as light added to an image."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare the streaks for images of ``height`` by ``width`` pixels."""
        brightness = 0.16 * light.sky_low * (0.4 + 0.6 * light.rain)
        shares = np.arange(256)[:, None] * (brightness / 255)
        table = np.clip(np.rint(shares), 0, 255).astype(np.uint8)[None]
        streaks = _streaks(round(light.rain * _LEVELS))
        self._sheet = np.asarray(cv2.LUT(cv2.merge([streaks] * 3), table), np.uint8)
        # At most half of the sheet is shown, to vary its offset; larger images enlarge the drops.
        self._larger = max(1.0, 2 * height / _SHEET_HEIGHT, 2 * width / _SHEET_WIDTH)
        self._size = (height, width)

    def at(self, stamp_ns: int) -> NDArray[np.uint8]:
        """Light to add at a stamp, (height, width, 3); a view, not to be modified."""
        height, width = (math.ceil(side / self._larger) for side in self._size)
        bits = scramble(stamp_ns)
        top = bits % (_SHEET_HEIGHT - height + 1)
        left = (bits >> 20) % (_SHEET_WIDTH - width + 1)
        part = self._sheet[top : top + height, left : left + width]
        return part if self._larger == 1 else np.asarray(cv2.resize(part, self._size[::-1]))


@lru_cache(maxsize=_LEVELS + 1)
def _streaks(level: int) -> NDArray[np.uint8]:
    """Streaks of one of the :data:`_LEVELS` intensity steps; near drops are long and broad."""
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


_WATER_SHARE = 0.55
_SPRAY_SHARE = 0.16
"""Opacity of the uniform veil in full rain: spray in the air and drops on the lens."""
_MIRRORED = 0.92
"""Share of the sky's light that spray sends on, as in ``native/air.cpp``."""
SPARSE_PX, _LESS_SPARSE_PX = 15, 5
"""Spacing of the columns for which directions are computed, for usual and for wide lenses; the
interpolation error between them is below a tenth of a panorama column. The larger divides the
image width."""
_WIDE_FOCAL_PX = 200.0
_GLARE_STRENGTH = 120.0
_LEAST_GLARE = 1.0
_GLARE_HALF_WIDTH_RAD = math.radians(16.0)
_GLARE_TINT = (1.0, 0.84, 0.58)
_ROWS_IN_STRIP = 0.5
"""Rows by which the horizon may fall across a strip with a common haze."""


class Atmosphere:
    """Renders the ground in a scenario's light, haze, water and sky."""

    def __init__(
        self, light: Light, height: int, width: int, focal_px: float, *, in_strips: bool = False
    ) -> None:
        """Prepare for images in one scenario's light.

        Args:
            light: the light.
            height: of the images [px].
            width: of the images [px], a multiple of :data:`SPARSE_PX`.
            focal_px: focal length along a row [px].
            in_strips: compute haze, water and glare for strips of columns where the horizon
                is tilted; else for rows, at their middle.
        """
        self._size, self._in_strips = (height, width), in_strips
        beam = float(light.direct.max() / light.total.max())
        low = math.exp(-max(light.sun_elevation_rad, 0.0) / math.radians(9.0))
        glare = _GLARE_STRENGTH * beam * low * min(1.0, float(light.total.max()) * 2)
        self._glares = glare > _LEAST_GLARE
        self._air = pixels.Air(
            visibility_m=light.visibility_m,
            film=_WATER_SHARE * light.wetness,
            spray=_SPRAY_SHARE * light.rain,
            sky_low=light.sky_low,
            sky_high=light.sky_high,
            glare=glare,
            sun_yaw_rad=math.atan2(light.sun[1], light.sun[0]),
            glare_width_rad=_GLARE_HALF_WIDTH_RAD,
        )
        self._visibility_m, self._spray = light.visibility_m, _SPRAY_SHARE * light.rain
        self._sky_low = light.sky_low
        self._skyline = pixels.Panorama(
            sky.panorama(light),
            lowest_rad=sky.LOWEST_RAD,
            step_rad=sky.STEP_RAD,
            end_tan=sky.GROUND_END_TAN,
            spacing_px=SPARSE_PX if focal_px >= _WIDE_FOCAL_PX else _LESS_SPARSE_PX,
        )

    def veil_at(self, distance_m: float) -> tuple[float, NDArray[np.float64]]:
        """What haze and spray make of display codes at a distance [m]: a share, and what they add.

        As they do with the ground, where no water mirrors the sky.
        """
        clear = math.exp(-distance_m / self._visibility_m)
        added = (1 - clear + clear * self._spray * _MIRRORED) * self._sky_low
        return clear * (1 - self._spray), added

    def develop(
        self,
        ground: NDArray[np.uint8],
        curve: NDArray[np.uint8],
        rays: NDArray[np.float64],
        height_m: float,
        picture: NDArray[np.uint8],
    ) -> None:
        """Light the ground and add haze, water, glare and skyline.

        Args:
            ground: daylight colours, (height, width, 3).
            curve: their display codes in the scenario's light, (256,).
            rays: maps a homogeneous pixel to a direction in ``map``, (3, 3).
            height_m: camera height above ground [m].
            picture: output image, (height, width, 3).
        """
        for strip, aimed in self._strips(rays):
            part = picture[:, strip]
            size = part.shape[0], part.shape[1]
            pixels.develop(
                ground[:, strip], curve, *self._air.veil(aimed, height_m, *size), part
            )
            shine = self._air.shine(aimed, *size) if self._glares else None
            if shine is not None:
                pixels.add_shine(part, *shine, _GLARE_TINT)
        self._skyline.lay_over(picture, rays)

    def _strips(
        self, rays: NDArray[np.float64]
    ) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        """Strips of columns, each with the rays of its own pixels."""
        width = self._size[1]
        tilt = abs(float(rays[2, 0] / rays[2, 1])) if self._in_strips else 0.0
        if tilt * width <= _ROWS_IN_STRIP:
            yield slice(0, width), rays
            return
        step = max(1, int(_ROWS_IN_STRIP / tilt))
        for first in range(0, width, step):
            aimed = rays.copy()
            aimed[:, 2] += first * rays[:, 0]
            yield slice(first, min(first + step, width)), aimed
