"""Panorama of the horizon: far fields, hills, trees, hangars and sky.

The panorama in azimuth and elevation is made once per scenario, its shapes once per process. The
camera looks down, so only the lowest rows are visible, at the upper image edge.
"""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.light import GAMMA, Light, display_code
from taxinet_ros.core.camera.texture import Floats, smooth_noise

COLUMNS, ROWS, COLUMNS_PER_DEGREE = 1440, 160, 4
LOWEST_RAD, STEP_RAD = math.radians(-0.5), math.radians(0.1)
"""Elevation of the centre of row 0, and step between rows; columns cover 360 degrees of azimuth."""

GROUND_END_TAN = 0.0022
"""Tangent of the depression above which the panorama replaces the ground (about 0.9 km away)."""

_FAR_FIELD = np.array([141, 133, 103], np.float32)
_TREES = np.array([84, 92, 62], np.float32)
_HILLS = np.array([124, 128, 118], np.float32)
_HANGARS = np.array(
    [[206, 205, 200], [150, 165, 180], [120, 116, 108], [186, 170, 140]], np.float32
)


_COVER = {'scattered': (0.6, 20.0), 'broken': (-0.2, 26.0), 'cirrus': (0.3, 8.0)}
"""Noise threshold of cloud, and the added brightness in display codes."""

_GLOW_TINT = (1.0, 0.86, 0.62)


def panorama(light: Light) -> NDArray[np.uint8]:
    """Display colours (ROWS, COLUMNS, 3); column k is yaw k / 4 - 180 deg, row 0 lowest."""
    planes = _sky(light)
    shine = np.asarray(light.total * 0.85 + light.diffuse * 0.15)
    haze = math.exp(-1500.0 / light.visibility_m)
    clear = np.array([0.45 * haze, *[haze] * 6])[:, None]
    paints = np.stack([_lit(paint, shine) for paint in (_HILLS, _TREES, *_HANGARS, _FAR_FIELD)])
    colours = (light.sky_low + (paints - light.sky_low) * clear).astype(np.float32)
    behind, cover = _skyline()
    for plane, channel in zip(planes, colours.T, strict=True):
        low = plane[: len(behind)]
        low *= behind
        for share, code in zip(cover, channel, strict=True):
            cv2.scaleAdd(share, float(code), low, dst=low)
    picture = cv2.merge([cv2.convertScaleAbs(plane) for plane in planes])
    return np.asarray(picture, np.uint8)


def _lit(colour: Floats, shine: NDArray[np.float64]) -> NDArray[np.float64]:
    return display_code((colour / 255.0) ** GAMMA * shine)


def _profile(seed: int, cell: float) -> NDArray[np.float32]:
    """Periodic height profile over azimuth."""
    noise = smooth_noise(seed, (2, COLUMNS), (1, cell))[0]
    ramp = np.linspace(0, 1, COLUMNS, dtype=np.float32)
    closed: NDArray[np.float32] = noise - ramp * (noise[-1] - noise[0])
    return closed


def _sky(light: Light) -> Floats:
    """Sky gradient, clouds, and the glow around a low sun; (3, ROWS, COLUMNS).

    Display codes, not yet clipped to 0..255.
    """
    elevation = LOWEST_RAD + STEP_RAD * np.arange(ROWS)
    rise = np.clip(elevation / math.radians(15), 0, 1)[:, None]
    gradient = light.sky_low + (light.sky_high - light.sky_low) * np.sqrt(rise)
    planes = np.empty((3, ROWS, COLUMNS), np.float32)
    planes[:] = gradient.T[:, :, None]
    if light.clouds in _COVER:
        planes += _clouds(light.clouds)
    beam = light.direct.max() / (light.total.max() + 1e-9)
    if beam > 0.01 and light.sun_elevation_rad > 0:
        yaw = np.radians(np.arange(COLUMNS) / COLUMNS_PER_DEGREE - 180.0)
        away = np.angle(np.exp(1j * (yaw - math.atan2(light.sun[1], light.sun[0]))))
        above = elevation - light.sun_elevation_rad
        for strength, width in ((150, 0.004), (60, 0.10)):
            column = (beam * strength * np.exp(-np.square(above) / width)).astype(np.float32)
            glow = np.outer(column, np.exp(-np.square(away) / width).astype(np.float32))
            for plane, tint in zip(planes, _GLOW_TINT, strict=True):
                cv2.scaleAdd(glow, tint, plane, dst=plane)
    return planes


@cache
def _clouds(kind: str) -> Floats:
    """Brightness added by a cloud kind to the sky, (ROWS, COLUMNS), periodic in azimuth."""
    start, strength = _COVER[kind]
    noise = smooth_noise(310, (ROWS, COLUMNS), (9, 60)) + smooth_noise(
        311, (ROWS, COLUMNS), (4, 20)
    )
    noise[:, -40:] += (noise[:, :1] - noise[:, -1:]) * np.linspace(0, 1, 40, dtype=np.float32)
    added: Floats = (strength * np.clip(noise - start, 0, 1.5)).astype(np.float32)
    return added


@cache
def _skyline() -> tuple[Floats, Floats]:
    """Shapes on the horizon, independent of light.

    Returns:
        Visible share of the sky, (n, COLUMNS), for the lowest n rows; and the shares of hills,
        trees, each paint of the hangars, and the far field, (7, n, COLUMNS).
    """
    hills = np.radians(0.35 + 0.18 * _profile(301, 60) + 0.06 * _profile(302, 12))
    trees = np.radians(0.10 + 0.12 * np.clip(_profile(303, 5), 0, None) + 0.05 * _profile(304, 2))
    rows = math.ceil((float(max(hills.max(), trees.max())) - LOWEST_RAD) / STEP_RAD + 0.5)
    shares = np.zeros((8, rows, COLUMNS), np.float32)
    shares[0] = 1.0
    _paint(shares, 1, hills)
    _paint(shares, 2, trees)
    rng = np.random.default_rng(320)
    for _ in range(130):
        start, width = int(rng.integers(0, COLUMNS)), int(rng.integers(1, 9))
        top = math.radians(float(rng.uniform(0.05, 0.45)))
        paint = int(rng.integers(0, len(_HANGARS)))
        part = shares[:, :, start : start + width]
        _paint(part, 3 + paint, np.full(part.shape[2], top))
    _paint(shares, 7, np.zeros(COLUMNS))
    return shares[0], shares[1:]


def _paint(shares: Floats, layer: int, tops: NDArray[np.floating]) -> None:
    """Cover everything below ``tops`` with a layer."""
    elevation = LOWEST_RAD + STEP_RAD * np.arange(shares.shape[1])[:, None]
    share = np.clip((tops[None] - elevation) / STEP_RAD + 0.5, 0, 1).astype(np.float32)
    shares *= 1 - share
    shares[layer] += share
