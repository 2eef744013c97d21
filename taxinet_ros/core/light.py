"""Light and weather of one scenario: what the ground receives, and what the camera makes of it.

Irradiance is relative. A clear sky's direct beam falls off with the air mass of Kasten and Young
(Applied Optics 28, 1989), blue faster than red, hence the warm light of a low sun; clouds take from
the beam and give to the diffuse part. The camera's white balance is fixed at a clear mid-morning;
its automatic exposure makes up for part of a lack of light and then reaches its limit, so dawn is
dark in the picture. Display codes are gamma 2.2 with a soft shoulder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sun import sun_direction, sun_position

Colour = NDArray[np.float64]

GAMMA = 2.2
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""What linear red, green and blue (sRGB's) have of brightness."""

_OPTICAL_DEPTH = np.array([0.09, 0.17, 0.36])
_SKY_BLUE = np.array([0.80, 0.94, 1.12])
_DAWN_GLOW = np.array([1.35, 0.92, 0.70])
_REFERENCE_ELEVATION_RAD = math.radians(27.0)
_EXPOSURE_COMPENSATION = 0.6
_EXPOSURE_LIMIT = 3.2
_SHOULDER = 0.8


@dataclass(frozen=True, kw_only=True, slots=True)
class _Cloud:
    """Photometry of a cloud kind: shares of the clear sky's light, tint, and how far one sees.

    The sun is half a degree wide; thin cloud before it scatters its light forwards, into a glow.
    """

    beam: float
    clear_diffuse: float
    cloud_diffuse: float
    tint: tuple[float, float, float]
    visibility_m: float
    sun_width_deg: float = 0.53


