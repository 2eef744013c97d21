"""One closed loop, three layouts: ``tx.run`` without ROS, composed graph, separate processes.

The traces are bit-identical, and the frames, and so are the bags of the two graphs.
"""

from pathlib import Path

import pytest

import taxinet_ros as tx
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph
from taxinet_ros.nodes.interface import PARTICIPANTS

pytestmark = pytest.mark.ros

SPECS = ('phi_eventually', 'phi_always', 'on_the_way=always(x <= 275 and abs(he) <= 0.5)')
NAMES = ['phi_eventually', 'phi_always', 'on_the_way']
VAN = {
    'kind': 'vehicle', 'x_m': 730, 'y_m': -12, 'heading_deg': 90, 'wait_s': 1.0,
    'path': [{'x_m': 730, 'y_m': 12, 'speed_mps': 4}],
}
PARKED = {'kind': 'aircraft', 'x_m': 722, 'y_m': -16, 'heading_deg': 70}
SCENES = [
    scenario_from_human({
        'cross_track': 4.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5, 'duration': 6,
    }),
    scenario_from_human({
        'cross_track': -6.5, 'heading': 20, 'distance': 1400, 'time_of_day': 15.2,
        'clouds': 'overcast', 'rain': 60, 'duration': 6,
    }),
    scenario_from_human({
        'cross_track': 2.5, 'heading': -8, 'distance': 900, 'time_of_day': 10, 'clouds': 'broken',
        'rain': 30, 'wind_speed': 9, 'wind_direction': 300, 'gust': 3, 'gust_seed': 7,
        'runway_state': 'auto', 'slope': -1.5, 'speed': 7.5, 'duration': 6,
    }),
    scenario_from_human({
        'track': 'exit_left', 'cross_track': -2.5, 'heading': 10, 'distance': 240,
        'time_of_day': 10, 'duration': 6,
    }),
    scenario_from_human({
        'cross_track': -3.0, 'heading': 6, 'time_of_day': 7.2, 'camera_dropout': 20,
        'camera_freeze': 0.6, 'lens_dirt': 15, 'lens_drops': 15, 'glare_ghost': 80,
        'exposure_jump': -1, 'loop_delay': 0.1, 'loop_jitter': 0.2, 'steering_bias': 2,
        'steering_rate_limit': 8, 'fault_onset': 1.5, 'fault_seed': 11, 'duration': 6,
    }),
    scenario_from_human({
        'cross_track': 4.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5, 'duration': 6,
        'traffic': tx.load_traffic([VAN, PARKED, {'kind': 'closed_marking', 'x_m': 735, 'y_m': 0}]),
    }),
]
STEPS = 61


def specs_of(scene: tx.Scenario) -> tuple[str, ...]:
    return (*SPECS, 'no_collision', 'keep_clear') if scene.others.solids else SPECS


def requests() -> list[RunRequest]:
    return [
        RunRequest(
            run_id=f'run-{index}', index=index, program='test', seed=1, scenario=scene,
            judging=Judging(specs=specs_of(scene)), participants=PARTICIPANTS,
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


@pytest.mark.filterwarnings('ignore:.* no effect, as the perception needs no picture')
@pytest.mark.parametrize('word', ['truth', 'taxinet'])
def test_given_one_scene_when_run_in_three_layouts_then_every_bit_is_the_same(word, tmp_path):
    options = {name: GraphOptions(perception=word, out=tmp_path / name) for name in ('one', 'many')}
    composed = run_graph(composed_graph(options['one']), requests())
    processes = run_graph(process_graph(options['many'], tmp_path / 'logs'), requests())

    for request in requests():
        specs = specs_of(request.scenario)
        run = tx.run(request.scenario, perception=word, specs=specs)
        images = list(run.frames())
        assert len(run.trace) == STEPS
        for name, results in (('one', composed), ('many', processes)):
            bag = tmp_path / name / request.run_id
            trace = open_recording(bag).trace
            assert list(trace.columns) == list(run.trace.columns)
            assert trace.attrs == run.trace.attrs
            for column in trace.columns:
                there, here = (table[column].to_numpy() for table in (trace, run.trace))
                assert there.dtype == here.dtype
                assert there.tobytes() == here.tobytes(), (name, column)
            result = results[request.run_id]
            assert result.outcome is run.outcome
            assert list(result.rho) == list(run.rho) == [*NAMES, *specs[len(SPECS):]]
            assert list(result.rho.values()) == [interval.lower for interval in run.rho.values()]
            assert repr(result.statistics) == repr(run.statistics)  # equal where both are nan
            assert result.last_seq == STEPS - 1
            seen = [frame.image for frame in open_recording(bag).frames(render=False)]
            assert len(seen) == STEPS
            for image, rendered in zip(seen, images, strict=True):
                assert image.tobytes() == rendered.tobytes()
        files = [_files(tmp_path / name / request.run_id) for name in ('one', 'many')]
        assert set(files[0]) == {f'{request.run_id}_0.mcap', 'metadata.yaml'}
        assert files[0] == files[1], 'the bags differ in bytes'


def test_given_the_same_run_after_another_one_then_nothing_of_the_first_is_left_in_it(tmp_path):
    first, _, second, *_ = requests()
    options = GraphOptions(perception='truth', out=tmp_path / 'both')
    run_graph(composed_graph(options), [first, second])
    options = GraphOptions(perception='truth', out=tmp_path / 'alone')
    run_graph(composed_graph(options), [second])
    both, alone = (_files(tmp_path / name / second.run_id) for name in ('both', 'alone'))
    assert both == alone


def _files(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}
