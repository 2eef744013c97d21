"""One closed loop, three layouts: ``tx.run`` without ROS, composed graph, separate processes.

The traces are bit-identical, and the frames, and so are the bags of the two graphs.
"""

import json
import shutil

import pytest
from graph_runs import files, judged_in, request

import taxinet_ros as tx
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.perception.weights import TAXINET, card_path
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

pytestmark = pytest.mark.ros

SPECS = ('phi_eventually', 'phi_always', 'on_the_way=always(x <= 275 and abs(he) <= 0.5)')
NAMES = ['phi_eventually', 'phi_always', 'on_the_way']
VAN = {
    'kind': 'vehicle', 'x_m': 730, 'y_m': -12, 'heading_deg': 90, 'wait_s': 1.0,
    'path': [{'x_m': 730, 'y_m': 12, 'speed_mps': 4}],
}
HOLD = {'kind': 'hold_line', 'x_m': 722, 'y_m': 1, 'until_s': 2.5}
REACTING = [
    {'kind': 'vehicle', 'x_m': 685, 'y_m': 8, 'stands_within_m': 17,
     'path': [{'x_m': 800, 'y_m': 0, 'speed_mps': 9}]},
    {'kind': 'person', 'x_m': 728, 'y_m': -3, 'heading_deg': 90, 'stands_within_m': 13,
     'path': [{'x_m': 728, 'y_m': 9, 'speed_mps': 1.5}]},
    {'kind': 'vehicle', 'x_m': 740, 'y_m': 9, 'heading_deg': 180, 'starts_within_m': 25,
     'wait_s': 0.5, 'path': [{'x_m': 700, 'y_m': 12, 'speed_mps': 6}]},
]
"""One follows, one lets the aircraft pass, and one starts late."""
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
        'cross_track': 2, 'duration': 6, 'wind_speed': 2, 'wind_speed@2': 12, 'wind_direction': 350,
        'wind_direction@5': 40, 'wind_speed@form': 'cubic', 'gust@3': 2, 'gust_seed': 4,
        'runway_state@2.5': 'icy', 'exposure_jump@4': -1.5, 'loop_delay@3': 0.3,
        'steering_bias@1': 0, 'steering_bias@1.5': 3,
    }),
    scenario_from_human({
        'cross_track': 4.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5, 'duration': 6,
        'traffic': tx.load_traffic([
            VAN, PARKED, {'kind': 'closed_marking', 'x_m': 735, 'y_m': 0}, *REACTING,
            HOLD,
        ]),
    }),
]
STEPS = 61


def specs_of(scene: tx.Scenario) -> tuple[str, ...]:
    others = 'no_collision', 'keep_clear', 'hold_short'
    return (*SPECS, *others) if scene.others.solids else SPECS


def requests() -> list[RunRequest]:
    return [
        request(f'run-{index}', scenario=scene, judging=Judging(specs=specs_of(scene)))
        for index, scene in enumerate(SCENES)
    ]


@pytest.mark.filterwarnings('ignore:.* no effect, as the perception needs no picture')
@pytest.mark.parametrize('word', [
    pytest.param('truth', marks=pytest.mark.nightly), 'taxinet',
])
def test_given_one_scene_when_run_in_three_layouts_then_every_bit_is_the_same(word, tmp_path):
    options = {name: GraphOptions(perception=word, out=tmp_path / name) for name in ('one', 'many')}
    composed = judged_in(composed_graph(options['one']), *requests())
    processes = judged_in(process_graph(options['many'], tmp_path / 'logs'), *requests())

    for number, asked in enumerate(requests()):
        specs = specs_of(asked.scenario)
        run = tx.run(asked.scenario, perception=word, specs=specs)
        images = list(run.frames())
        assert len(run.trace) == STEPS
        held = run.steps[-1].observation.held
        assert len(held) == (3 if asked.scenario.others.objects else 0)
        assert all(0 < one.ns < 6_000_000_000 for one in held.values())
        for name, results in (('one', composed), ('many', processes)):
            bag = tmp_path / name / asked.run_id
            trace = open_recording(bag).trace
            assert list(trace.columns) == list(run.trace.columns)
            assert trace.attrs == run.trace.attrs
            for column in trace.columns:
                there, here = (table[column].to_numpy() for table in (trace, run.trace))
                assert there.dtype == here.dtype
                assert there.tobytes() == here.tobytes(), (name, column)
            result = results[number]
            assert result.outcome is run.outcome
            assert list(result.rho) == list(run.rho) == [*NAMES, *specs[len(SPECS):]]
            assert list(result.rho.values()) == [interval.lower for interval in run.rho.values()]
            assert repr(result.statistics) == repr(run.statistics)  # equal where both are nan
            assert result.last_seq == STEPS - 1
            seen = [frame.image for frame in open_recording(bag).frames(render=False)]
            assert len(seen) == STEPS
            for image, rendered in zip(seen, images, strict=True):
                assert image.tobytes() == rendered.tobytes()
        one, many = (files(tmp_path / name / asked.run_id) for name in ('one', 'many'))
        assert set(one) == {f'{asked.run_id}_0.mcap', 'metadata.yaml'}
        assert one == many, 'the bags differ in bytes'


