"""The network's answers are those of additions in one written order, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from network_samples import random_weights

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.perception.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    INPUT_SHAPE,
    TaxiNet,
    normalise,
    unscaled,
)

ARCHITECTURE = ARCHITECTURES[DEFAULT_ARCHITECTURE]
Floats = np.ndarray


def convolved(
    picture: Floats, weights: Floats, biases: Floats, *, stride: int, padding: int, rectified: bool
) -> Floats:
    """The slow twin: (height, width, channels), one rounded product after the other."""
    rows, columns, inputs, outputs = weights.shape
    edge = ((padding, padding), (padding, padding), (0, 0))
    wide = np.pad(picture, edge)
    height = (wide.shape[0] - rows) // stride + 1
    width = (wide.shape[1] - columns) // stride + 1
    sums = np.broadcast_to(biases, (height, width, outputs)).astype(np.float32)
    for v in range(rows):
        for u in range(columns):
            for channel in range(inputs):
                seen = wide[v : v + stride * height : stride, u : u + stride * width : stride,
                            channel]
                product = seen[:, :, None] * weights[v, u, channel]
                sums = sums + product
    assert sums.dtype == np.float32
    return np.where(sums < 0, np.float32(0), sums) if rectified else sums


def answers(weights: dict[str, Floats], pictures: np.ndarray) -> Floats:
    """Of the whole network, layer by layer."""
    found = []
    for picture in normalise(pictures):
        plane = picture.transpose(1, 2, 0)
        for i, kernel in enumerate(ARCHITECTURE.kernels):
            plane = convolved(
                plane, weights[f'conv{i}.weight'].transpose(2, 3, 1, 0), weights[f'conv{i}.bias'],
                stride=2, padding=kernel // 2, rectified=True,
            )
        hidden = weights['hidden.weight'].reshape(-1, plane.shape[2], *plane.shape[:2])
        plane = convolved(
            plane, hidden.transpose(2, 3, 1, 0), weights['hidden.bias'],
            stride=1, padding=0, rectified=True,
        )
        plane = convolved(
            plane, weights['output.weight'].T[None, None], weights['output.bias'],
            stride=1, padding=0, rectified=False,
        )
        found.append(plane.ravel())
    return unscaled(np.stack(found))


def test_given_the_network_then_its_answers_are_the_slow_twins_to_the_bit() -> None:
    weights = random_weights(3)
    pictures = np.random.default_rng(8).integers(0, 256, (2, *INPUT_SHAPE), np.uint8)
    found = TaxiNet(ARCHITECTURE, weights).infer(pictures)
    assert found.shape == (2, 2)
    assert np.ptp(found, axis=0).min() > 0
    np.testing.assert_array_equal(found, answers(weights, pictures))


def test_given_odd_sizes_strides_and_channels_then_a_layer_is_its_slow_twin_to_the_bit() -> None:
    draws = np.random.default_rng(5)
    shapes = [((3, 5, 2, 17), 2, 1), ((1, 3, 17, 33), 3, 0), ((2, 2, 33, 5), 1, 1)]
    picture = draws.standard_normal((1, 9, 41, 2), np.float32)
    layers, expected = [], picture[0]
    for shape, stride, padding in shapes:
        weights = draws.standard_normal(shape, np.float32)
        biases = draws.standard_normal(shape[-1], np.float32)
        kind = {'stride': stride, 'padding': padding, 'rectified': stride > 1}
        layers.append(pixels.Convolution(weights, biases, **kind))
        expected = convolved(expected, weights, biases, **kind)
    last = draws.standard_normal((*expected.shape, 3), np.float32)
    kind = {'stride': 1, 'padding': 0, 'rectified': False}
    layers.append(pixels.Convolution(last, np.zeros(3, np.float32), **kind))
    expected = convolved(expected, last, np.zeros(3, np.float32), **kind)
    network = pixels.Network(9, 41, layers)
    np.testing.assert_array_equal(network.infer(picture), expected.reshape(1, 3))


def of_zeros_and(draws: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Numbers of both signs; half of them are zeros, of both signs too."""
    numbers = draws.standard_normal(shape, np.float32)
    return numbers * draws.integers(0, 2, shape).astype(np.float32)


