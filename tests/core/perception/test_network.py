from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from network_samples import frame, random_weights

from taxinet_ros.core.perception.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    IMAGE_SHAPE,
    INPUT_SHAPE,
    TaxiNet,
    is_frame,
    normalise,
    scaled,
    shrink,
    unscaled,
)
from taxinet_ros.training.torch_network import torch_network

ARCHITECTURE = ARCHITECTURES[DEFAULT_ARCHITECTURE]


def network(seed: int = 0) -> TaxiNet:
    return TaxiNet(ARCHITECTURE, random_weights(seed))


@pytest.mark.parametrize('name', sorted(ARCHITECTURES))
def test_given_an_architecture_when_built_then_its_weights_have_the_promised_shapes(
    name: str,
) -> None:
    built = torch_network(ARCHITECTURES[name]).state_dict()
    promised = ARCHITECTURES[name].shapes()
    assert {key: tuple(value.shape) for key, value in built.items()} == promised
    assert sum(math.prod(shape) for shape in promised.values()) * 4 < 2_000_000


def test_given_a_read_only_or_strided_frame_when_looked_at_then_the_answer_is_the_same() -> None:
    subject, image = network(), frame(3)
    expected = subject.look(image)
    locked = image.copy()
    locked.flags.writeable = False
    strided = np.repeat(image, 2, axis=1)[:, ::2]
    mirrored = image[:, ::-1].copy()[:, ::-1]
    assert [subject.look(view) for view in (locked, strided, mirrored)] == [expected] * 3


SCRIPT = """
from network_samples import frame, random_weights
from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE, TaxiNet
subject = TaxiNet(ARCHITECTURES[DEFAULT_ARCHITECTURE], random_weights())
print([value.hex() for seed in range(4) for value in subject.look(frame(seed))])
"""


def test_given_another_process_with_other_threads_when_it_looks_then_bits_are_equal() -> None:
    root = Path(__file__).parents[3]
    path = os.pathsep.join([str(root), str(Path(__file__).parents[1])])
    environment = {**os.environ, 'PYTHONPATH': path, 'OMP_NUM_THREADS': '2'}
    other = subprocess.run(
        [sys.executable, '-c', SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    subject = network()
    expected = [value.hex() for seed in range(4) for value in subject.look(frame(seed))]
    assert len(expected) == 8
    assert other.stdout.strip() == str(expected)


def test_given_the_same_weights_in_torch_then_both_answer_alike() -> None:
    trained = torch_network(ARCHITECTURE)
    weights = {name: torch.from_numpy(array) for name, array in random_weights(4).items()}
    trained.load_state_dict(weights, strict=True)
    pictures = np.stack([shrink(frame(seed)) for seed in range(5)])
    with torch.inference_mode():
        expected = unscaled(trained.eval()(torch.from_numpy(normalise(pictures))).numpy())
    np.testing.assert_allclose(network(4).infer(pictures), expected, atol=1e-5)


def test_given_weights_of_another_shape_when_made_then_it_is_an_error() -> None:
    weights = random_weights(0)
    weights['output.bias'] = np.zeros(3, np.float32)
    with pytest.raises(ValueError, match='not those of'):
        TaxiNet(ARCHITECTURE, weights)


def test_given_a_batch_when_inferred_then_it_equals_one_by_one() -> None:
    subject = network()
    pictures = np.stack([shrink(frame(seed)) for seed in range(5)])
    one_by_one = [subject.look(frame(seed)) for seed in range(5)]
    np.testing.assert_array_equal(subject.infer(pictures), one_by_one)


@given(level=st.integers(0, 255))
def test_given_a_frame_of_one_shade_when_prepared_then_it_is_on_the_fixed_scale(
    level: int,
) -> None:
    picture = shrink(np.full(IMAGE_SHAPE, level, np.uint8))
    assert picture.shape == INPUT_SHAPE
    inputs = normalise(picture[np.newaxis])
    assert inputs.shape == (1, 1, *INPUT_SHAPE)
    assert inputs.dtype == np.float32
    np.testing.assert_allclose(inputs, (level / 255 - 0.449) / 0.226, atol=1e-5)


@given(seed=st.integers(0, 1000))
def test_given_a_picture_among_others_when_normalised_then_the_others_do_not_matter(
    seed: int,
) -> None:
    pictures = np.random.default_rng(seed).integers(0, 256, (3, *INPUT_SHAPE), np.uint8)
    np.testing.assert_array_equal(normalise(pictures)[1:2], normalise(pictures[1:2]))


def test_given_a_far_row_when_shrunk_then_it_keeps_its_height_and_a_near_one_does_not() -> None:
    image = np.zeros(IMAGE_SHAPE, np.uint8)
    image[10] = image[150] = 200
    picture = shrink(image)
    assert picture[10].min() == 200
    assert picture[9].max() == picture[11].max() == 0
    near = picture[40:].max(axis=1)
    assert 0 < near.max() < 60
    assert np.flatnonzero(near).tolist() == [16]  # 110 rows below the far ones, 6 2/3 to a row


def test_given_a_white_patch_top_left_when_shrunk_then_it_stays_top_left_and_grey() -> None:
    image = np.zeros(IMAGE_SHAPE, np.uint8)
    image[:50, :90] = (255, 0, 0)
    picture = shrink(image)
    assert picture[:41, :48].min() == picture.max() == 76  # red's share of luma, ITU-R BT.601
    assert picture[42:].max() == 0
    assert picture[:, 48:].max() == 0


@given(cte_m=st.floats(-50, 50), he_rad=st.floats(-3, 3))
def test_given_true_errors_when_scaled_and_back_then_they_return(
    cte_m: float, he_rad: float
) -> None:
    outputs = scaled(np.array([cte_m]), np.array([he_rad]))
    np.testing.assert_allclose(unscaled(outputs), [[cte_m, he_rad]], rtol=1e-6, atol=1e-6)


def test_given_ten_metres_and_thirty_degrees_when_scaled_then_both_outputs_are_one() -> None:
    np.testing.assert_array_equal(scaled(np.array([10.0]), np.radians([30.0])), [[1.0, 1.0]])


@pytest.mark.parametrize(
    'image',
    [
        None,
        [[0]],
        np.zeros((200, 360), np.uint8),
        np.zeros((7, 360, 3), np.uint8),
        np.zeros((200, 360, 4), np.uint8),
        np.zeros(IMAGE_SHAPE, np.float32),
        np.zeros(IMAGE_SHAPE, np.int8),
        np.zeros((1, *IMAGE_SHAPE), np.uint8),
    ],
)
def test_given_what_is_no_frame_when_asked_then_it_is_none(image: object) -> None:
    assert not is_frame(image)
    assert is_frame(np.zeros(IMAGE_SHAPE, np.uint8))
