"""What lies between the ground and the lens: haze, mirrored sky, glare and the skyline."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import sky
from taxinet_ros.core.light import Light

_VISIBLE_SHARE = 1 / 400
_WATER_SHARE = 0.55
_SPRAY_SHARE = 0.16
"""Share of the picture that full rain veils evenly: spray in the air and drops on the lens."""

_GLARE_STRENGTH = 120.0
_GLARE_HALF_WIDTH_RAD = math.radians(16.0)


class Atmosphere:
    """Adds a scenario's air, water and sky to pictures of the lit ground, in place."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare for pictures of ``height`` by ``width`` pixels in one scenario's light."""
        self._light = light
        self._panorama = sky.panorama(light)
        self._rows = np.arange(height, dtype=np.float64)
        self._columns = np.arange(width, dtype=np.float64)
        ones = np.ones_like
        self._middle = np.stack(
            [np.full_like(self._rows, (width - 1) / 2), self._rows, ones(self._rows)]
        )
        self._across = np.stack(
            [self._columns, np.full_like(self._columns, 60.0), ones(self._columns)]
        )
        beam = float(light.direct.max() / light.total.max())
        low = math.exp(-max(light.sun_elevation_rad, 0.0) / math.radians(9.0))
        self._glare = _GLARE_STRENGTH * beam * low * min(1.0, float(light.total.max()) * 2)

    def apply(self, picture: NDArray[np.uint8], rays: NDArray[np.float64], height_m: float) -> None:
        """Lay air, water, glare and skyline over ``picture`` (height, width, 3).

        Args:
            picture: the lit ground, changed in place.
            rays: homogenous pixel to a direction in ``map``, (3, 3).
            height_m: the camera's height above ground [m].
        """
        middle = rays @ self._middle
        sine = np.clip(-middle[2] / np.sqrt((middle * middle).sum(axis=0)), 1e-4, 1)
        self._veil(picture, sine, height_m)
        if self._glare > 1:
            self._add_glare(picture, rays, sine)
        self._skyline(picture, rays)

    def _veil(self, picture: NDArray[np.uint8], sine: NDArray[np.float64], height_m: float) -> None:
        """Fade the ground row by row into haze and, where wet, into the sky's mirror image."""
        haze = 1 - np.exp(-height_m / sine / self._light.visibility_m)
        # Schlick's form of Fresnel's law for water, on the share of the ground that is film.
        mirror = _WATER_SHARE * self._light.wetness * (0.02 + 0.98 * (1 - sine) ** 5)
        mirror += _SPRAY_SHARE * self._light.rain
        share = 1 - (1 - haze) * (1 - mirror)
        seen = np.flatnonzero(share > _VISIBLE_SHARE)
        if not len(seen):
            return
        rows = int(seen[-1]) + 1
        low, high = self._light.sky_low, self._light.sky_high
        rise = np.clip(sine[:rows, None] / math.sin(math.radians(15)), 0, 1)
        mirrored = 0.92 * (low + (high - low) * np.sqrt(rise))
        added = haze[:rows, None] * low + ((1 - haze) * mirror)[:rows, None] * mirrored
        kept = np.empty((rows, picture.shape[1], 3), np.uint8)
        kept[:] = np.rint(255 * (1 - share[:rows]))[:, None, None]
        extra = np.empty_like(kept)
        extra[:] = np.rint(np.clip(added, 0, 255))[:, None, :]
        part = picture[:rows]
        cv2.multiply(part, kept, dst=part, scale=1 / 255)
        cv2.add(part, extra, dst=part)

    def _add_glare(
        self, picture: NDArray[np.uint8], rays: NDArray[np.float64], sine: NDArray[np.float64]
    ) -> None:
        """A broad shine on the ground under a low sun, strongest at grazing angles."""
        across = rays @ self._across
        sun = self._light.sun
        yaw = np.arctan2(across[1], across[0]) - math.atan2(sun[1], sun[0])
        away = np.abs(np.angle(np.exp(1j * yaw))) / _GLARE_HALF_WIDTH_RAD
        if away.min() > 3:
            return
        shine = self._glare * np.outer(np.exp(-sine / 0.10) + 0.12, np.exp(-0.5 * away * away))
        warm = [np.rint(shine * share).astype(np.uint8) for share in (1.0, 0.84, 0.58)]
        cv2.add(picture, cv2.merge(warm), dst=picture)

    def _skyline(self, picture: NDArray[np.uint8], rays: NDArray[np.float64]) -> None:
        """Replace everything above the end of the ground by the panorama."""
        ends = rays[2, 0] * np.array([0.0, picture.shape[1] - 1]) + rays[2, 2]
        # Row at which the ray's fall reaches the end of the ground, at both sides of the picture.
        last = ((-sky.GROUND_END_TAN - ends) / rays[2, 1]).max()
        rows = min(math.floor(float(last)) + 1, picture.shape[0])
        if rows <= 0:
            return
        u, v = np.meshgrid(self._columns, self._rows[:rows])
        d = [row[0] * u + row[1] * v + row[2] for row in rays]
        elevation = np.arctan2(d[2], np.hypot(d[0], d[1]))
        yaw = np.arctan2(d[1], d[0])
        across = ((np.degrees(yaw) + 180.0) * 4).astype(np.float32)
        up = np.clip((elevation - sky.LOWEST_RAD) / sky.STEP_RAD, 0, sky.ROWS - 1).astype(
            np.float32
        )
        far = cv2.remap(self._panorama, across, up, cv2.INTER_LINEAR)
        above = d[2] > -sky.GROUND_END_TAN * np.hypot(d[0], d[1])
        part = picture[:rows]
        np.copyto(part, far, where=above[:, :, None])
