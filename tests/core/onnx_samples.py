"""Small ONNX networks and their descriptions, for the tests of everything about them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import yaml
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper, numpy_helper

from taxinet_ros.core.perception.network import INPUT_SHAPE, normalise

HEIGHT, WIDTH = 4, 6

DESCRIPTION: dict[str, Any] = {
    'input': {
        'layout': 'nchw', 'colour': 'grey', 'height': HEIGHT, 'width': WIDTH, 'resize': 'area',
    },
    'scaling': {'divide_by': 255},
    'outputs': [
        {'quantity': 'cte', 'unit': 'm', 'positive': 'left', 'scale': 10},
        {'quantity': 'heading_error', 'unit': 'deg', 'positive': 'left', 'scale': 30},
    ],
}


def described(changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The description with values replaced; a key is the path to it, None takes it out."""
    result = copy.deepcopy(DESCRIPTION)
    for path, value in (changes or {}).items():
        *parents, last = path.split('.')
        place: Any = result
        for parent in parents:
            place = place[int(parent)] if isinstance(place, list) else place[parent]
        if value is None:
            del place[last]
        elif isinstance(place, list):
            place[int(last)] = value
        else:
            place[last] = value
    return result


def model(
    nodes: Sequence[NodeProto], constants: Mapping[str, np.ndarray] | None = None, *,
    shape: Sequence[Any] = ('N', 1, HEIGHT, WIDTH), kind: int = TensorProto.FLOAT,
    inputs: Sequence[str] = ('picture',), outputs: Mapping[str, int] | None = None,
) -> onnx.ModelProto:
    graph = helper.make_graph(
        nodes, 'net',
        [helper.make_tensor_value_info(name, kind, shape) for name in inputs],
        [
            helper.make_tensor_value_info(name, number, None)
            for name, number in (outputs or {'answer': TensorProto.FLOAT}).items()
        ],
        [numpy_helper.from_array(value, name) for name, value in (constants or {}).items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid('', 17)], ir_version=8)


def linear(
    bias: Sequence[float] = (0.1, -0.2), *, pixels: int = HEIGHT * WIDTH, dtype: Any = np.float32,
    **more: Any,
) -> onnx.ModelProto:
    """Flatten and one dense layer, of weights that tell pixels apart."""
    weights = np.random.default_rng(3).normal(0, 0.1, (pixels, len(bias)))
    kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    return model(
        [
            helper.make_node('Flatten', ['picture'], ['flat']),
            helper.make_node('Gemm', ['flat', 'weights', 'bias'], ['answer']),
        ],
        {'weights': weights.astype(dtype), 'bias': np.array(bias, dtype)},
        kind=kind, outputs={'answer': kind}, **more,
    )


def save(
    folder: Path, network: onnx.ModelProto | bytes | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Path:
    path = folder / 'net.onnx'
    network = linear() if network is None else network
    data = network if isinstance(network, bytes) else network.SerializeToString()
    path.write_bytes(data)
    path.with_suffix('.yaml').write_text(yaml.safe_dump(described(changes)))
    return path


def our_scaling() -> dict[str, Any]:
    """Changes that give a network the size and the scaling of our own one's pictures."""
    # A level v becomes (v / 255 - mean) / std, whatever mean and deviation are at present.
    black, white = normalise(np.array([[[0, 255]]], np.uint8)).ravel().astype(float)
    std = float(1 / (white - black))
    return {
        'input.height': INPUT_SHAPE[0], 'input.width': INPUT_SHAPE[1],
        'scaling.mean': [float(-black) * std], 'scaling.std': [std],
    }


def shrunk(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame as a grey picture of our own network's size, all of it at one scale."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, INPUT_SHAPE[::-1], interpolation=cv2.INTER_AREA), np.uint8)
