"""One closed loop, three layouts: in process without ROS, composed graph, separate processes.

The traces are the same to the bit, and so are the bags of the two graphs.
"""

from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.judging import Judging
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph
from taxinet_ros.nodes.interface import PARTICIPANTS

pytestmark = pytest.mark.ros

SPECS = ('phi_eventually', 'phi_always')
SCENES = [
    scenario_from_human({
        'cross_track': 4.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5, 'duration': 6,
    }),
    scenario_from_human({
        'cross_track': -6.5, 'heading': 20, 'distance': 1400, 'time_of_day': 15.2,
        'clouds': 'overcast', 'rain': 60, 'duration': 6,
    }),
]
STEPS = 61


def requests() -> list[RunRequest]:
    return [
        RunRequest(
            run_id=f'run-{index}', index=index, program='test', seed=1, scenario=scene,
            judging=Judging(specs=SPECS), participants=PARTICIPANTS,
        )
        for index, scene in enumerate(SCENES)
    ]


def run_graph(opened, asked: list[RunRequest]) -> dict[str, RunResult]:
    results: dict[str, RunResult] = {}

    def keep(request: RunRequest, result: RunResult) -> bool:
        results[request.run_id] = result
        return True

    with opened as graph:
        graph.run(asked, keep)
    assert set(results) == {request.run_id for request in asked}
    for result in results.values():
        assert result.outcome.judged, result
    return results


def run_loop(scene: Scenario, word: str) -> tuple[dict[str, np.ndarray], list[np.ndarray], object]:
    steps: list[Step] = []
    specs = [parse_spec(text) for text in SPECS]
    judgement = run_closed_loop(scene, make_perception(word), specs=specs, on_step=steps.append)
    columns = {
        't_ns': [s.observation.stamp_ns for s in steps],
        'x_m': [s.observation.state.x_m for s in steps],
        'cte_m': [s.observation.state.tracking_error.cte_m for s in steps],
        'he_rad': [s.observation.state.tracking_error.he_rad for s in steps],
        'speed_mps': [s.observation.state.speed_mps for s in steps],
        'est_cte_m': [s.estimate.cte_m for s in steps],
        'est_he_rad': [s.estimate.he_rad for s in steps],
        'steering_rad': [s.command.steering_rad for s in steps],
        'speed_cmd_mps': [s.command.speed_mps for s in steps],
    }
    for number, spec in enumerate(specs):
        columns[f'rho_lower.{spec.name}'] = [s.readings[number].lower for s in steps]
        columns[f'rho_upper.{spec.name}'] = [s.readings[number].upper for s in steps]
    images = [s.observation.image for s in steps if s.observation.image is not None]
    return {name: np.array(values) for name, values in columns.items()}, images, judgement


@pytest.mark.parametrize('word', ['truth', 'taxinet'])
def test_given_one_scene_when_run_in_three_layouts_then_every_bit_is_the_same(word, tmp_path):
    options = {name: GraphOptions(perception=word, out=tmp_path / name) for name in ('one', 'many')}
    composed = run_graph(composed_graph(options['one']), requests())
    processes = run_graph(process_graph(options['many'], tmp_path / 'logs'), requests())

    for request in requests():
        expected, images, judgement = run_loop(request.scenario, word)
        assert len(expected['t_ns']) == STEPS
        for name, results in (('one', composed), ('many', processes)):
            bag = tmp_path / name / request.run_id
            trace = open_recording(bag).columns
            for column, values in expected.items():
                assert trace[column].tobytes() == values.astype(trace[column].dtype).tobytes(), (
                    name, column
                )
            result = results[request.run_id]
            assert result.outcome == (Outcome.PASS if judgement.satisfied else Outcome.FAIL)
            assert list(result.rho) == list(SPECS)
            assert list(result.rho.values()) == [r.lower for r in judgement.readings]
            assert result.statistics == judgement.statistics
            assert result.last_seq == STEPS - 1
            seen = [frame.image for frame in open_recording(bag).frames(render=False)]
            assert len(seen) == STEPS
            for image, rendered in zip(seen, images, strict=False):
                assert image.tobytes() == rendered.tobytes()
        files = [_files(tmp_path / name / request.run_id) for name in ('one', 'many')]
        assert set(files[0]) == {f'{request.run_id}_0.mcap', 'metadata.yaml'}
        assert files[0] == files[1], 'the bags differ in bytes'


def test_given_the_same_run_after_another_one_then_nothing_of_the_first_is_left_in_it(tmp_path):
    first, second = requests()
    options = GraphOptions(perception='truth', out=tmp_path / 'both')
    run_graph(composed_graph(options), [first, second])
    options = GraphOptions(perception='truth', out=tmp_path / 'alone')
    run_graph(composed_graph(options), [second])
    both, alone = (_files(tmp_path / name / second.run_id) for name in ('both', 'alone'))
    assert both == alone


def _files(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}
