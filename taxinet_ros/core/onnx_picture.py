"""From a camera frame to the array that a third party's network takes, as its sidecar says."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.onnx_sidecar import Brightest, Picture, Scaling, Sidecar

_COLOURS = {'bgr': cv2.COLOR_RGB2BGR, 'grey': cv2.COLOR_RGB2GRAY}
_RESIZES = {
    'area': cv2.INTER_AREA,
    'linear': cv2.INTER_LINEAR,
    'cubic': cv2.INTER_CUBIC,
    'nearest': cv2.INTER_NEAREST,
}


def prepare(image: NDArray[np.uint8], sidecar: Sidecar) -> NDArray[np.float32]:
    """The network's input of a camera frame, (200, 360, 3) uint8 RGB.

    Returns:
        Array of the shape ``sidecar.picture.shape``.
    """
    levels = _scaled(_cut_out(image, sidecar.picture), sidecar.scaling)
    if sidecar.picture.layout == 'nchw':
        levels = levels.transpose(2, 0, 1)
    return np.ascontiguousarray(levels).reshape(sidecar.picture.shape)


def _cut_out(image: NDArray[np.uint8], wanted: Picture) -> NDArray[np.float32]:
    """Colour, crop, resize in whole grey levels, reduce; (height, width, channels)."""
    picture = np.ascontiguousarray(image)
    if wanted.colour in _COLOURS:
        picture = np.asarray(cv2.cvtColor(picture, _COLOURS[wanted.colour]), np.uint8)
    left, top, right, bottom = wanted.crop
    block = wanted.brightest.block if wanted.brightest else 1
    resized = cv2.resize(
        picture[top:bottom, left:right],
        (wanted.width * block, wanted.height * block),
        interpolation=_RESIZES[wanted.resize],
    )
    levels = np.asarray(resized, np.float32).reshape(*resized.shape[:2], -1)
    return _brightest(levels, wanted.brightest) if wanted.brightest else levels


def _brightest(levels: NDArray[np.float32], reduction: Brightest) -> NDArray[np.float32]:
    """The reduction of the published TinyTaxiNet, which keeps thin bright lines."""
    block = reduction.block
    height, width, channels = levels.shape
    tiles = levels.reshape(height // block, block, width // block, block, channels)
    tiles = tiles.transpose(0, 2, 4, 1, 3)
    tiles = tiles.reshape(*tiles.shape[:3], block * block)
    kept = np.partition(tiles, -reduction.keep, axis=-1)[..., -reduction.keep:]
    return np.asarray(kept.mean(axis=-1), np.float32)


def _scaled(levels: NDArray[np.float32], scaling: Scaling) -> NDArray[np.float32]:
    """Every step of the scaling, in its order."""
    levels = levels / np.float32(scaling.divide_by)
    if scaling.per_image != 'none':
        levels -= levels.mean()
    if scaling.per_image == 'standardise':
        levels /= np.maximum(levels.std(), np.float32(1 / scaling.divide_by))
    levels -= np.asarray(scaling.mean, np.float32)
    levels /= np.asarray(scaling.std, np.float32)
    return levels if scaling.clip is None else np.asarray(levels.clip(*scaling.clip), np.float32)
