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
from network_samples import frame, random_weights
from onnx import TensorProto, helper
from onnx_samples import described, linear, model, our_scaling, save, shrunk

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    INPUT_SHAPE,
    TaxiNet,
)
from taxinet_ros.core.onnx_network import NetworkFiles, OnnxNetwork
from taxinet_ros.core.perception import NO_ESTIMATE, make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.world import World

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
        image = World(scenario_from_human(place), pictures=True).observe().image
        assert image is not None
        estimate = theirs.estimate(image, None)
        assert estimate.usable
        seen.append((estimate.cte_m, estimate.he_rad))
        assert seen[-1] == pytest.approx(ours.infer(shrunk(image)[np.newaxis])[0], abs=1e-4)
    assert np.ptp(seen, axis=0).min() > 1e-3, 'the frames make a difference'


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
        'import sys; from taxinet_ros.core.perception import check_perception, make_perception; '
        'make_perception("truth"); print("onnxruntime" in sys.modules)'
        f'; check_perception({str(path)!r}); make_perception({str(path)!r})'
        '; print("torch" in sys.modules, "onnx" in sys.modules)'
    )
    result = subprocess.run(
        [sys.executable, '-W', 'error', '-c', script], cwd=Path(__file__).parents[2],
        capture_output=True, text=True, check=True,
    )
    assert (result.stdout, result.stderr) == ('False\nFalse False\n', '')


def test_given_a_description_in_json_when_loaded_then_it_is_yaml_too(tmp_path: Path) -> None:
    path = save(tmp_path)
    plain = opened(path).look(GREY)
    path.with_suffix('.yaml').write_text(json.dumps(described()))
    assert opened(path).look(GREY) == plain