_CLOUDS = {
    'clear': _Cloud(
        beam=1.0, clear_diffuse=1.0, cloud_diffuse=0.0, tint=(1, 1, 1), visibility_m=22e3
    ),
    'cirrus': _Cloud(
        beam=0.60, clear_diffuse=0.8, cloud_diffuse=0.16, tint=(0.99, 1.0, 1.03), visibility_m=16e3,
        sun_width_deg=2.5,
    ),
    'scattered': _Cloud(
        beam=0.95, clear_diffuse=0.75, cloud_diffuse=0.07, tint=(1.0, 1.0, 1.0), visibility_m=18e3
    ),
    'broken': _Cloud(
        beam=0.50, clear_diffuse=0.4, cloud_diffuse=0.22, tint=(0.98, 1.0, 1.03), visibility_m=12e3,
        sun_width_deg=4.0,
    ),
    'overcast': _Cloud(
        beam=0.0, clear_diffuse=0.0, cloud_diffuse=0.21, tint=(0.97, 1.0, 1.04), visibility_m=7e3
    ),
    'stratus': _Cloud(
        beam=0.0, clear_diffuse=0.0, cloud_diffuse=0.085, tint=(0.95, 1.0, 1.04), visibility_m=3e3
    ),
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Light:
    """What falls on the level ground, times the exposure.

    Attributes:
        sun: unit vector towards the sun in ``map``, (3,).
        sun_elevation_rad: elevation of the sun [rad].
        direct: irradiance from the sun's disc on level ground, RGB, after exposure.
        diffuse: irradiance from the sky on level ground, RGB, after exposure.
        sky_low, sky_high: display colour 0..255 of the sky at the horizon and 15 deg up.
        sun_width_rad: how wide the sun looks, with its glow in the clouds [rad].
        visibility_m: distance at which haze leaves 1/e of a contrast [m].
        wetness: 0 dry .. 1 under water film.
        rain: intensity 0..1.
        clouds: cloud kind.
    """

    sun: NDArray[np.float64]
    sun_elevation_rad: float
    direct: Colour
    diffuse: Colour
    sky_low: Colour
    sky_high: Colour
    sun_width_rad: float
    visibility_m: float
    wetness: float
    rain: float
    clouds: str

    @property
    def total(self) -> Colour:
        """Irradiance of level, unshaded ground, RGB, after exposure."""
        return self.direct + self.diffuse

    def shade_factor(self, sun_share: float = 1.0) -> Colour:
        """Display-code factor of ground that loses the sun, RGB, 0..1.

        Args:
            sun_share: share of the beam that the clouds overhead had let through, 0..1.
        """
        factor: Colour = (self.diffuse / (self.diffuse + sun_share * self.direct)) ** (1 / GAMMA)
        return factor


def air_mass(elevation_rad: float) -> float:
    """Relative optical air mass (Kasten and Young 1989); below the horizon as at it."""
    degrees = max(math.degrees(elevation_rad), 0.0)
    sine = math.sin(math.radians(degrees))
    return float(1 / (sine + 0.50572 * (degrees + 6.07995) ** -1.6364))


def scenario_light(scenario: Scenario) -> Light:
    """The light of a scenario's place, date, hour, clouds and rain."""
    azimuth, elevation = sun_position(scenario.date, scenario.time_of_day_s)
    direct, diffuse = _weathered(scenario, elevation)
    reference = sum(_clear(_REFERENCE_ELEVATION_RAD))
    level = float(LUMINANCE @ ((direct + diffuse) / reference))
    gain = min(level**-_EXPOSURE_COMPENSATION, _EXPOSURE_LIMIT) / reference
    cloud = _CLOUDS[scenario.clouds]
    low, high = _sky(cloud, diffuse * gain, direct * gain, elevation)
    return Light(
        sun=sun_direction(azimuth, elevation),
        sun_elevation_rad=elevation,
        direct=direct * gain,
        diffuse=diffuse * gain,
        sky_low=low,
        sky_high=high,
        sun_width_rad=math.radians(cloud.sun_width_deg),
        visibility_m=1 / (1 / cloud.visibility_m + scenario.rain / 500.0),
        wetness=0.0 if scenario.rain <= 0 else min(1.0, 0.45 + 0.55 * scenario.rain),
        rain=scenario.rain,
        clouds=scenario.clouds,
    )


def _clear(elevation_rad: float) -> tuple[Colour, Colour]:
    """Direct and diffuse irradiance of level ground under a clear sky, RGB."""
    sine = max(math.sin(elevation_rad), 0.0)
    direct = sine * np.exp(-_OPTICAL_DEPTH * air_mass(elevation_rad))
    # Civil twilight loses a factor of ten for every 3 degrees that the sun sinks.
    dusk = 10.0 ** (min(math.degrees(elevation_rad), 0.0) / 3.0)
    low = math.exp(-max(math.degrees(elevation_rad), 0.0) / 8.0)
    tint = _SKY_BLUE + (_DAWN_GLOW - _SKY_BLUE) * 0.8 * low
    diffuse = 0.16 * (math.sqrt(sine) + 0.06 * dusk + 1e-4) * tint
    return direct, diffuse


def _weathered(scenario: Scenario, elevation_rad: float) -> tuple[Colour, Colour]:
    cloud = _CLOUDS[scenario.clouds]
    direct, diffuse = _clear(elevation_rad)
    thinned = 1 - 0.45 * scenario.rain
    grey = float(LUMINANCE @ (direct + diffuse)) * np.array(cloud.tint)
    # Under a closed cover the colour of a low sun only tints the clouds a little.
    grey *= 0.75 + 0.25 * (direct + diffuse) / float(LUMINANCE @ (direct + diffuse))
    diffuse = cloud.clear_diffuse * diffuse + cloud.cloud_diffuse * grey
    # Rain falls from the thick parts of a cover, which let hardly any beam through.
    return direct * cloud.beam * (1 - scenario.rain) ** 2, diffuse * thinned


def _sky(
    cloud: _Cloud, diffuse: Colour, direct: Colour, elevation_rad: float
) -> tuple[Colour, Colour]:
    """Display colours of the sky at the horizon and 15 degrees above it."""
    clear = cloud.clear_diffuse
    grey = float(LUMINANCE @ diffuse) * np.array(cloud.tint)
    # A sky as a lamp: level ground under radiance L receives L (in units where white reflects it).
    horizon = clear * (0.35 * direct + 2.6 * diffuse) + (1 - clear) * 1.15 * grey
    above = clear * 2.4 * diffuse * np.array([0.80, 0.98, 1.12]) + (1 - clear) * 1.25 * grey
    return display_code(horizon), display_code(above)


def display_code(linear: Colour) -> Colour:
    """Display code 0..255 of a linear exposure, 1 = white; it bends in above 0.8."""
    over = np.maximum(linear - _SHOULDER, 0)
    bent = np.minimum(linear, _SHOULDER) + (1 - _SHOULDER) * (1 - np.exp(-over / (1 - _SHOULDER)))
    code: Colour = 255 * np.maximum(bent, 0) ** (1 / GAMMA)
    return code


def ground_table(light: Light) -> NDArray[np.uint8]:
    """Lookup table (1, 256, 3) from daylight ground colour to display colour in this light.

    Water fills the pores: wet ground is darker, the dark parts most.
    """
    albedo = (np.arange(256)[:, None] / 255) ** GAMMA
    albedo = (1 - 0.22 * light.wetness) * albedo ** (1 + 0.10 * light.wetness)
    return np.rint(display_code(albedo * light.total)).astype(np.uint8)[None]
