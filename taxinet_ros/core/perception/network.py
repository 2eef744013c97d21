"""TaxiNet: a small convolutional network that estimates the tracking error from a camera frame.

It runs in onnxruntime on the CPU, deterministically, on one thread and without log output; torch is
used for training only. On one image, onnxruntime is three times as fast as torch, and its import
takes a tenth of the time. onnxruntime and onnx are imported lazily, by the functions that use them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.rig.camera_model import LEAST_SIDE_PX, MOST_SIDE_PX

FATAL = 4
"""Highest log severity level of onnxruntime; errors are raised as exceptions."""


def open_session(data: bytes) -> Any:
    """Open a session; on one machine equal inputs give equal outputs, in any process.

    Args:
        data: the ONNX model; weights in external files are not loaded.

    Raises:
        Exception: onnxruntime's exceptions have no other base class.
    """
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    options = onnxruntime.SessionOptions()
    options.log_severity_level = FATAL
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.add_session_config_entry('session.load_model_format', 'ONNX')
    # External data files would be searched in the working directory; os.devnull has none.
    options.add_session_config_entry(
        'session.model_external_initializers_file_folder_path', os.devnull)
    return onnxruntime.InferenceSession(
        data, options, providers=['CPUExecutionProvider'], enable_fallback=0)


IMAGE_SHAPE = (200, 360, 3)
"""Height, width and channels of the frames that networks take (RGB, uint8)."""
INPUT_SHAPE = (64, 192)
"""Height and width of the network's grey image."""
_FAR_ROWS = 40
"""Number of rows at the top of a frame (horizon to about 15 m ahead) that are not reduced."""
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
"""Mean and standard deviation of grey levels 0..1 (the usual ImageNet values)."""


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

    It runs on one thread: on one machine the same frame gives bit-identical results in any process
    and under any load.
    """

    def __init__(
        self, architecture: Architecture, weights: Mapping[str, NDArray[np.float32]]
    ) -> None:
        """Build the network; ``weights`` have the names and shapes of the architecture."""
        self._session = open_session(onnx_model(architecture, weights))

    def infer(self, pictures: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Estimate cross-track [m] and heading errors [rad], (N, 2), from images (N, 64, 192)."""
        (outputs,) = self._session.run(None, {'pictures': normalise(pictures)})
        return unscaled(outputs)

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Estimate cross-track [m] and heading error [rad] from a frame (200, 360, 3) uint8."""
        cte_m, he_rad = self.infer(shrink(image)[np.newaxis])[0]
        return float(cte_m), float(he_rad)


_OPSET = 17
_IR_VERSION = 8  # matches the operator set


def onnx_model(architecture: Architecture, weights: Mapping[str, NDArray[np.float32]]) -> bytes:
    """Build the ONNX model: ``pictures`` (N, 1, 64, 192) to ``answers`` (N, 2), float32.

    Args:
        architecture: the layers.
        weights: arrays with the names and shapes of the architecture.

    Raises:
        ValueError: a weight is missing, unknown or of another shape.
    """
    from onnx import TensorProto, helper, numpy_helper

    shapes = architecture.shapes()
    if {name: array.shape for name, array in weights.items()} != shapes:
        raise ValueError(f'network: the weights are not those of {architecture}')
    nodes, last = [], 'pictures'
    for i, kernel in enumerate(architecture.kernels):
        nodes.append(helper.make_node(
            'Conv', [last, f'conv{i}.weight', f'conv{i}.bias'], [f'conv{i}'],
            strides=[2, 2], pads=[kernel // 2] * 4,
        ))
        last = f'relu{i}'
        nodes.append(helper.make_node('Relu', [f'conv{i}'], [last]))
    nodes += [
        helper.make_node('Flatten', [last], ['features']),
        helper.make_node(
            'Gemm', ['features', 'hidden.weight', 'hidden.bias'], ['hidden'], transB=1
        ),
        helper.make_node('Relu', ['hidden'], ['units']),
        helper.make_node('Gemm', ['units', 'output.weight', 'output.bias'], ['answers'], transB=1),
    ]
    graph = helper.make_graph(
        nodes, 'taxinet',
        [helper.make_tensor_value_info('pictures', TensorProto.FLOAT, ['N', 1, *INPUT_SHAPE])],
        [helper.make_tensor_value_info('answers', TensorProto.FLOAT, ['N', 2])],
        [numpy_helper.from_array(weights[name], name) for name in shapes],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid('', _OPSET)], ir_version=_IR_VERSION
    )
    return bytes(model.SerializeToString())
