from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import yaml
from network_samples import frame, random_weights
from numpy.typing import NDArray
from onnx import TensorProto, helper
from onnx_samples import described, linear, model, our_scaling, save, shrunk

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    INPUT_SHAPE,
    TaxiNet,
    normalise,
)
from taxinet_ros.core.perception.onnx.network import NetworkFiles, OnnxNetwork, prepare
from taxinet_ros.core.perception.onnx.sidecar import parse_sidecar
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.core.world import SimulatedWorld

Node = helper.make_node
FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64
GREY, WHITE = (np.full((200, 360, 3), level, np.uint8) for level in (128, 255))


def opened(path: Path) -> OnnxNetwork:
    return OnnxNetwork(NetworkFiles.read(path))


def exported() -> tuple[onnx.ModelProto, TaxiNet]:
    """Our own network with fresh weights, layer by layer in ONNX, and the same in torch."""
    architecture, weights = ARCHITECTURES[DEFAULT_ARCHITECTURE], random_weights()
    nodes, last = [], 'picture'
    for i, kernel in enumerate(architecture.kernels):
        names = [last, f'conv{i}.weight', f'conv{i}.bias']
        nodes += [
            Node('Conv', names, [f'conv{i}'], strides=[2, 2], pads=[kernel // 2] * 4),
            Node('Relu', [f'conv{i}'], [f'relu{i}']),
        ]
        last = f'relu{i}'
    nodes += [
        Node('Flatten', [last], ['flat']),
        Node('Gemm', ['flat', 'hidden.weight', 'hidden.bias'], ['hidden'], transB=1),
        Node('Relu', ['hidden'], ['relu']),
        Node('Gemm', ['relu', 'output.weight', 'output.bias'], ['answer'], transB=1),
    ]
    return model(nodes, weights, shape=('N', 1, *INPUT_SHAPE)), TaxiNet(architecture, weights)


def test_given_our_network_in_onnx_when_both_look_at_rendered_frames_then_they_agree(
    tmp_path: Path,
) -> None:
    network, ours = exported()
    theirs = make_perception(str(save(tmp_path, network, our_scaling())))
    seen = []
    for place in ({'heading': 0}, {'heading': 20, 'cross_track': 6}, {'clouds': 'overcast'}):
        image = SimulatedWorld(scenario_from_human(place), pictures=True).observe().image
        assert image is not None
        estimate = theirs.estimate(image, None)
        assert estimate.usable
        seen.append((estimate.cte_m, estimate.he_rad))
        assert seen[-1] == pytest.approx(ours.infer(shrunk(image)[np.newaxis])[0], abs=1e-4)
    assert np.ptp(seen, axis=0).min() > 1e-3, 'the frames make a difference'


def test_given_our_network_in_onnx_with_a_view_when_both_look_then_they_see_the_same(
    tmp_path: Path,
) -> None:
    network, ours = exported()
    changes = {**our_scaling(), 'input.view': 'ahead', 'input.resize': None}
    theirs = make_perception(str(save(tmp_path, network, changes)))
    scene = scenario_from_human({'camera': 'nose', 'cross_track': 3})
    image = SimulatedWorld(scene, pictures=True).observe().image
    assert image is not None
    theirs.begin(scene.rig)
    estimate = theirs.estimate(image, None)
    picture = find_eye('ahead', scene.rig).see(image)
    assert (estimate.cte_m, estimate.he_rad) == pytest.approx(ours.look(picture), abs=1e-4)


def test_given_a_linear_network_when_asked_then_scale_offset_unit_and_sign_count(
    tmp_path: Path,
) -> None:
    path = save(tmp_path, changes={
        'outputs.0.offset': 0.5,
        'outputs.1': {'quantity': 'heading_error', 'unit': 'deg', 'positive': 'right', 'scale': 3},
    })
    weights, bias = (onnx.numpy_helper.to_array(t) for t in linear().graph.initializer)
    first, second = np.full(24, 128 / 255) @ weights + bias
    cte_m, he_rad = opened(path).look(GREY)
    assert cte_m == pytest.approx(10 * first + 0.5, rel=1e-5)
    assert he_rad == pytest.approx(-math.radians(3 * second), rel=1e-5)


def test_given_several_outputs_and_some_ignored_when_asked_then_they_are_taken_in_order(
    tmp_path: Path,
) -> None:
    network = model(
        [
            Node('ReduceMean', ['picture'], ['mean'], axes=[1, 2, 3], keepdims=0),
            Node('Mul', ['mean', 'three'], ['more']),
        ],
        {'three': np.array([[2, 3]], np.float32)},
        outputs={'mean': FLOAT, 'more': FLOAT},
    )
    rad = {'quantity': 'heading_error', 'unit': 'rad', 'positive': 'left', 'scale': 1}
    metres = {'quantity': 'cte', 'unit': 'm', 'positive': 'left', 'scale': 1}
    path = save(tmp_path, network, {'outputs': [rad, {'quantity': 'ignore'}, metres]})
    assert opened(path).look(WHITE) == pytest.approx((3, 1))


@pytest.mark.parametrize('shape', [('N', 1, 4, 6), (1, 1, 4, 6), (None,) * 4, ('n', 1, 'h', 'w')])
def test_given_a_batch_of_one_or_any_when_asked_then_there_is_an_estimate(
    shape: tuple[Any, ...], tmp_path: Path
) -> None:
    path = save(tmp_path, linear(shape=shape))
    assert make_perception(str(path)).estimate(frame(), None).usable


@pytest.mark.parametrize('dtype', [np.float64, np.float16])
def test_given_a_network_of_other_precision_when_asked_then_it_agrees_roughly(
    dtype: Any, tmp_path: Path
) -> None:
    plain = opened(save(tmp_path)).look(frame())
    other = opened(save(tmp_path, linear(dtype=dtype))).look(frame())
    assert other == pytest.approx(plain, rel=0.05, abs=0.05)
    assert other != plain


def test_given_initial_values_among_the_inputs_when_loaded_then_the_picture_is_the_input(
    tmp_path: Path,
) -> None:
    network = linear()
    network.graph.input.append(helper.make_tensor_value_info('bias', FLOAT, [2]))
    assert opened(save(tmp_path, network, {'input.name': 'picture'})).look(GREY)


def test_given_both_files_when_made_then_word_and_digest_tell_them_apart(tmp_path: Path) -> None:
    path = save(tmp_path)
    perception = make_perception(str(path))
    both = path.read_bytes() + path.with_suffix('.yaml').read_bytes()
    assert perception.word == 'onnx'
    assert perception.fingerprint == hashlib.sha256(both).hexdigest()
    save(tmp_path, changes={'outputs.0.scale': 11})
    assert make_perception(str(path)).fingerprint != perception.fingerprint

# Both are well on the grey frame of the check; a white one is beyond what they can take.
FINITE_TO_GREY = model(
    [
        Node('ReduceMean', ['picture'], ['mean'], axes=[1, 2, 3], keepdims=0),
        Node('Sub', ['limit', 'mean'], ['left']), Node('Log', ['left'], ['answer']),
    ],
    {'limit': np.array([0.9, 0.8], np.float32)},
)
WORKS_ON_GREY = model(
    [
        Node('ReduceMax', ['picture'], ['most'], keepdims=0),
        Node('Cast', ['most'], ['index'], to=INT64),
        Node('Gather', ['table', 'index'], ['answer']),
    ],
    {'table': np.ones((1, 2), np.float32)},
)
SHORT_ON_WHITE = model(
    [
        Node('ReduceMax', ['picture'], ['most'], keepdims=0),
        Node('Cast', ['most'], ['index'], to=INT64), Node('Unsqueeze', ['index', 'zero'], ['from']),
        Node('Slice', ['table', 'from', 'end'], ['answer']),
    ],
    {'table': np.ones(2, np.float32), 'zero': np.array([0]), 'end': np.array([9])},
)


@pytest.mark.parametrize('network', [FINITE_TO_GREY, WORKS_ON_GREY, SHORT_ON_WHITE])
def test_given_a_network_that_fails_in_a_run_when_asked_then_the_estimate_is_invalid(
    network: onnx.ModelProto, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    perception = make_perception(str(save(tmp_path, network)))
    good = perception.estimate(GREY, None)
    assert good.usable
    assert perception.estimate(WHITE, TrackingError(cte_m=1, he_rad=0)) == NO_ESTIMATE
    assert perception.estimate(GREY, None) == good
    assert capfd.readouterr() == ('', '')


def test_given_scaling_beyond_half_precision_when_asked_then_nothing_is_raised(
    tmp_path: Path,
) -> None:
    path = save(tmp_path, linear(dtype=np.float16), {
        'scaling.mean': [0.5], 'scaling.std': [1e-6], 'scaling.divide_by': 256})
    perception = make_perception(str(path))
    assert perception.estimate(GREY, None).usable
    assert perception.estimate(WHITE, None) == NO_ESTIMATE


def test_given_an_onnx_network_when_it_drives_then_its_estimates_steer(tmp_path: Path) -> None:
    network = linear((0.3, 0.0))
    network.graph.initializer[0].CopyFrom(
        onnx.numpy_helper.from_array(np.zeros((24, 2), np.float32), 'weights'))
    perception = make_perception(str(save(tmp_path, network)))
    steps: list[Step] = []
    run_closed_loop(
        scenario_from_human({'duration': 2}), perception, specs=[parse_spec('phi_always')],
        on_step=steps.append,
    )
    assert len(steps) == 21
    assert [step.estimate.cte_m for step in steps] == pytest.approx([3] * 21)
    assert all(step.command.steering_rad < 0 for step in steps)
    assert steps[-1].observation.state.yaw_rad < steps[0].observation.state.yaw_rad


def test_given_a_check_when_it_ends_then_torch_was_not_needed_nor_onnx_for_others(
    tmp_path: Path,
) -> None:
    path = save(tmp_path)
    script = (
        'import sys; '
        'from taxinet_ros.core.perception.perception import check_perception, make_perception; '
        'make_perception("truth"); make_perception("taxinet"); print("onnxruntime" in sys.modules)'
        f'; check_perception({str(path)!r}); make_perception({str(path)!r})'
        '; print("torch" in sys.modules, "onnx" in sys.modules)'
    )
    result = subprocess.run(
        [sys.executable, '-W', 'error', '-c', script], cwd=Path(__file__).parents[3],
        capture_output=True, text=True, check=True,
    )
    assert (result.stdout, result.stderr) == ('False\nFalse False\n', '')


def test_given_a_description_in_json_when_loaded_then_it_is_yaml_too(tmp_path: Path) -> None:
    path = save(tmp_path)
    plain = opened(path).look(GREY)
    path.with_suffix('.yaml').write_text(json.dumps(described()))
    assert opened(path).look(GREY) == plain


WHOLE: dict[str, Any] = {'input.height': 200, 'input.width': 360, 'scaling.divide_by': 1}


def prepared(image: NDArray[np.uint8], changes: dict[str, Any]) -> NDArray[np.float32]:
    """What the network gets; a dictionary of everything that differs from the plain choice."""
    data = yaml.safe_dump(described(changes)).encode()
    return prepare(image, parse_sidecar(Path('net.yaml'), data))


def smooth() -> NDArray[np.uint8]:
    """A frame whose pixels all differ a little, as those of a runway do."""
    rows, columns = np.mgrid[:200, :360]
    return np.stack([rows, columns / 2, 255 - rows], axis=2).astype(np.uint8)


def test_given_our_own_networks_scaling_when_prepared_then_its_input_is_ours() -> None:
    for image in (frame(), smooth()):
        ours = normalise(shrunk(image)[np.newaxis])
        theirs = prepared(image, our_scaling())
        assert theirs.shape == ours.shape
        assert ours.std() > 0.05
        np.testing.assert_allclose(theirs, ours, atol=1e-5)


@pytest.mark.parametrize('divide_by', [1, 255])
def test_given_standardise_when_prepared_then_mean_nought_and_deviation_one(divide_by: int) -> None:
    changes = {'scaling.per_image': 'standardise', 'scaling.divide_by': divide_by}
    levels = prepared(smooth(), changes)
    assert levels.dtype == np.float32
    assert abs(levels.mean()) < 1e-5
    assert levels.std() == pytest.approx(1)
    assert not prepared(np.full((200, 360, 3), 77, np.uint8), changes).any()


def test_given_faint_contrast_when_standardised_then_it_is_not_blown_up() -> None:
    image = np.full((200, 360, 3), 77, np.uint8)
    image[:100] = 78
    changes = {**WHOLE, 'scaling.divide_by': 255, 'scaling.per_image': 'standardise'}
    assert np.abs(prepared(image, changes)).max() == pytest.approx(0.5, abs=1e-4)


def test_given_centre_when_prepared_then_only_the_mean_is_taken_out() -> None:
    plain = prepared(smooth(), {})
    centred = prepared(smooth(), {'scaling.per_image': 'centre'})
    np.testing.assert_allclose(centred, plain - plain.mean(), atol=1e-6)


def test_given_layouts_and_colours_when_prepared_then_the_same_pixels_in_their_order() -> None:
    image = frame()
    rgb = prepared(image, {**WHOLE, 'input.colour': 'rgb', 'input.layout': 'nhwc'})
    assert np.array_equal(rgb[0], image)
    planes = prepared(image, {**WHOLE, 'input.colour': 'rgb'})
    assert np.array_equal(planes[0], image.transpose(2, 0, 1))
    bgr = prepared(image, {**WHOLE, 'input.colour': 'bgr', 'input.layout': 'nhwc'})
    assert np.array_equal(bgr[0], image[..., ::-1])
    grey = prepared(image, WHOLE)
    flat = prepared(image, {**WHOLE, 'input.layout': 'flat'})
    assert np.array_equal(flat[0], grey.ravel())
    assert np.abs(grey[0, 0] - image @ (0.299, 0.587, 0.114)).max() < 1


def test_given_a_crop_when_prepared_then_only_those_pixels_are_left() -> None:
    image = frame()
    cut = prepared(image, {
        'input.crop': [50, 10, 110, 45], 'input.height': 35, 'input.width': 60,
        'input.colour': 'rgb', 'input.layout': 'nhwc', 'scaling.divide_by': 1,
    })
    assert np.array_equal(cut[0], image[10:45, 50:110])


def test_given_area_and_nearest_when_shrunk_then_means_or_single_pixels() -> None:
    image = frame()
    changes = {'input.height': 50, 'input.width': 90, 'scaling.divide_by': 1,
               'input.colour': 'rgb', 'input.layout': 'nhwc'}
    means = image.reshape(50, 4, 90, 4, 3).mean(axis=(1, 3))
    assert np.abs(prepared(image, changes)[0] - means).max() <= 0.5
    picked = prepared(image, {**changes, 'input.resize': 'nearest'})
    assert np.array_equal(picked[0], image[::4, ::4])
    smoothed = [prepared(image, {**changes, 'input.resize': word}) for word in ('linear', 'cubic')]
    assert not np.array_equal(*smoothed)


@pytest.mark.parametrize('keep', [1, 7, 16])
def test_given_brightest_when_prepared_then_each_square_is_the_mean_of_those(keep: int) -> None:
    image = frame()
    got = prepared(image, {
        'input.crop': [4, 8, 28, 24], 'input.height': 4, 'input.width': 6, 'input.layout': 'nhwc',
        'input.colour': 'rgb', 'scaling.divide_by': 1,
        'input.brightest': {'block': 4, 'keep': keep},
    })[0]
    for row, column, channel in np.ndindex(4, 6, 3):
        top, left = 8 + 4 * row, 4 + 4 * column
        square = np.sort(image[top:top + 4, left:left + 4, channel], axis=None)
        assert got[row, column, channel] == pytest.approx(square[-keep:].mean())
    assert got.std() > 0


def test_given_mean_std_and_clip_when_prepared_then_each_channel_has_its_own() -> None:
    image = frame()
    changes = {**WHOLE, 'input.colour': 'rgb', 'scaling.divide_by': 255,
               'scaling.mean': [0.5, 0.4, 0.3], 'scaling.std': [0.1, 0.2, 0.5]}
    expected = (image / 255 - (0.5, 0.4, 0.3)) / (0.1, 0.2, 0.5)
    np.testing.assert_allclose(prepared(image, changes)[0].transpose(1, 2, 0), expected, atol=1e-5)
    clipped = prepared(image, {**changes, 'scaling.clip': [-1, 0.5]})
    np.testing.assert_allclose(
        clipped[0].transpose(1, 2, 0), expected.clip(-1, 0.5), atol=1e-5)
    assert (clipped.min(), clipped.max()) == (-1, 0.5)


def test_given_a_view_of_a_frame_when_prepared_then_it_is_left_alone() -> None:
    image = frame()[:, ::-1]
    before = image.copy()
    got = prepared(image, {**WHOLE, 'input.colour': 'rgb', 'input.layout': 'nhwc'})
    assert np.array_equal(got[0], before)
    assert np.array_equal(image, before)
