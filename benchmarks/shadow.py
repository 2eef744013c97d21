"""When the aircraft's own shadow is in the picture, and how dark, compared with physics.

Physics: direct and diffuse irradiance of a clear day by Ineichen and Perez (Solar Energy 73, 2002,
pp. 151-157) for a Linke turbidity, and the luminous efficacy of each by Perez, Ineichen, Seals,
Michalsky and Stewart (Solar Energy 44, 1990, pp. 271-289; their clearest sky). Skylight is bluer
than sunlight, and brighter for the same energy.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from common import leave

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.light import GAMMA, LUMINANCE, air_mass, scenario_light, sun_position
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.scenario_fields import clock_words
from taxinet_ros.trials.options import read_settings

LINKE_TURBIDITY = 3.3
"""For Grant County in March (monthly map of Remund, Wald, Lefèvre, Ranchin and Page, ISES Solar
World Congress 2003: 3.27)."""

_SOLAR_CONSTANT = 1367.0
_ALTITUDE_M = 360.0
_WATER_CM = 1.0
"""Precipitable water on a dry spring day [cm]."""

_CORE = 0.9
"""Share of the greatest darkening above which a pixel counts as full shade, not penumbra."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ShadowAppearance:
    """The shadow in one picture.

    Attributes:
        hour: local time [h].
        elevation_deg: elevation of the sun.
        from_nose_deg: bearing of the sun, clockwise from ahead; at 180 the shadow lies ahead.
        share: share of the picture's pixels in full shade; 0 if none is in view.
        rendered: luminance of shaded over that of sunlit ground, median over these pixels; NaN
            without such pixels.
        light: the same ratio from the renderer's light model.
        physics: the same ratio on a clear day; ``energy`` is that of irradiance.
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
        elevation_rad: elevation of the sun, above 0.
        turbidity: Linke turbidity at an air mass of 2, above 1.
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
    """Luminance of shaded ground over that of sunlit ground on a clear day, 0..1.

    Uses the luminous efficacies [lm/W] of Perez et al. 1990 for their clearest sky. It assumes that
    shaded ground sees the whole sky; the aircraft hides a part of it, so the true value is a little
    lower.

    Args:
        elevation_rad: elevation of the sun, above 0.
        turbidity: Linke turbidity.
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
    """Evaluate the shadow hour by hour.

    Args:
        settings: scenario values in human keys and units; the default sky is clear.
        hours: local hours at which the sun is up.
        turbidity: Linke turbidity of the clear day to compare with.

    Raises:
        UsageError: a value is outside the range of a scenario.
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
    """Luminance of display codes, valid below the shoulder of the camera's tone curve."""
    found: NDArray[np.float64] = (picture / 255.0) ** GAMMA @ LUMINANCE
    return found


def main(words: Sequence[str] | None = None) -> int:
    """Print a line for each hour: of the first frame of a run, shaded over sunlit ground."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n\n')[0])
    parser.add_argument('--hours', nargs='+', type=float,
                        default=[12, 12.5, 13, 13.5, 14, 15, 16, 17, 17.5])
    parser.add_argument('--turbidity', type=float, default=LINKE_TURBIDITY,
                        help='2 very clear, 5 hazy')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE')
    given = parser.parse_args(words)
    print("       sun        sun from  picture    in picture  renderer's  clear day:  its")
    print('time   elevation  the nose  in shadow  rendered    light       luminance   energy')
    for one in shadow_appearances(read_settings(given.set), given.hours, given.turbidity):
        ratios = ('    -' if math.isnan(ratio) else f'{ratio:5.3f}'
                  for ratio in (one.rendered, one.light, one.physics, one.energy))
        print(
            f'{clock_words(one.hour)}  {one.elevation_deg:7.1f}°  {one.from_nose_deg:6.0f}°  '
            f'{100 * one.share:8.1f}%  {"       ".join(ratios)}'
        )
    return 0


if __name__ == '__main__':
    leave(main)
