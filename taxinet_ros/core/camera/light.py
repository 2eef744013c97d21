"""Light and weather of a scenario: sun, irradiance of the ground, shade of single clouds.

The sun's position comes from the library astral (NOAA's equations, with refraction); irradiance and
exposure are computed from it and the weather. Single clouds cast a fixed pattern of shade on the
ground.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from astral import Observer
from astral.sun import azimuth, elevation
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.texture import Floats, smooth_noise
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError


def sun_position(
    date: str, time_of_day_s: float, runway: Runway | None = None
) -> tuple[float, float]:
    """Azimuth (clockwise from true north, 0..2 pi) and elevation of the sun [rad].

    Args:
        date: ISO date.
        time_of_day_s: local time since midnight [s], in the runway's time zone.
        runway: runway of the observer; None for KMWH 04.

    Raises:
        UsageError: invalid date or time.
    """
    if not math.isfinite(time_of_day_s):
        raise UsageError(f'sun: time of day is {time_of_day_s}, not a number of seconds')
    runway = runway or default_runway()
    try:
        day = datetime.datetime.fromisoformat(date).replace(tzinfo=runway.zone)
    except ValueError as error:
        raise UsageError(f'sun: date is {date!r}, not YYYY-MM-DD') from error
    moment = day + datetime.timedelta(seconds=time_of_day_s)
    observer = Observer(*runway.threshold_deg, 0.0)
    return math.radians(azimuth(observer, moment)), math.radians(elevation(observer, moment))


def sun_direction(
    azimuth_rad: float, elevation_rad: float, runway: Runway | None = None
) -> NDArray[np.float64]:
    """Unit vector towards the sun in ``map`` (x along the runway, y left, z up), shape (3,)."""
    yaw = (runway or default_runway()).bearing_rad - azimuth_rad
    flat = math.cos(elevation_rad)
    return np.array([flat * math.cos(yaw), flat * math.sin(yaw), math.sin(elevation_rad)])


Colour = NDArray[np.float64]
GAMMA = 2.2
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance weights of linear sRGB red, green and blue."""
_OPTICAL_DEPTH = np.array([0.09, 0.17, 0.36])
_SKY_BLUE = np.array([0.80, 0.94, 1.12])
_DAWN_GLOW = np.array([1.35, 0.92, 0.70])
_REFERENCE_ELEVATION_RAD = math.radians(27.0)
_EXPOSURE_COMPENSATION = 0.6
_EXPOSURE_LIMIT = 3.2
_SHOULDER = 0.8


@dataclass(frozen=True, kw_only=True, slots=True)
class _Cloud:
    """Photometry of a cloud kind: shares of the clear sky's light, tint and visibility.

    The sun is half a degree wide; thin cloud in front of it scatters its light into a wider glow.
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
    """Light and weather of a scenario; irradiance is for level ground, times the exposure.

    Attributes:
        sun: unit vector towards the sun in ``map``, (3,).
        sun_elevation_rad: elevation of the sun [rad].
        direct: irradiance from the sun's disc on level ground, RGB, after exposure.
        diffuse: irradiance from the sky on level ground, RGB, after exposure.
        sky_low, sky_high: display colour 0..255 of the sky at the horizon and 15 deg up.
        sun_width_rad: angular width of the sun, including glow in the clouds [rad].
        visibility_m: distance at which haze reduces contrast to 1/e [m].
        wetness: 0 dry .. 1 covered by a water film.
        rain: intensity 0..1.
        clouds: cloud kind.
        exposure: factor on the irradiance, RGB, with the white balance.
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
    exposure: Colour

    @property
    def total(self) -> Colour:
        """Irradiance of level, unshaded ground, RGB, after exposure."""
        return self.direct + self.diffuse

    def shade_factor(self, sun_share: float = 1.0) -> Colour:
        """Display-code factor of ground in cloud shade, RGB, 0..1.

        Args:
            sun_share: share of the beam transmitted by the clouds at the observer, 0..1.
        """
        factor: Colour = (self.diffuse / (self.diffuse + sun_share * self.direct)) ** (1 / GAMMA)
        return factor