def test_given_the_same_run_after_another_one_then_nothing_of_the_first_is_left_in_it(tmp_path):
    first, _, second, *_ = requests()
    for name, asked in (('both', [first, second]), ('alone', [second])):
        options = GraphOptions(perception='truth', out=tmp_path / name)
        judged_in(composed_graph(options), *asked)
    both, alone = (files(tmp_path / name / second.run_id) for name in ('both', 'alone'))
    assert both == alone


@pytest.mark.parametrize('sensors', ['standard', 'none'])
def test_given_hold_lines_when_run_as_a_graph_then_the_controller_is_told_as_in_the_loop(
    sensors, tmp_path
):
    file = tmp_path / 'own.py'
    file.write_text(
        'def steer(estimate, sensors):\n'
        '    return 0.001 * sum(sensors.hold_lines_m) / 500, 5.0 if sensors.hold_lines_m else 2.0\n'
    )
    controller = 'hold_short' if sensors == 'standard' else f'{file}:steer'
    lines = [{**HOLD, 'x_m': 727, 'until_s': 7.0}, {**HOLD, 'x_m': 760, 'until_s': 8.5}]
    scene = scenario_from_human({
        'distance': 700, 'cross_track': 2, 'duration': 9, 'sensors': sensors,
        'traffic': tx.load_traffic(lines),
    })
    specs = 'hold_short', 'phi_always'
    asked = request('run-0', scenario=scene, judging=Judging(specs=specs))
    options = GraphOptions(perception='truth', controller=controller, out=tmp_path / 'bags')
    (result,) = judged_in(composed_graph(options), asked)
    here = tx.run(scene, perception='truth', controller=controller, specs=specs)
    there = open_recording(tmp_path / 'bags' / 'run-0')
    assert there.trace.equals(here.trace)
    assert len(here.trace) == 91
    assert here.trace.speed_cmd_mps.nunique() > (10 if sensors == 'standard' else 1)
    assert list(result.rho.values()) == [interval.lower for interval in here.rho.values()]
    assert there.judge('hold_short').interval == here.rho['hold_short']


def test_given_a_network_with_a_view_when_run_as_a_graph_then_every_bit_is_that_of_the_loop(
    tmp_path,
):
    weights = tmp_path / 'ahead.safetensors'
    shutil.copy(TAXINET, weights)
    card = json.loads(card_path(TAXINET).read_text()) | {'view': 'ahead'}
    card_path(weights).write_text(json.dumps(card))
    scene = scenario_from_human({
        'camera': 'nose', 'camera_dyaw': 2, 'aircraft': 'c172p', 'cross_track': 2, 'duration': 2,
    })
    asked = request('run-0', scenario=scene)
    judged_in(composed_graph(GraphOptions(perception=str(weights), out=tmp_path / 'bags')), asked)
    here = tx.run(scene, perception=str(weights)).trace
    there = open_recording(tmp_path / 'bags' / 'run-0').trace
    for column in ('est_cte_m', 'est_he_rad', 'x_m', 'y_m'):
        assert there[column].to_numpy().tobytes() == here[column].to_numpy().tobytes()
    assert here['est_cte_m'].nunique() > 10
