"""TaxiNet: a small convolutional network that estimates the tracking error from a camera frame.

Inference is compiled code of this package (``core/camera/native/network.cpp``), which rounds
identically on every processor; torch is used for training only.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.rig.camera_model import LEAST_SIDE_PX, MOST_SIDE_PX

IMAGE_SHAPE = (200, 360, 3)
"""Height, width and channels of the frames that networks take (RGB, uint8)."""
INPUT_SHAPE = (64, 192)
"""Height and width of the network's grey image."""
FAR_ROWS = 40
"""Number of rows at the top of a frame (horizon to about 15 m ahead) that are not reduced."""
_REDUCTION = pixels.Reduction(
    *IMAGE_SHAPE[:2],
    [(FAR_ROWS, FAR_ROWS), (IMAGE_SHAPE[0] - FAR_ROWS, INPUT_SHAPE[0] - FAR_ROWS)],
    INPUT_SHAPE[1],
)
CTE_SCALE_M = 10.0
"""Cross-track error [m] at an output of 1."""
HE_SCALE_RAD = math.radians(30.0)
"""Heading error [rad] at an output of 1."""
_SCALES = np.array([CTE_SCALE_M, HE_SCALE_RAD])
_MEAN, _DEVIATION = 0.449, 0.226
"""Mean and standard deviation of grey levels 0..1 (the usual ImageNet values)."""
UNSEEN = round(255 * _MEAN)
"""Grey level of pixels that a camera does not see: about 0 to the network, as padding is."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Architecture:
    """Convolutions of stride 2 with ReLU, then one hidden layer, then the two outputs.

    Attributes:
        channels: output channels of each convolution.
        kernels: kernel size of each convolution, odd; the padding is half of it.
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
        height, width = self.last_size()
        shapes['hidden.weight'] = (self.hidden, self.channels[-1] * height * width)
        shapes['hidden.bias'] = (self.hidden,)
        shapes['output.weight'] = (2, self.hidden)
        shapes['output.bias'] = (2,)
        return shapes

    def last_size(self) -> tuple[int, int]:
        """Height and width after the last convolution."""
        height, width = (side >> len(self.channels) for side in INPUT_SHAPE)
        return height, width


ARCHITECTURES = {
    'cnn5-64x192': Architecture(
        channels=(16, 32, 64, 96, 96), kernels=(5, 3, 3, 3, 3), hidden=64
    ),
    'cnn5w-64x192': Architecture(
        channels=(16, 32, 64, 128, 160), kernels=(5, 3, 3, 3, 3), hidden=96
    ),
}
"""Architectures by their name in model cards."""
DEFAULT_ARCHITECTURE = 'cnn5-64x192'


def is_frame(image: object) -> bool:
    """Whether ``image`` is a camera's frame: an array (height, width, 3) of uint8."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3:
        return False
    height, width, channels = image.shape
    return channels == 3 and all(LEAST_SIDE_PX <= side <= MOST_SIDE_PX for side in (height, width))


def usual_frame(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Resize a frame (height, width, 3) of any camera for networks, to (200, 360, 3).

    Pixels are averaged over areas; the aspect ratio is not kept.
    """
    if image.shape == IMAGE_SHAPE:
        return image
    import cv2

    size = IMAGE_SHAPE[1], IMAGE_SHAPE[0]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


PICTURE_FORMATS = 'PNG', 'JPEG', 'BMP', 'TIFF', 'WEBP'
_EIGHT_BIT = '1', 'L', 'LA', 'P', 'PA', 'RGB', 'RGBA', 'CMYK', 'YCbCr'
_MOST_PIXELS = 64_000_000


def decode_picture(data: bytes) -> NDArray[np.uint8]:
    """Pixels (height, width, 3) uint8 RGB of a file of one of :data:`PICTURE_FORMATS`.

    Raises:
        ValueError: it is none, is damaged or too large, or has not 8 bits a channel; in one line.
    """
    from PIL import Image  # unlike OpenCV, it prints no messages

    try:
        with Image.open(io.BytesIO(data), formats=PICTURE_FORMATS) as image:
            fits = image.width * image.height <= _MOST_PIXELS
            if fits and image.mode in _EIGHT_BIT:
                return np.asarray(image.convert('RGB'), np.uint8)
            found = f'{image.width}x{image.height} {image.mode}'
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ValueError(f'cannot be read as a picture ({"/".join(PICTURE_FORMATS)})') from error
    raise ValueError(f'is {found}; expected 8 bits a channel and fewer pixels')


def shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reduce a camera frame, (height, width, 3) uint8 RGB, to the grey image (64, 192) uint8.

    A metre covers one or two pixels far ahead and hundreds near the wheels. So the top rows of the
    frame are kept, and the others are averaged into the remaining rows.
    """
    return _REDUCTION.reduce(np.ascontiguousarray(usual_frame(image)))


def normalise(pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Scale grey images, (N, 64, 192) uint8, to about mean 0 and deviation 1 in daylight.

    The scale is fixed, as in the open TaxiNet studies: dark images stay dark.

    Returns:
        The network's input, (N, 1, 64, 192) float32.
    """
    levels = pictures.astype(np.float32)[:, np.newaxis]
    levels *= np.float32(1 / (255 * _DEVIATION))
    levels -= np.float32(_MEAN / _DEVIATION)
    return levels


def scaled(cte_m: NDArray[np.float64], he_rad: NDArray[np.float64]) -> NDArray[np.float32]:
    """Target outputs of the network, (N, 2) float32, for true errors [m] and [rad]."""
    return np.stack([cte_m / CTE_SCALE_M, he_rad / HE_SCALE_RAD], axis=1).astype(np.float32)


def unscaled(outputs: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cross-track [m] and heading errors [rad], (N, 2), from network outputs (N, 2)."""
    errors: NDArray[np.float64] = outputs.astype(np.float64) * _SCALES
    return errors


class TaxiNet:
    """A network ready for inference.

    The same frame gives bit-identical results on every processor, in any process and under any
    load: compiled code adds the products of each output one by one, in a fixed order.
    """

    def __init__(
        self, architecture: Architecture, weights: Mapping[str, NDArray[np.float32]]
    ) -> None:
        """Build the network; ``weights`` have the names and shapes of the architecture.

        Raises:
            ValueError: a weight is missing, unknown or of another shape.
        """
        if {name: array.shape for name, array in weights.items()} != architecture.shapes():
            raise ValueError(f'network: the weights are not those of {architecture}')
        self._network = pixels.Network(*INPUT_SHAPE, _layers(architecture, weights))

    def infer(self, pictures: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Estimate cross-track [m] and heading errors [rad], (N, 2), from images (N, 64, 192)."""
        inputs = normalise(pictures).reshape(-1, *INPUT_SHAPE, 1)
        return unscaled(self._network.infer(inputs))

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Estimate cross-track [m] and heading error [rad] from a frame (200, 360, 3) uint8.

        Or from the picture of an eye, (64, 192) uint8.
        """
        picture = image if image.ndim == 2 else shrink(image)
        cte_m, he_rad = self.infer(picture[np.newaxis])[0]
        return float(cte_m), float(he_rad)


def _layers(
    architecture: Architecture, weights: Mapping[str, NDArray[np.float32]]
) -> list[pixels.Convolution]:
    """All layers as convolutions; a dense one has a kernel as large as its input."""
    channels, (height, width) = architecture.channels[-1], architecture.last_size()
    dense = {
        'hidden': weights['hidden.weight'].reshape(-1, channels, height, width),
        'output': weights['output.weight'][:, :, np.newaxis, np.newaxis],
    }

    def layer(
        name: str, kernels: NDArray[np.float32], stride: int, padding: int, rectified: bool = True
    ) -> pixels.Convolution:
        return pixels.Convolution(
            np.ascontiguousarray(kernels.transpose(2, 3, 1, 0), np.float32),
            weights[f'{name}.bias'].astype(np.float32),
            stride=stride, padding=padding, rectified=rectified,
        )

    return [
        *(layer(f'conv{i}', weights[f'conv{i}.weight'], 2, kernel // 2)
          for i, kernel in enumerate(architecture.kernels)),
        layer('hidden', dense['hidden'], 1, 0),
        layer('output', dense['output'], 1, 0, rectified=False),
    ]