def air_mass(elevation_rad: float) -> float:
    """Relative optical air mass (Kasten and Young 1989); constant below the horizon."""
    degrees = max(math.degrees(elevation_rad), 0.0)
    sine = math.sin(math.radians(degrees))
    return float(1 / (sine + 0.50572 * (degrees + 6.07995) ** -1.6364))


def scenario_light(
    scenario: Scenario, runway: Runway | None = None, camera: CameraModel | None = None
) -> Light:
    """The light of a scenario's place, date, hour, clouds and rain, as its camera is exposed.

    Args:
        scenario: the scenario.
        runway: replaces the scenario's.
        camera: replaces the scenario's.
    """
    runway, camera = runway or scenario.runway, camera or scenario.camera_model
    azimuth, elevation = sun_position(scenario.date, scenario.time_of_day_s, runway)
    direct, diffuse = _weathered(scenario, elevation)
    reference = sum(_clear(_REFERENCE_ELEVATION_RAD))
    level = float(LUMINANCE @ ((direct + diffuse) / reference))
    gain = min(level**-_EXPOSURE_COMPENSATION, _EXPOSURE_LIMIT) / reference
    gain = gain * 2.0**camera.exposure_ev
    cloud, rain = _CLOUDS[scenario.clouds], scenario.rain_fraction
    low, high = _sky(cloud, diffuse * gain, direct * gain, elevation)
    return Light(
        sun=sun_direction(azimuth, elevation, runway),
        sun_elevation_rad=elevation,
        direct=direct * gain,
        diffuse=diffuse * gain,
        sky_low=low,
        sky_high=high,
        sun_width_rad=math.radians(cloud.sun_width_deg),
        visibility_m=1 / (1 / cloud.visibility_m + rain / 500.0),
        wetness=0.0 if rain <= 0 else min(1.0, 0.45 + 0.55 * rain),
        rain=rain,
        clouds=scenario.clouds,
        exposure=gain,
    )


def _clear(elevation_rad: float) -> tuple[Colour, Colour]:
    """Direct and diffuse irradiance of level ground under a clear sky, RGB."""
    sine = max(math.sin(elevation_rad), 0.0)
    direct = sine * np.exp(-_OPTICAL_DEPTH * air_mass(elevation_rad))
    # In civil twilight, light drops by a factor of ten per 3 degrees of sun depression.
    dusk = 10.0 ** (min(math.degrees(elevation_rad), 0.0) / 3.0)
    low = math.exp(-max(math.degrees(elevation_rad), 0.0) / 8.0)
    tint = _SKY_BLUE + (_DAWN_GLOW - _SKY_BLUE) * 0.8 * low
    diffuse = 0.16 * (math.sqrt(sine) + 0.06 * dusk + 1e-4) * tint
    return direct, diffuse


def _weathered(scenario: Scenario, elevation_rad: float) -> tuple[Colour, Colour]:
    cloud = _CLOUDS[scenario.clouds]
    direct, diffuse = _clear(elevation_rad)
    thinned = 1 - 0.45 * scenario.rain_fraction
    grey = float(LUMINANCE @ (direct + diffuse)) * np.array(cloud.tint)
    # Under a closed cover, the colour of a low sun tints the clouds only slightly.
    grey *= 0.75 + 0.25 * (direct + diffuse) / float(LUMINANCE @ (direct + diffuse))
    diffuse = cloud.clear_diffuse * diffuse + cloud.cloud_diffuse * grey
    # Rain falls from the thick parts of a cover, which transmit hardly any beam.
    return direct * cloud.beam * (1 - scenario.rain_fraction) ** 2, diffuse * thinned


