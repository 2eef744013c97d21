"""Faults of lens and sensor in an image: dirt, drops, ghosts of the sun, exposure, lost frames.

Dirt and drops are on the front lens, much closer than the camera can focus, so their edges are
blurred. Both consist of round spots drawn from a seed; with higher severity there are more spots,
and the same ones are larger: 20 % contain 10 %. A drop acts as a strong lens: it shows a small,
upside-down, blurred view of its surroundings. Ghosts are reflections between the lens elements; by
rotational symmetry they are on the line through the sun's image and the principal point. Light is
combined in linear exposure, before the display curve.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.light import Light, display_code, linear_exposure
from taxinet_ros.core.camera.texture import Floats, smooth_noise
from taxinet_ros.core.faults import begun, frame_lost
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import EXPOSURE_JUMP

_LINEAR = linear_exposure(np.minimum(np.arange(256.0), 254.5)).astype(np.float32)
"""Linear exposure by display code; for white, the least one."""
_ROOTS, _BRIGHTEST = 8192, 4.0
_CODE = np.rint(display_code(np.linspace(0, _BRIGHTEST**0.5, _ROOTS) ** 2)).astype(np.uint8)
"""Display code by the square root of the linear exposure, which spaces codes nearly evenly."""

_DIRT_SPOTS, _DROP_SPOTS = 260, 90
_DIRT_RADIUS_RAD, _DROP_RADIUS_RAD = 0.030, 0.055
"""Median radius of a spot, if all of the lens were covered."""
_FARTHEST = 3.0
"""Maximum distance covered by a spot, in its radii."""
_DIRT_BLUR_RAD, _DROP_BLUR_RAD = 0.007, 0.011
_DIRT_COLOUR = np.array([0.155, 0.115, 0.075], np.float32)
"""Share of the scene's light that dirt scatters into the camera, RGB."""
_DIRT_OPACITY = 0.88
_DROP_OPACITY = 0.92
_DROP_VIEW = 1.6
"""Width of the scene shown by a drop, in widths of the drop."""
_DROP_SCENE_BLUR_PX = 3.0
_DROP_SKY = 0.30
"""Share of the ground's light added at a drop's lower edge, where it shows the sky."""
_GHOSTS = (
    # Place along the line from the principal point (0) to the sun's image (1), radius [rad], share.
    (-0.16, 0.022, 0.90, (0.55, 1.0, 0.80)),
    (-0.33, 0.060, 0.45, (0.80, 0.75, 1.0)),
    (-0.52, 0.036, 0.75, (1.0, 0.80, 0.55)),
    (-0.80, 0.120, 0.35, (0.75, 1.0, 0.85)),
    (0.20, 0.032, 0.65, (1.0, 0.90, 0.60)),
    (0.38, 0.075, 0.40, (0.95, 0.75, 0.90)),
)
_GHOST_EDGE = 1.12
"""Outer edge of a ghost, in its radii; it fades from 1 to there."""
_VEIL = 0.12
"""Uniform light from ghosts of higher order, as a share."""
_FARTHEST_SUN_RAD = math.radians(70.0)
"""Maximum angle between sun and optical axis; beyond it, the lens hood shades the lens."""