@pytest.mark.parametrize('hole', [None, np.nan])
def test_given_zeros_then_leaving_them_out_is_the_slow_twin_to_the_bit(
    hole: float | None
) -> None:
    draws = np.random.default_rng(7)
    # From 16 channels on, and of as many blocks as one, two, several and too many at a time.
    shapes = [((1, 1, 16, 32), 1, 1), ((3, 5, 32, 96), 2, 2), ((2, 3, 96, 112), 1, 0),
              ((3, 3, 112, 16), 2, 1), ((1, 2, 16, 208), 1, 0)]
    picture = of_zeros_and(draws, (1, 9, 41, 16))
    layers, expected = [], picture[0]
    for shape, stride, padding in shapes:
        weights = draws.standard_normal(shape, np.float32)
        if hole is not None and shape[3] == 96:
            weights[0, 0, 3, 5] = hole
        biases = of_zeros_and(draws, shape[3:])
        kind = {'stride': stride, 'padding': padding, 'rectified': stride > 1}
        layers.append(pixels.Convolution(weights, biases, **kind))
        expected = convolved(expected, weights, biases, **kind)
    last = draws.standard_normal((*expected.shape, 16), np.float32)
    kind = {'stride': 1, 'padding': 0, 'rectified': False}
    layers.append(pixels.Convolution(last, np.zeros(16, np.float32), **kind))
    expected = convolved(expected, last, np.zeros(16, np.float32), **kind)
    assert np.isfinite(expected).all() == (hole is None)
    network = pixels.Network(9, 41, layers)
    for _ in range(2):  # the second time in planes that are used
        np.testing.assert_array_equal(network.infer(picture), expected.reshape(1, 16))


def test_given_numbers_that_overflow_then_the_answer_is_not_finite() -> None:
    weights = random_weights(3)
    weights['hidden.bias'][:] = np.nan
    pictures = np.zeros((1, *INPUT_SHAPE), np.uint8)
    assert np.isnan(TaxiNet(ARCHITECTURE, weights).infer(pictures)).all()


def layer(*shape: int, stride: int = 1, padding: int = 0) -> pixels.Convolution:
    return pixels.Convolution(
        np.zeros(shape, np.float32), np.zeros(shape[-1], np.float32),
        stride=stride, padding=padding, rectified=False,
    )


@pytest.mark.parametrize(('layers', 'words'), [
    ([], 'layers'),
    ([(6, 6, 1, 4), (1, 1, 2, 1)], 'takes what'),
    ([(9, 3, 1, 4)], 'fits'),
    ([(3, 3, 1, 4)], 'one number'),
])
def test_given_layers_that_do_not_fit_then_it_is_an_error(
    layers: list[tuple[int, ...]], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        pixels.Network(6, 6, [layer(*shape) for shape in layers])


def test_given_arrays_of_another_kind_then_it_is_an_error() -> None:
    weights = np.zeros((1, 1, 1, 1), np.float32)
    with pytest.raises(TypeError):
        pixels.Convolution(weights.astype(float), weights[0, 0, 0], stride=1, padding=0,
                           rectified=False)
    with pytest.raises(ValueError, match='stride'):
        layer(1, 1, 1, 1, stride=0)
    with pytest.raises(ValueError, match='biases'):
        pixels.Convolution(weights, np.zeros(2, np.float32), stride=1, padding=0, rectified=False)
    network = pixels.Network(1, 1, [layer(1, 1, 1, 1)])
    with pytest.raises(ValueError, match='pictures'):
        network.infer(np.zeros((1, 2, 2, 1), np.float32))
    with pytest.raises(TypeError):
        network.infer(np.zeros((1, 1, 1, 1)))