def _sky(
    cloud: _Cloud, diffuse: Colour, direct: Colour, elevation_rad: float
) -> tuple[Colour, Colour]:
    """Display colours of the sky at the horizon and 15 degrees above it."""
    clear = cloud.clear_diffuse
    grey = float(LUMINANCE @ diffuse) * np.array(cloud.tint)
    # In units where white reflects L, level ground under a uniform sky of radiance L receives L.
    horizon = clear * (0.35 * direct + 2.6 * diffuse) + (1 - clear) * 1.15 * grey
    above = clear * 2.4 * diffuse * np.array([0.80, 0.98, 1.12]) + (1 - clear) * 1.25 * grey
    return display_code(horizon), display_code(above)


def display_code(linear: Colour) -> Colour:
    """Display code 0..255 of a linear exposure (1 = white); compressed above 0.8."""
    over = np.maximum(linear - _SHOULDER, 0)
    bent = np.minimum(linear, _SHOULDER) + (1 - _SHOULDER) * (1 - np.exp(-over / (1 - _SHOULDER)))
    code: Colour = 255 * np.maximum(bent, 0) ** (1 / GAMMA)
    return code


def linear_exposure(code: Colour) -> Colour:
    """Inverse of :func:`display_code`, for codes 0..254.5."""
    bent = (code / 255) ** GAMMA
    over = np.maximum((bent - _SHOULDER) / (1 - _SHOULDER), 0)
    return np.minimum(bent, _SHOULDER) - (1 - _SHOULDER) * np.log1p(-over)


def ground_table(light: Light) -> NDArray[np.uint8]:
    """Lookup table (1, 256, 3) from daylight ground colour to display colour in this light.

    Wet ground is darker, dark parts most.
    """
    albedo = (np.arange(256)[:, None] / 255) ** GAMMA
    albedo = (1 - 0.22 * light.wetness) * albedo ** (1 + 0.10 * light.wetness)
    return np.rint(display_code(albedo * light.total)).astype(np.uint8)[None]


_CELL_M = 8.0
_SHAPE = (416, 80)  # x and y cells: -100..3,228 m and -320..320 m
_START_X_M, _START_Y_M = -100.0, -320.0
_COVER = {'scattered': (0.75, 0.60), 'broken': (-0.15, 0.45)}
"""Noise threshold of cloud, and the transmission of a cloud."""


class CloudShade:
    """Transmission of the sun's beam by single clouds, and their shade."""

    def __init__(self, light: Light, height: int, width: int) -> None:
        """Prepare for images of ``height`` by ``width`` pixels."""
        self._light = light
        casts = light.clouds in _COVER and light.direct.max() > 0.01 * light.total.max()
        self._beam = _beam(light.clouds) if casts else None
        rows = np.arange(height, dtype=np.float64)
        self._middle = np.stack([np.full_like(rows, (width - 1) / 2), rows, np.ones_like(rows)])
        self._depth = 1 - light.shade_factor()

    @property
    def casts(self) -> bool:
        """Whether there are single clouds that cast shade."""
        return self._beam is not None

    def sun_share(self, x_m: float, y_m: float) -> float:
        """Share (0..1) of the beam that reaches the ground at a point in ``map``."""
        if self._beam is None:
            return 1.0
        return float(self._look_up(np.array([x_m]), np.array([y_m]))[0])

    def shadow_depth(self, x_m: float, y_m: float) -> Colour:
        """How far a shadow at a point in ``map`` darkens display codes of ground, RGB, 0..1."""
        if self._beam is None:
            return self._depth
        return 1 - self._light.shade_factor(self.sun_share(x_m, y_m))

    def shade(
        self, colour: NDArray[np.uint8], rays: NDArray[np.float64], camera: NDArray[np.float64]
    ) -> None:
        """Darken the unlit ground ``colour`` (height, width, 3) in place where clouds hide the sun.

        Args:
            colour: daylight colours of the ground.
            rays: maps a homogeneous pixel to a direction in ``map``, (3, 3).
            camera: camera position in ``map`` (3,).
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
