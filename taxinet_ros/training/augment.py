"""Small changes to grey pictures while training: another exposure, focus and sensor each time.

Each picture goes through the stages of a camera in their order: the lens blurs, the exposure
scales and shifts the levels and bends their curve, the sensor adds noise. Where things are in the
picture stays as it is, and so do the true errors.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

GAIN = (0.75, 1.35)
"""Least and largest factor on the levels."""

OFFSET = (-20.0, 20.0)
"""Least and largest grey levels added to all of a picture."""

GAMMA = (0.75, 1.35)
"""Least and largest exponent of the level curve."""

NOISE = (0.0, 5.0)
"""Least and largest standard deviation of the noise [grey levels]."""

BLUR_PX = (0.3, 1.1)
"""Least and largest standard deviation of the blur [pixels of the small picture]."""

BLURRED = 0.4
"""Share of the pictures that are blurred."""

_BLUR_KERNEL = (5, 5)
_LEVELS = np.linspace(0.0, 1.0, 256, dtype=np.float32)


def augment(pictures: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Change every picture in its own way.

    The same generator state gives the same pictures; the arguments are not written to.

    Args:
        pictures: grey pictures, (N, H, W) uint8.
        rng: of everything drawn.

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
        # Half a level is added so that the cut to whole numbers rounds.
        changed[row] = np.clip(noise[row] + np.float32(0.5), 0, 255).astype(np.uint8)
    return changed
