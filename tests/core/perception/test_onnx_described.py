"""``taxinet network describe``: what an ONNX network is fed with, found from its answers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from onnx import helper
from onnx_samples import model, save

import taxinet_ros as tx
from taxinet_ros.core.perception.onnx.trial import tried_network
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data.dataset import draw_scenes
from taxinet_ros.training.data.photographs import photograph
from taxinet_ros.training.network_description import description, find_ways, read_shapes

HEIGHT, WIDTH = 20, 36


@pytest.fixture(scope='module')
def pictures() -> tuple[Any, Any, Any]:
    """Scenes, small grey pictures in levels, and their cross-track and heading errors."""
    scenes = draw_scenes('training_original', seed=5, images=500)
    taken = [photograph(scene) for scene in scenes]
    small = np.array([
        cv2.resize(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), (WIDTH, HEIGHT),
                   interpolation=cv2.INTER_AREA) for frame, _ in taken
    ], np.float64)
    return scenes, small, np.array([(label.cte_m, label.he_rad) for _, label in taken])


def ridge(pictures: Any, wanted: Any) -> tuple[Any, Any]:
    """Weights and biases of the linear network that answers ``wanted``, as far as one can."""
    flat = pictures.reshape(len(pictures), -1)
    mean = flat.mean(axis=0)
    flat = flat - mean
    penalty = 3.0 * flat.var(axis=0).mean() * np.eye(flat.shape[1])
    weights = np.linalg.solve(flat.T @ flat + penalty, flat.T @ (wanted - wanted.mean(axis=0)))
    return weights, wanted.mean(axis=0) - mean @ weights


def network(folder: Path, pictures: Any, wanted: Any, shape: tuple[Any, ...]) -> Path:
    weights, bias = ridge(pictures, wanted)
    path = save(folder, model(
        [helper.make_node('Flatten', ['picture'], ['flat']),
         helper.make_node('Gemm', ['flat', 'weights', 'bias'], ['answer'])],
        {'weights': weights.astype(np.float32), 'bias': bias.astype(np.float32)}, shape=shape,
    ))
    path.with_suffix('.yaml').unlink()
    return path


def standardised(levels: Any) -> Any:
    centred = levels - levels.mean((1, 2), keepdims=True)
    return centred / np.maximum(levels.std((1, 2), keepdims=True), 1)


@pytest.mark.nightly
@pytest.mark.parametrize(('prepare', 'scaling', 'shape'), [
    (lambda levels: levels / 255, {'divide_by': 255}, ('N', 1, HEIGHT, WIDTH)),
    (standardised, {'divide_by': 1, 'per_image': 'standardise'}, (1, HEIGHT, WIDTH, 1)),
])
def test_given_a_network_then_its_scaling_layout_outputs_units_and_signs_are_found(
    tmp_path: Path, pictures: Any, prepare: Any, scaling: dict[str, Any], shape: Any
) -> None:
    scenes, small, truth = pictures
    junk = np.random.default_rng(0).normal(size=len(truth))
    # Heading in 30 degrees, positive to the right; something else; cross-track error in 10 m.
    wanted = np.column_stack([-np.degrees(truth[:, 1]) / 30, junk, truth[:, 0] / 10])
    path = network(tmp_path, prepare(small), wanted, shape)
    shapes = read_shapes(path)
    best, *others = find_ways(path, shapes, scenes[:150])
    assert best.explained > 0.6
    assert all(way.explained < best.explained + 0.01 for way in others)
    path.with_suffix('.yaml').write_text(description(best, shapes.outputs, 'found'))
    found = yaml.safe_load(path.with_suffix('.yaml').read_text())
    assert found['scaling'] == scaling
    assert found['input']['layout'] == ('nchw' if shape[1] == 1 else 'nhwc')
    heading, ignored, cte = found['outputs']
    assert (heading['quantity'], heading['unit'], heading['positive']) == (
        'heading_error', 'deg', 'right')
    assert heading['scale'] == pytest.approx(30, rel=0.1)
    assert ignored == {'quantity': 'ignore'}
    assert (cte['quantity'], cte['unit'], cte['positive']) == ('cte', 'm', 'left')
    assert cte['scale'] == pytest.approx(10, rel=0.1)
    loaded, _ = tried_network(path)
    errors = np.array([
        np.subtract(loaded.look(tx.render(scene)), answer)
        for scene, answer in zip(scenes[:40], truth[:40], strict=True)
    ])
    assert np.abs(errors).mean(axis=0)[0] < 2.0
    assert np.abs(errors).mean(axis=0)[1] < math.radians(6)


@pytest.mark.nightly
def test_given_a_network_that_answers_something_else_then_nothing_explains_it(
    tmp_path: Path, pictures: Any
) -> None:
    scenes, small, truth = pictures
    junk = np.random.default_rng(0).normal(size=truth.shape)
    path = network(tmp_path, small / 255, junk, (1, 1, HEIGHT, WIDTH))
    assert find_ways(path, read_shapes(path), scenes[:100])[0].explained < 0.4


@pytest.mark.parametrize(('shape', 'words'), [
    ((1, HEIGHT * WIDTH), 'is no picture of one or three channels; write net.yaml yourself'),
    ((1, 1, 'H', 'W'), 'is no picture of one or three channels'),
])
def test_given_an_input_that_is_no_picture_then_it_is_refused_in_one_line(
    tmp_path: Path, shape: Any, words: str
) -> None:
    scenes = draw_scenes('training_original', seed=5, images=2)
    small = np.random.default_rng(0).random((2, HEIGHT, WIDTH))
    path = network(tmp_path, small, np.zeros((2, 2)), shape)
    with pytest.raises(UsageError) as refused:
        find_ways(path, read_shapes(path), scenes)
    assert words in str(refused.value)
    (tmp_path / 'net.onnx').write_bytes(b'no model')
    with pytest.raises(UsageError, match=r'net\.onnx: is no ONNX model'):
        find_ways(path, read_shapes(path), scenes)