class LensFaults:
    """Faults of lens and sensor of one scenario's camera.

    Attributes:
        any: whether there are any.
    """

    def __init__(
        self, scenario: Scenario, light: Light, intrinsics: NDArray[np.float64],
        size: tuple[int, int],
    ) -> None:
        """Draw the spots.

        Args:
            scenario: with the faults.
            light: of the scenario.
            intrinsics: camera matrix (3, 3).
            size: height and width of the picture [px].
        """
        self._scenario, self._light, self._intrinsics, self._size = (
            scenario, light, intrinsics, size
        )
        focal = float(intrinsics[0, 0]), float(intrinsics[1, 1])
        seed = int(scenario.fault_seed)
        self._dirt = self._drops = None
        if scenario.lens_dirt_fraction:
            self._dirt = _dirt(seed, scenario.lens_dirt_fraction, size, focal)
        if scenario.lens_drops_fraction:
            self._drops = _drops(seed, scenario.lens_drops_fraction, size, focal)
        beam = float(light.direct.max()) / float(light.total.max())
        self._ghost = scenario.glare_ghost_fraction * beam
        self._shines = self._ghost > 0 and light.sun_elevation_rad > 0
        self._covered = self._dirt is not None or self._drops is not None or self._shines
        self.any = (
            self._covered or scenario.ever(EXPOSURE_JUMP) or scenario.camera_dropout_fraction > 0
        )

    def apply(
        self, picture: NDArray[np.uint8], to_optical: NDArray[np.float64], stamp_ns: int
    ) -> NDArray[np.uint8]:
        """The picture as the faults leave it.

        Args:
            picture: (H, W, 3) uint8 RGB.
            to_optical: rotation from ``map`` to the camera's optical frame (3, 3).
            stamp_ns: simulated time since the start of the run [ns].
        """
        if frame_lost(self._scenario, stamp_ns):
            return np.zeros_like(picture)
        gain = 2.0**self._scenario.at(EXPOSURE_JUMP, stamp_ns)
        if not ((self._covered or gain != 1.0) and begun(self._scenario, stamp_ns)):
            return picture
        linear: Floats = _LINEAR[picture]
        if self._drops is not None:
            linear = self._refracted(linear, *self._drops)
        if self._dirt is not None:
            scattered = _DIRT_COLOUR * self._light.total.astype(np.float32)
            linear += self._dirt * (scattered - linear)
        if self._shines:
            self._add_ghosts(linear, to_optical)
        linear *= np.float32(gain / _BRIGHTEST)
        roots = np.sqrt(np.clip(linear, 0, 1)) * np.float32(_ROOTS - 1)
        return _CODE[np.rint(roots).astype(np.uint16)]

    def _refracted(
        self, linear: Floats, share: Floats, columns: Floats, rows: Floats, sky: Floats
    ) -> Floats:
        shown = cv2.remap(
            linear, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
        )
        shown = cv2.GaussianBlur(
            shown + sky * self._light.total.astype(np.float32), (0, 0), _DROP_SCENE_BLUR_PX
        )
        return np.asarray(linear + share * (shown - linear), np.float32)

    def _add_ghosts(self, linear: Floats, to_optical: NDArray[np.float64]) -> None:
        x, y, z = to_optical @ self._light.sun
        away_rad = math.acos(min(max(float(z), -1.0), 1.0))
        if away_rad >= _FARTHEST_SUN_RAD:
            return
        strength = self._ghost * math.cos(away_rad / _FARTHEST_SUN_RAD * math.pi / 2)
        linear += np.float32(_VEIL * strength)
        height, width = self._size
        # Directions (right, down) of columns and rows, as tangents.
        right = (np.arange(width) - self._intrinsics[0, 2]) / self._intrinsics[0, 0]
        down = (np.arange(height) - self._intrinsics[1, 2]) / self._intrinsics[1, 1]
        for place, radius, share, tint in _GHOSTS:
            beside, below = right - place * x / z, down - place * y / z
            columns, rows = (_within(way, _GHOST_EDGE * radius) for way in (beside, below))
            away = np.hypot(beside[columns], below[rows, None]) / radius
            disc = np.clip((_GHOST_EDGE - away) / (_GHOST_EDGE - 1), 0, 1) * (0.6 + 0.4 * away**2)
            light = strength * share * disc[:, :, None] * np.array(tint)
            linear[rows, columns] += light.astype(np.float32)


