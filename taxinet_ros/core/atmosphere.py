"""What lies between the ground and the lens: haze, mirrored sky, glare and the skyline."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import pixels, sky
from taxinet_ros.core.light import Light

_VISIBLE_SHARE = 1 / 400
_WATER_SHARE = 0.55
_SPRAY_SHARE = 0.16
"""Share of the picture that full rain veils evenly: spray in the air and drops on the lens."""

_SPARSE_PX = 15
"""Distance of the columns for which directions are computed; between them, interpolation errs by
less than a tenth of the panorama's columns. It divides the picture's width."""

_PANORAMA = (
    math.degrees(sky.COLUMNS_PER_DEGREE), sky.LOWEST_RAD, sky.STEP_RAD, float(sky.ROWS)
)
"""Columns per radian, elevation of row 0 and step between rows [rad], and number of rows."""

_GLARE_STRENGTH = 120.0
_GLARE_HALF_WIDTH_RAD = math.radians(16.0)
_GLARE_TINT = (1.0, 0.84, 0.58)


class Atmosphere:
    """Makes pictures of the ground in a scenario's light, air, water and sky."""

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
        # Where the skyline is looked up: one column beyond the picture on both sides.
        sparse = np.arange(-1, width // _SPARSE_PX + 1, dtype=np.float64)
        self._sparse = (sparse + 0.5) * _SPARSE_PX - 0.5
        beam = float(light.direct.max() / light.total.max())
        low = math.exp(-max(light.sun_elevation_rad, 0.0) / math.radians(9.0))
        self._glare = _GLARE_STRENGTH * beam * low * min(1.0, float(light.total.max()) * 2)

    def develop(
        self,
        ground: NDArray[np.uint8],
        curve: NDArray[np.uint8],
        rays: NDArray[np.float64],
        height_m: float,
        picture: NDArray[np.uint8],
    ) -> None:
        """Make a picture of the lit ground and lay air, water, glare and skyline over it.

        Args:
            ground: its daylight colours, (height, width, 3).
            curve: what becomes of them in the scenario's light, (256,).
            rays: homogenous pixel to a direction in ``map``, (3, 3).
            height_m: the camera's height above ground [m].
            picture: where the picture is to be, (height, width, 3).
        """
        middle = rays @ self._middle
        sine = np.minimum(np.maximum(-middle[2] / np.sqrt((middle * middle).sum(axis=0)), 1e-4), 1)
        pixels.develop(ground, curve, *self._veil(sine, height_m), picture)
        if self._glare > 1:
            self._add_glare(picture, rays, sine)
        self._skyline(picture, rays)

    def _veil(
        self, sine: NDArray[np.float64], height_m: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What haze and, where wet, the sky's mirror image make of the upper rows of the ground.

        Returns:
            The share of its colour that each row keeps, in 255ths (n,), and what is added (n, 3).
        """
        haze = 1 - np.exp(-height_m / sine / self._light.visibility_m)
        share = haze
        wet = self._light.wetness > 0
        if wet:
            # Schlick's form of Fresnel's law for water, on the share of the ground that is film.
            mirror = _WATER_SHARE * self._light.wetness * (0.02 + 0.98 * (1 - sine) ** 5)
            mirror += _SPRAY_SHARE * self._light.rain
            share = 1 - (1 - haze) * (1 - mirror)
        seen = np.flatnonzero(share > _VISIBLE_SHARE)
        rows = int(seen[-1]) + 1 if len(seen) else 0
        low, high = self._light.sky_low, self._light.sky_high
        added = haze[:rows, None] * low
        if wet:
            rise = np.clip(sine[:rows, None] / math.sin(math.radians(15)), 0, 1)
            mirrored = 0.92 * (low + (high - low) * np.sqrt(rise))
            added += ((1 - haze) * mirror)[:rows, None] * mirrored
        return 255 * (1 - share[:rows]), added

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
        grazing = self._glare * (np.exp(-sine / 0.10) + 0.12)
        beside = np.exp(-0.5 * away * away)
        pixels.add_shine(
            picture, grazing.astype(np.float32), beside.astype(np.float32), _GLARE_TINT
        )

    def _skyline(self, picture: NDArray[np.uint8], rays: NDArray[np.float64]) -> None:
        """Replace everything above the end of the ground by the panorama."""
        f0, f1, f2 = rays[2].tolist()
        # Row at which the ray's fall reaches the end of the ground, at both sides of the picture.
        ends = f2, f0 * (picture.shape[1] - 1) + f2
        last = max((-sky.GROUND_END_TAN - end) / f1 for end in ends)
        rows = min(math.floor(last) + 1, picture.shape[0])
        if rows <= 0:
            return
        across, up = self._directions(rays, rows)
        far = cv2.remap(self._panorama, across, up, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        lowest = (-math.atan(sky.GROUND_END_TAN) - sky.LOWEST_RAD) / sky.STEP_RAD
        cv2.copyTo(far, (up > lowest).view(np.uint8), picture[:rows])

    def _directions(
        self, rays: NDArray[np.float64], rows: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Panorama column and row, (rows, width) each, of the upper ``rows`` of the picture."""
        places = pixels.on_panorama(rays, self._sparse, rows, _PANORAMA)
        size = (_SPARSE_PX * len(self._sparse), rows)
        wide = [cv2.resize(sparse, size)[:, _SPARSE_PX:-_SPARSE_PX] for sparse in places]
        return np.ascontiguousarray(wide[0], np.float32), np.ascontiguousarray(wide[1], np.float32)
