"""A third party's network in the graph gives what it gives without ROS."""

import subprocess
import sys

import numpy as np
import onnx
import pytest
from graph_runs import judged_in, request
from onnx import TensorProto, helper, numpy_helper

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

pytestmark = pytest.mark.ros

SCENE = scenario_from_human({'cross_track': 2, 'heading': 5, 'duration': 1})
DESCRIPTION = """
input: {layout: flat, colour: grey, height: 20, width: 36}
scaling: {divide_by: 255, per_image: standardise}
outputs:
- {quantity: cte, unit: m, positive: right, scale: 2}
- {quantity: heading_error, unit: deg, positive: left, scale: 5}
"""


def save_network(folder):
    weights = np.random.default_rng(5).normal(0, 0.02, (720, 2)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node('MatMul', ['picture', 'weights'], ['answer'])], 'net',
        [helper.make_tensor_value_info('picture', TensorProto.FLOAT, [1, 720])],
        [helper.make_tensor_value_info('answer', TensorProto.FLOAT, [1, 2])],
        [numpy_helper.from_array(weights, 'weights')],
    )
    path = folder / 'net.onnx'
    opset = helper.make_opsetid('', 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=8), path)
    path.with_suffix('.yaml').write_text(DESCRIPTION)
    return path


def test_given_an_onnx_network_when_run_in_the_graph_then_its_trace_is_the_loops(tmp_path):
    path = save_network(tmp_path)
    perception = make_perception(str(path))
    steps: list[Step] = []
    run_closed_loop(SCENE, perception, specs=[parse_spec('phi_always')], on_step=steps.append)
    graph = composed_graph(GraphOptions(perception=str(path), out=tmp_path / 'bags'))
    (result,) = judged_in(graph, request('run-0', scenario=SCENE))
    assert (result.perception, result.fingerprint) == ('onnx', perception.fingerprint)
    trace = open_recording(tmp_path / 'bags' / 'run-0').columns
    expected = np.array([[s.estimate.cte_m, s.estimate.he_rad] for s in steps])
    assert expected.shape == (11, 2)
    assert np.ptp(expected, axis=0).min() > 1e-6, 'the network looks'
    assert np.array_equal(np.stack([trace['est_cte_m'], trace['est_he_rad']], axis=1), expected)


@pytest.mark.parametrize('words', [
    ('run', 'nominal', '--runs', '1', '--perception'), ('up', '--perception'),
    ('node', 'taxinet_perception', '--ros-args', '-p'),
], ids=lambda words: words[0])
def test_f8_given_a_network_that_asks_for_gigabytes_when_used_then_one_line_and_code_2(
    words, tmp_path
):
    path = save_network(tmp_path)
    model = onnx.load(path)
    model.graph.node[0].output[0] = 'sure'
    model.graph.initializer.append(numpy_helper.from_array(np.array([1_630_000_000]), 'side'))
    model.graph.node.extend([
        helper.make_node('ConstantOfShape', ['side'], ['zeros']),
        helper.make_node('ReduceMax', ['zeros'], ['most'], keepdims=0),
        helper.make_node('Add', ['sure', 'most'], ['answer']),
    ])
    onnx.save(model, path)
    before = {path.name for path in tmp_path.iterdir()}
    done = subprocess.run(
        [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()', *words,
         f'weights:={path}' if words[0] == 'node' else str(path)],
        capture_output=True, text=True, cwd=tmp_path,
    )
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert 'net.onnx: needs more memory than allowed for a network, 2 GiB; make it smaller' in line
    assert {path.name for path in tmp_path.iterdir()} == before
