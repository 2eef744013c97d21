"""Visibility and darkness of the aircraft's own shadow, compared with physics.

Physics: direct and diffuse irradiance of a clear day by Ineichen and Perez (Solar Energy 73, 2002,
pp. 151-157) for a Linke turbidity, and what of either is light to an eye or a camera by Perez,
Ineichen, Seals, Michalsky and Stewart (Solar Energy 44, 1990, pp. 271-289; their clearest sky). The
sky's light is bluer than the sun's, and brighter for the same energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.light import GAMMA, LUMINANCE, air_mass, scenario_light, sun_position
from taxinet_ros.core.scenario import scenario_from_human

LINKE_TURBIDITY = 3.3
"""Of Grant County in March (monthly map of Remund, Wald, Lefèvre, Ranchin and Page, ISES Solar
World Congress 2003: 3.27)."""

_SOLAR_CONSTANT = 1367.0
_ALTITUDE_M = 360.0
_WATER_CM = 1.0
"""Precipitable water, of a dry spring day."""

_CORE = 0.9
"""Part of the greatest darkening from which a pixel counts as full shade, not as penumbra."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ShadowAppearance:
    """The shadow in one picture.

    Attributes:
        hour: local time [h].
        elevation_deg: of the sun.
        from_nose_deg: where the sun stands, clockwise from ahead: at 180 the shadow lies ahead.
        share: of the picture's pixels that are in full shade; 0 where none is in view.
        rendered: light of shaded ground over that of sunlit ground, median over these pixels; NaN
            where there are none.
        light: the same ratio by the renderer's light.
        physics: the same by a clear day's light; of its energy in ``energy``.
        energy: diffuse over global irradiance.
    """

    hour: float
    elevation_deg: float
    from_nose_deg: float
    share: float
    rendered: float
    light: float
    physics: float
    energy: float


def clear_day(elevation_rad: float, turbidity: float = LINKE_TURBIDITY) -> tuple[float, float]:
    """Direct and diffuse irradiance of level ground on a clear day [W/m^2].

    Args:
        elevation_rad: of the sun, above 0.
        turbidity: Linke's, above 1, at an air mass of 2.
    """
    sine = math.sin(elevation_rad)
    mass = math.exp(-_ALTITUDE_M / 8434.5) * air_mass(elevation_rad)
    rayleigh, haze = math.exp(-_ALTITUDE_M / 8000), math.exp(-_ALTITUDE_M / 1250)
    first, second = 5.09e-5 * _ALTITUDE_M + 0.868, 3.92e-5 * _ALTITUDE_M + 0.0387
    depth = second * mass * (rayleigh + haze * (turbidity - 1))
    level = first * _SOLAR_CONSTANT * sine * math.exp(-depth)
    beam = _SOLAR_CONSTANT * (0.664 + 0.163 / rayleigh) * math.exp(-0.09 * mass * (turbidity - 1))
    most = 1 - (0.1 - 0.2 * math.exp(-turbidity)) / (0.1 + 0.882 / rayleigh)
    direct = min(beam * sine, most * level)
    return direct, level - direct


def shaded_light(elevation_rad: float, turbidity: float = LINKE_TURBIDITY) -> float:
    """Luminance of ground in the shade over that in the sun, on a clear day, 0..1.

    By the luminous efficacies [lm/W] of Perez et al. 1990 for their clearest sky. All of the sky is
    supposed to be seen from the shade; the aircraft hides a part of it, so the truth is a little
    darker.

    Args:
        elevation_rad: of the sun, above 0.
        turbidity: Linke's.
    """
    direct, diffuse = clear_day(elevation_rad, turbidity)
    zenith = math.pi / 2 - elevation_rad
    brightness = diffuse * air_mass(elevation_rad) / _SOLAR_CONSTANT
    of_sun = 101.18 + 1.58 * _WATER_CM - 1.10 * math.exp(5.73 * zenith - 5) - 8.29 * brightness
    of_sky = 152.23 + 0.35 * _WATER_CM - 45.27 * math.cos(zenith) - 7.98 * math.log(brightness)
    direct, diffuse = max(of_sun, 0.0) * direct, of_sky * diffuse
    return diffuse / (diffuse + direct)


def shadow_appearances(
    settings: Mapping[str, object], hours: Sequence[float], turbidity: float = LINKE_TURBIDITY
) -> list[ShadowAppearance]:
    """The shadow hour by hour.

    Args:
        settings: scenario values, human keys and units; a clear sky where they do not say.
        hours: local hours at which the sun is up.
        turbidity: Linke's, of the clear day to compare with.

    Raises:
        UsageError: a value that no scenario may have.
    """
    return [
        _look({'clouds': 'clear', **settings, 'time_of_day_h': hour}, turbidity) for hour in hours
    ]


def _look(settings: Mapping[str, object], turbidity: float) -> ShadowAppearance:
    scene = scenario_from_human(settings)
    azimuth, elevation = sun_position(scene.date, scene.time_of_day_s, scene.runway)
    light, state = scenario_light(scene), Aircraft(scene).state
    dark, lit = (
        _linear(Camera(scenario_from_human({**settings, 'shadows': word})).render(state, 0))
        for word in ('on', 'off')
    )
    lost = 1 - dark / np.maximum(lit, 1e-6)
    core = lost > _CORE * np.percentile(lost, 99.9) if lost.max() > 0.01 else lost > 1
    nose = scene.runway.bearing_rad - state.yaw_rad
    up = elevation > 0
    direct, diffuse = clear_day(elevation, turbidity) if up else (math.nan, math.nan)
    return ShadowAppearance(
        hour=scene.time_of_day_s / 3600, elevation_deg=math.degrees(elevation),
        from_nose_deg=math.degrees((azimuth - nose) % (2 * math.pi)), share=float(core.mean()),
        rendered=float(np.median(dark[core] / lit[core])) if core.any() else math.nan,
        light=float(LUMINANCE @ light.diffuse / (LUMINANCE @ light.total)),
        physics=shaded_light(elevation, turbidity) if up else math.nan,
        energy=diffuse / (direct + diffuse),
    )


def _linear(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Luminance of display codes, as far as the camera's shoulder is not reached."""
    found: NDArray[np.float64] = (picture / 255.0) ** GAMMA @ LUMINANCE
    return found
