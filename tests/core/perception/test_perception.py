from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from network_samples import frame, random_weights, save_sample
from onnx_samples import save

from taxinet_ros import testing
from taxinet_ros.core.perception.network import CTE_SCALE_M, HE_SCALE_RAD
from taxinet_ros.core.perception.perception import (
    Perception,
    check_perception,
    make_perception,
    perception_names,
)
from taxinet_ros.core.perception.weights import SHIPPED, digest
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.errors import UsageError

TRUTH = TrackingError(cte_m=-1.5, he_rad=0.2)


@pytest.fixture(params=[*perception_names(), 'weights', 'onnx'])
def perception(request: pytest.FixtureRequest, tmp_path: Path) -> Perception:
    """Every perception there is; tests/test_testing.py runs the contract kit over those named."""
    files = {'weights': save_sample, 'onnx': save}
    if request.param in files:
        return make_perception(str(files[request.param](tmp_path)))
    return make_perception(request.param)


@pytest.mark.parametrize('make', [
    pytest.param(save_sample, marks=pytest.mark.nightly), save,
], ids=['weights', 'onnx'])
def test_given_a_network_in_a_file_when_checked_by_the_contract_kit_then_it_passes(
    make, tmp_path: Path
) -> None:
    testing.check_perception(str(make(tmp_path)))


def test_given_any_perception_when_described_then_word_fingerprint_and_need_agree(
    perception: Perception,
) -> None:
    assert perception.word in (*perception_names(), 'weights', 'onnx')
    assert perception.needs_image == (perception.word != 'truth')
    assert len(perception.fingerprint) == (64 if perception.needs_image else 0)


def test_given_the_truth_when_asked_then_it_is_passed_on() -> None:
    truth = make_perception('truth')
    assert truth.estimate(None, TRUTH) == TRUTH
    assert truth.estimate(frame(), None) == NO_ESTIMATE


def test_given_the_network_when_the_truth_changes_then_its_estimate_does_not() -> None:
    network = make_perception('taxinet')
    seen = network.estimate(frame(), None)
    assert network.estimate(frame(), TRUTH) == seen
    assert seen != TRUTH


@pytest.mark.parametrize(
    'image', [np.zeros((240, 430, 4), np.uint8), np.zeros((200, 360, 3)), np.zeros(0, np.uint8)]
)
def test_given_the_network_when_the_frame_is_of_wrong_shape_or_type_then_invalid(
    image: np.ndarray, tmp_path: Path
) -> None:
    network = make_perception(str(save_sample(tmp_path)))
    assert network.estimate(image, TRUTH) == NO_ESTIMATE


def test_given_a_frame_of_another_size_when_asked_then_it_is_brought_to_the_usual_one(
    tmp_path: Path,
) -> None:
    network = make_perception(str(save_sample(tmp_path)))
    large = np.random.default_rng(5).integers(0, 256, (400, 640, 3), np.uint8)
    usual = np.asarray(cv2.resize(large, (360, 200), interpolation=cv2.INTER_AREA), np.uint8)
    seen = network.estimate(large, None)
    assert seen == network.estimate(usual, None) != NO_ESTIMATE


@pytest.mark.parametrize('bias', [(3e38, 0.5), (0.5, -3e38)])
def test_given_finite_weights_that_overflow_when_asked_then_the_estimate_is_invalid(
    bias: tuple[float, float], tmp_path: Path
) -> None:
    weights = random_weights()
    weights['hidden.bias'][:] = 3e38
    weights['output.weight'][:] = np.sign(bias)[:, np.newaxis] * (np.abs(bias) > 1)[:, np.newaxis]
    weights['output.bias'][:] = 0.5
    network = make_perception(str(save_sample(tmp_path, weights)))
    assert network.estimate(frame(), TRUTH) == NO_ESTIMATE


def test_given_weights_that_always_say_one_when_asked_then_ten_metres_and_thirty_degrees(
    tmp_path: Path,
) -> None:
    weights = random_weights()
    weights['output.weight'][:] = 0
    weights['output.bias'][:] = (1, -1)
    network = make_perception(str(save_sample(tmp_path, weights)))
    estimate = network.estimate(frame(), None)
    assert estimate == TrackingError(cte_m=CTE_SCALE_M, he_rad=-HE_SCALE_RAD)
    assert math.isclose(math.degrees(HE_SCALE_RAD), 30.0)


def test_given_a_weights_file_when_chosen_then_its_digest_is_the_fingerprint(
    tmp_path: Path,
) -> None:
    path = save_sample(tmp_path)
    assert make_perception(str(path)).fingerprint == digest(path.read_bytes())
    assert make_perception('taxinet').fingerprint == digest(SHIPPED['taxinet'].read_bytes())


@pytest.mark.parametrize('word', ['truht', 'Truth', '', 'net.pt', 'ground_truth'])
@pytest.mark.parametrize('choose', [make_perception, check_perception])
def test_given_an_unknown_word_when_chosen_then_the_known_ones_are_listed(
    choose: object, word: str
) -> None:
    assert callable(choose)
    with pytest.raises(UsageError) as caught:
        choose(word)
    message = str(caught.value)
    assert repr(word) in message
    assert all(known in message for known in (*perception_names(), '.safetensors', '.onnx'))
    assert '\n' not in message


@pytest.mark.parametrize('choose', [make_perception, check_perception])
def test_given_a_missing_weights_file_when_chosen_then_there_is_no_fallback(
    choose: object, tmp_path: Path
) -> None:
    assert callable(choose)
    with pytest.raises(UsageError, match=r'^weights: .*gone\.safetensors: no such file'):
        choose(str(tmp_path / 'gone.safetensors'))


@pytest.mark.parametrize('word', perception_names())
def test_given_a_known_word_when_checked_then_nothing_is_said(word: str) -> None:
    check_perception(word)
