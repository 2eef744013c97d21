"""Domain randomisation and augmentation of training images.

Domain randomisation is done once, when a scene is rendered: mount, lens and exposure vary. A
network trained on a single appearance of the world overfits to it; with many unrealistic ones, the
real appearance is just another variation (Tobin et al., IROS 2017). Only properties that differ
between real pictures of the same runway vary; the geometry that determines the tracking error stays
true to scale.

Augmentation changes the small grey picture slightly in every epoch, in the order of a camera's
stages: the lens blurs, the exposure scales, shifts and gamma-corrects the levels, the sensor adds
noise. Positions in the picture, and therefore the true errors, do not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import intrinsics
from taxinet_ros.core.types import AircraftState

_MOUNT_RAD = math.radians(0.4)
_MOUNT_M = 0.04


@dataclass(frozen=True, kw_only=True, slots=True)
class Variation:
    """Deviations of a picture from the standard one.

    Attributes:
        roll_rad, pitch_rad, yaw_rad, left_m, up_m: misplacement of the camera.
        zoom: factors on both focal lengths.
        gain: exposure of each channel.
        gamma: exponent on the grey levels 0..1.
        blur_px: standard deviation of the blur, 0 = none.
        noise: standard deviation of the noise in grey levels.
        seed: seed of the noise and of the patches.
        patches: number of darker patches on the picture, such as repairs, stains, other shadows.
    """

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    left_m: float
    up_m: float
    zoom: tuple[float, float]
    gain: tuple[float, float, float]
    gamma: float
    blur_px: float
    noise: float
    seed: int
    patches: int

    def misplaced(self, state: AircraftState) -> AircraftState:
        """State from which the standard camera has the view of the misplaced one at ``state``."""
        cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        return replace(
            state,
            x_m=state.x_m - sin * self.left_m,
            y_m=state.y_m + cos * self.left_m,
            z_m=state.z_m + self.up_m,
            roll_rad=state.roll_rad + self.roll_rad,
            pitch_rad=state.pitch_rad + self.pitch_rad,
            yaw_rad=state.yaw_rad + self.yaw_rad,
        )

    def develop(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Apply lens, sensor and exposure to a frame, (200, 360, 3) uint8."""
        rng = np.random.default_rng(self.seed)
        for _ in range(self.patches):
            frame = _patched(frame, rng)
        picture = self._zoomed(frame)
        if self.blur_px > 0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), self.blur_px), np.uint8)
        code = np.arange(256)[:, np.newaxis] / 255
        table = 255 * np.clip(code**self.gamma * self.gain, 0, 1)
        exposed = cv2.LUT(picture, table[np.newaxis].astype(np.float32))
        grain = rng.standard_normal(frame.shape[:2], np.float32)[:, :, np.newaxis]
        noisy = exposed + np.float32(self.noise) * grain
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def _zoomed(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        k = intrinsics()
        (x, y), (cx, cy) = self.zoom, (k[0, 2], k[1, 2])
        matrix = np.array([[x, 0, cx - x * cx], [0, y, cy - y * cy]])
        size = frame.shape[1::-1]
        zoomed = cv2.warpAffine(frame, matrix, size, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(zoomed, np.uint8)


def draw_variation(rng: np.random.Generator) -> Variation:
    """Draw a random variation."""
    roll, pitch, yaw = (float(angle) for angle in rng.normal(0, _MOUNT_RAD, 3))
    zoom_x, zoom_y = (float(zoom) for zoom in rng.uniform(0.98, 1.02, 2))
    exposure = math.exp(rng.normal(0, 0.22))
    red, green, blue = (exposure * float(cast) for cast in rng.uniform(0.92, 1.08, 3))
    return Variation(
        roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
        left_m=float(rng.normal(0, _MOUNT_M)), up_m=float(rng.normal(0, _MOUNT_M)),
        zoom=(zoom_x, zoom_y), gain=(red, green, blue), gamma=math.exp(rng.normal(0, 0.15)),
        blur_px=float(rng.uniform(0.3, 1.0)) if rng.uniform() < 0.5 else 0.0,
        noise=float(rng.uniform(0, 6)), seed=int(rng.integers(2**31)),
        patches=int(rng.integers(1, 4)) if rng.uniform() < 0.3 else 0,
    )  # fmt: skip


def _patched(frame: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The frame with a soft-edged triangle or quadrangle darkened."""
    height, width = frame.shape[:2]
    corners = rng.uniform((-0.2 * width, 0), (1.2 * width, 1.2 * height), (rng.integers(3, 5), 2))
    mask = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(corners.astype(np.int32)), (255,))
    soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 4.0)).astype(np.float32)
    factor = 1 - (1 - rng.uniform(0.35, 0.9)) / 255 * soft
    return (frame * factor[:, :, np.newaxis]).astype(np.uint8)


GAIN = (0.75, 1.35)
"""Range of the factor on the levels."""
OFFSET = (-20.0, 20.0)
"""Range of the offset added to a whole picture [grey levels]."""
GAMMA = (0.75, 1.35)
"""Range of the exponent of the level curve."""
NOISE = (0.0, 5.0)
"""Range of the standard deviation of the noise [grey levels]."""
BLUR_PX = (0.3, 1.1)
"""Range of the standard deviation of the blur [pixels of the small picture]."""
BLURRED = 0.4
"""Share of the pictures that are blurred."""
_BLUR_KERNEL = (5, 5)
_LEVELS = np.linspace(0.0, 1.0, 256, dtype=np.float32)


def augment(pictures: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Augment every picture independently.

    The same generator state gives the same pictures; the input is not modified.

    Args:
        pictures: grey pictures, (N, H, W) uint8.
        rng: generator of all random draws.

    Returns:
        As many pictures of the same shape and type.
    """
    count = len(pictures)
    gain, offset, gamma, sigma, blur_px = (
        rng.uniform(*limits, count) for limits in (GAIN, OFFSET, GAMMA, NOISE, BLUR_PX)
    )
    blurred = rng.random(count) < BLURRED
    noise = rng.standard_normal(pictures.shape, dtype=np.float32)
    changed = np.empty_like(pictures)
    for row, picture in enumerate(pictures):
        seen: NDArray[np.uint8] = picture
        if blurred[row]:
            seen = np.asarray(cv2.GaussianBlur(seen, _BLUR_KERNEL, blur_px[row]), np.uint8)
        curve = 255 * gain[row] * _LEVELS ** np.float32(gamma[row]) + offset[row]
        exposed = cv2.LUT(seen, curve.astype(np.float32))
        noise[row] *= np.float32(sigma[row])
        noise[row] += exposed
        # Half a level is added so that truncation rounds.
        changed[row] = np.clip(noise[row] + np.float32(0.5), 0, 255).astype(np.uint8)
    return changed