@lru_cache(maxsize=4)
def _spots(
    seed: int, count: int, radius_rad: float, size: tuple[int, int], focal: tuple[float, float]
) -> tuple[Floats, NDArray[np.int32], Floats]:
    """Draw spots that appear one by one and grow as a threshold t decreases.

    Spot i covers the pixels within its radius times (its rank - t) of its centre.

    Returns:
        The greatest t at which each pixel is covered, (H, W); number of the spot that covers it
        there, (H, W); column, row, radius [rad] and rank of the spots, (N, 4).
    """
    height, width = size
    draws = np.random.default_rng([seed, count])
    spots = np.empty((count, 4), np.float32)
    spots[:, 0] = draws.uniform(-0.05 * width, 1.05 * width, count)
    spots[:, 1] = draws.uniform(-0.05 * height, 1.05 * height, count)
    spots[:, 2] = radius_rad * np.exp(draws.normal(0.0, 0.5, count))
    spots[:, 3] = draws.uniform(0.0, 1.0, count)
    best = np.full(size, -_FARTHEST, np.float32)
    which = np.zeros(size, np.int32)
    for number, (column, row, radius, rank) in enumerate(spots):
        beside = (np.arange(width, dtype=np.float32) - column) / (focal[0] * radius)
        below = (np.arange(height, dtype=np.float32) - row) / (focal[1] * radius)
        part = _within(below, _FARTHEST), _within(beside, _FARTHEST)
        early = rank - np.hypot(beside[part[1]], below[part[0], None])
        nearer = early > best[part]
        best[part][nearer] = early[nearer]
        which[part][nearer] = number
    return best, which, spots


def _within(places: NDArray[np.floating], limit: float) -> slice:
    """Slice of the ascending numbers whose absolute value is within a limit."""
    first, last = np.searchsorted(places, (-limit, limit))
    return slice(int(first), int(last))


def _dirt(
    seed: int, share: float, size: tuple[int, int], focal: tuple[float, float]
) -> Floats:
    """Opacity of the dirt by pixel, (H, W, 1)."""
    best, which, spots = _spots(seed, _DIRT_SPOTS, _DIRT_RADIUS_RAD, size, focal)
    ragged = smooth_noise(seed, size, (5.0, 4.0)) + 0.6 * smooth_noise(seed + 1, size, (2.5, 2.0))
    early = best + np.float32(0.10) * ragged
    mask = (early >= np.quantile(early, 1.0 - share)).astype(np.float32)
    # Some spots are thick, some thin.
    thickness = 0.55 + 0.45 * np.modf(spots[:, 3] * np.float32(97.0))[0]
    opacity = cv2.GaussianBlur(
        mask * thickness[which].astype(np.float32), (0, 0), sigmaX=_DIRT_BLUR_RAD * focal[0] / 2,
        sigmaY=_DIRT_BLUR_RAD * focal[1] / 2,
    )
    return np.asarray(_DIRT_OPACITY * opacity, np.float32)[:, :, None]


def _drops(
    seed: int, share: float, size: tuple[int, int], focal: tuple[float, float]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Opacity of the drops (H, W, 1), columns and rows they show (H, W), and sky (H, W, 1)."""
    best, which, spots = _spots(seed, _DROP_SPOTS, _DROP_RADIUS_RAD, size, focal)
    down_to = np.quantile(best, 1.0 - share)
    opacity = cv2.GaussianBlur(
        (best >= down_to).astype(np.float32), (0, 0), sigmaX=_DROP_BLUR_RAD * focal[0] / 2,
        sigmaY=_DROP_BLUR_RAD * focal[1] / 2,
    )
    rows, columns = np.indices(size, np.float32)
    centre_column, centre_row, radius, rank = np.moveaxis(spots[which], 2, 0)
    right, down = columns - centre_column, rows - centre_row
    edge = np.maximum(radius * (rank - down_to) * np.float32(focal[1]), 1.0)
    sky = np.clip(down / edge, 0, 1) ** 2
    return (
        np.asarray(_DROP_OPACITY * opacity, np.float32)[:, :, None],
        (centre_column - _DROP_VIEW * right).astype(np.float32),
        (centre_row - _DROP_VIEW * down).astype(np.float32),
        np.asarray(_DROP_SKY * sky, np.float32)[:, :, None],
    )
