"""What lies between the ground and the lens: haze, mirrored sky, glare and the skyline."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import pixels, sky
from taxinet_ros.core.light import Light

_WATER_SHARE = 0.55
_SPRAY_SHARE = 0.16
"""Share of the picture that full rain veils evenly: spray in the air and drops on the lens."""

_SPARSE_PX = 15
"""Distance of the columns for which directions are computed; between them, interpolation errs by
less than a tenth of the panorama's columns. It divides the picture's width."""

_GLARE_STRENGTH = 120.0
_LEAST_GLARE = 1.0
_GLARE_HALF_WIDTH_RAD = math.radians(16.0)
_GLARE_TINT = (1.0, 0.84, 0.58)


class Atmosphere:
    """Makes pictures of the ground in a scenario's light, air, water and sky."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare for pictures of ``height`` by ``width`` pixels in one scenario's light."""
        self._size = height, width
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
        self._skyline = pixels.Panorama(
            sky.panorama(light),
            lowest_rad=sky.LOWEST_RAD,
            step_rad=sky.STEP_RAD,
            end_tan=sky.GROUND_END_TAN,
            spacing_px=_SPARSE_PX,
        )

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
        pixels.develop(ground, curve, *self._air.veil(rays, height_m, *self._size), picture)
        shine = self._air.shine(rays, *self._size) if self._glares else None
        if shine is not None:
            pixels.add_shine(picture, *shine, _GLARE_TINT)
        self._skyline.lay_over(picture, rays)
