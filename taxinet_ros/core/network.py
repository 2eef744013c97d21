"""TaxiNet: a small convolutional network that reads the tracking error off a camera frame.

The paper's own network is unpublished. This one follows the open TaxiNet studies in its outputs,
cross-track error over 10 m and heading error over 30 degrees, and in its reduced grey input.

It is trained with torch and run by onnxruntime.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core import pixels
from taxinet_ros.core.onnx_session import open_session

IMAGE_SHAPE = (200, 360, 3)
"""Height, width and channels of a camera frame (RGB, uint8)."""

INPUT_SHAPE = (64, 192)
"""Height and width of the network's grey picture."""

_FAR_ROWS = 40
"""Rows of a frame from the top, from the horizon to some 15 m ahead, that keep their height."""

_REDUCTION = pixels.Reduction(
    *IMAGE_SHAPE[:2],
    [(_FAR_ROWS, _FAR_ROWS), (IMAGE_SHAPE[0] - _FAR_ROWS, INPUT_SHAPE[0] - _FAR_ROWS)],
    INPUT_SHAPE[1],
)

CTE_SCALE_M = 10.0
"""Cross-track error [m] at an output of 1."""

HE_SCALE_RAD = math.radians(30.0)
"""Heading error [rad] at an output of 1."""

_SCALES = np.array([CTE_SCALE_M, HE_SCALE_RAD])

_MEAN, _DEVIATION = 0.449, 0.226
"""Of grey levels 0..1: the customary ones, of ImageNet's pictures."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Architecture:
    """Convolutions of stride 2 with ReLU, then one hidden layer, then the two outputs.

    Attributes:
        channels: output channels of each convolution.
        kernels: kernel size of each convolution, odd; the padding keeps the borders in view.
        hidden: units of the hidden layer.
    """

    channels: tuple[int, ...]
    kernels: tuple[int, ...]
    hidden: int

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every weight by its name, in the order of the layers."""
        shapes: dict[str, tuple[int, ...]] = {}
        before = (1, *self.channels)
        for i, (channels, kernel) in enumerate(zip(self.channels, self.kernels, strict=True)):
            shapes[f'conv{i}.weight'] = (channels, before[i], kernel, kernel)
            shapes[f'conv{i}.bias'] = (channels,)
        height, width = (side >> len(self.channels) for side in INPUT_SHAPE)
        shapes['hidden.weight'] = (self.hidden, self.channels[-1] * height * width)
        shapes['hidden.bias'] = (self.hidden,)
        shapes['output.weight'] = (2, self.hidden)
        shapes['output.bias'] = (2,)
        return shapes


ARCHITECTURES = {
    'cnn5-64x192': Architecture(
        channels=(16, 32, 64, 96, 96), kernels=(5, 3, 3, 3, 3), hidden=64
    ),
}
"""Architectures by the word that a model card names them with."""

DEFAULT_ARCHITECTURE = 'cnn5-64x192'


def is_frame(image: object) -> bool:
    """Whether ``image`` is a camera frame: an array (200, 360, 3) of uint8."""
    if not isinstance(image, np.ndarray):
        return False
    return bool(image.shape == IMAGE_SHAPE and image.dtype == np.uint8)


def shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reduce a camera frame, (200, 360, 3) uint8 RGB, to the grey picture (64, 192) uint8.

    Far ahead a metre is a pixel or two, at the wheels hundreds; so the top of the frame keeps its
    rows, and the rest is pressed into the remaining ones.
    """
    return _REDUCTION.reduce(np.ascontiguousarray(image))


def normalise(pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Bring grey pictures, (N, 64, 192) uint8, to about mean 0 and deviation 1 in daylight.

    The scale is fixed, as in the open TaxiNet studies: a dark picture stays dark, and whether that
    matters is the network's business.

    Returns:
        The network's input, (N, 1, 64, 128) float32.
    """
    levels = pictures.astype(np.float32)[:, np.newaxis]
    levels *= np.float32(1 / (255 * _DEVIATION))
    levels -= np.float32(_MEAN / _DEVIATION)
    return levels


def scaled(cte_m: NDArray[np.float64], he_rad: NDArray[np.float64]) -> NDArray[np.float32]:
    """What the network should answer, (N, 2) float32, for true errors [m] and [rad]."""
    return np.stack([cte_m / CTE_SCALE_M, he_rad / HE_SCALE_RAD], axis=1).astype(np.float32)


def unscaled(outputs: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cross-track [m] and heading errors [rad], (N, 2), that outputs (N, 2) stand for."""
    errors: NDArray[np.float64] = outputs.astype(np.float64) * _SCALES
    return errors


class TaxiNet:
    """A network ready to look.

    It runs on one thread: on one machine the same frame gives the same answer to the bit, in any
    process, however busy the machine is.
    """

    def __init__(
        self, architecture: Architecture, weights: Mapping[str, NDArray[np.float32]]
    ) -> None:
        """Build the network with ``weights``, of the names and shapes it asks for."""
        from taxinet_ros.core.network_model import onnx_model

        self._session = open_session(onnx_model(architecture, weights))

    def infer(self, pictures: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Cross-track [m] and heading errors [rad], (N, 2), seen on grey pictures (N, 64, 192)."""
        (outputs,) = self._session.run(None, {'pictures': normalise(pictures)})
        return unscaled(outputs)

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Cross-track [m] and heading error [rad] seen on a camera frame (200, 360, 3) uint8."""
        cte_m, he_rad = self.infer(shrink(image)[np.newaxis])[0]
        return float(cte_m), float(he_rad)
