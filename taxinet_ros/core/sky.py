"""What stands above the ground at the horizon: far fields, hills, trees, hangars and the sky.

A panorama in azimuth and elevation, made once per scenario. The camera looks down, so only its
lowest rows are ever seen, at the upper edge of the picture.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.light import GAMMA, Light, display_code
from taxinet_ros.core.noise import Floats, smooth_noise

COLUMNS, ROWS = 1440, 160
LOWEST_RAD, STEP_RAD = math.radians(-0.5), math.radians(0.1)
"""Elevation of row 0's centre and step between rows; column step is 0.25 degrees of yaw."""

GROUND_END_TAN = 0.0022
"""Tangent of the depression above which the panorama replaces the ground (about 0.9 km away)."""

_FAR_FIELD = np.array([141, 133, 103], np.float32)
_TREES = np.array([84, 92, 62], np.float32)
_HILLS = np.array([124, 128, 118], np.float32)
_HANGARS = np.array(
    [[206, 205, 200], [150, 165, 180], [120, 116, 108], [186, 170, 140]], np.float32
)


def panorama(light: Light) -> NDArray[np.uint8]:
    """Display colours (ROWS, COLUMNS + 1, 3); column k is yaw k / 4 - 180 deg, row 0 lowest."""
    elevation = LOWEST_RAD + STEP_RAD * np.arange(ROWS, dtype=np.float32)[:, None]
    picture = _sky(light, elevation)
    shine = np.asarray(light.total * 0.85 + light.diffuse * 0.15)
    haze = math.exp(-1500.0 / light.visibility_m)
    hills = np.radians(0.35 + 0.18 * _profile(301, 60) + 0.06 * _profile(302, 12))
    trees = np.radians(0.10 + 0.12 * np.clip(_profile(303, 5), 0, None) + 0.05 * _profile(304, 2))
    for tops, colour, clearness in ((hills, _HILLS, 0.45 * haze), (trees, _TREES, haze)):
        _below(picture, elevation, tops, _lit(colour, shine), light.sky_low, clearness)
    _hangars(picture, elevation, shine, light.sky_low, haze)
    _below(picture, elevation, np.zeros(COLUMNS), _lit(_FAR_FIELD, shine), light.sky_low, haze)
    whole = np.concatenate([picture, picture[:, :1]], axis=1)
    codes: NDArray[np.uint8] = np.clip(np.rint(whole), 0, 255).astype(np.uint8)
    return codes


def _lit(colour: Floats, shine: NDArray[np.float64]) -> NDArray[np.float64]:
    return display_code((colour / 255.0) ** GAMMA * shine)


def _profile(seed: int, cell: float) -> NDArray[np.float32]:
    """Height profile round the compass that closes on itself."""
    noise = smooth_noise(seed, (2, COLUMNS), (1, cell))[0]
    ramp = np.linspace(0, 1, COLUMNS, dtype=np.float32)
    closed: NDArray[np.float32] = noise - ramp * (noise[-1] - noise[0])
    return closed


def _sky(light: Light, elevation: Floats) -> NDArray[np.float64]:
    """Gradient from the horizon upwards, clouds, and the glow round a low sun."""
    rise = np.clip(elevation / math.radians(15), 0, 1)[:, :, None]
    picture = light.sky_low + (light.sky_high - light.sky_low) * np.sqrt(rise)
    picture = np.repeat(picture, COLUMNS, axis=1)
    cover = {'scattered': (0.6, 20.0), 'broken': (-0.2, 26.0), 'cirrus': (0.3, 8.0)}
    if light.clouds in cover:
        start, strength = cover[light.clouds]
        noise = smooth_noise(310, (ROWS, COLUMNS), (9, 60)) + smooth_noise(
            311, (ROWS, COLUMNS), (4, 20)
        )
        noise[:, -40:] += (noise[:, :1] - noise[:, -1:]) * np.linspace(0, 1, 40, dtype=np.float32)
        picture += (strength * np.clip(noise - start, 0, 1.5))[:, :, None]
    beam = light.direct.max() / (light.total.max() + 1e-9)
    if beam > 0.01 and light.sun_elevation_rad > 0:
        yaw = np.radians(np.arange(COLUMNS) / 4 - 180.0)
        away = np.angle(np.exp(1j * (yaw - math.atan2(light.sun[1], light.sun[0]))))
        distance = np.square(away)[None] + np.square(elevation - light.sun_elevation_rad)
        glow = beam * (150 * np.exp(-distance / 0.004) + 60 * np.exp(-distance / 0.10))
        picture += glow[:, :, None] * np.array([1.0, 0.86, 0.62])
    return picture


def _below(
    picture: NDArray[np.float64],
    elevation: Floats,
    tops: NDArray[np.floating],
    colour: NDArray[np.float64],
    haze_colour: NDArray[np.float64],
    clearness: float,
) -> None:
    """Paint everything below a skyline, faded into the haze."""
    share = np.clip((tops[None] - elevation) / STEP_RAD + 0.5, 0, 1)[:, :, None]
    picture += share * (haze_colour + (colour - haze_colour) * clearness - picture)


def _hangars(
    picture: NDArray[np.float64],
    elevation: Floats,
    shine: NDArray[np.float64],
    haze_colour: NDArray[np.float64],
    clearness: float,
) -> None:
    """A scatter of airport buildings and parked things along the skyline."""
    rng = np.random.default_rng(320)
    for _ in range(130):
        start, width = int(rng.integers(0, COLUMNS)), int(rng.integers(1, 9))
        top = math.radians(float(rng.uniform(0.05, 0.45)))
        colour = _lit(_HANGARS[rng.integers(0, len(_HANGARS))], shine)
        part = picture[:, start : start + width]
        tops = np.full(part.shape[1], top)
        _below(part, elevation, tops, colour, haze_colour, clearness)
