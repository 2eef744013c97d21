"""A node that is fed with a recorded run answers as it did in the graph, or it is told how not."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.bag.check.compare import NETWORK_TOLERANCE, same_stack
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes.graph import replay as player
from taxinet_ros.nodes.graph.replay import TARGETS, replay
from taxinet_ros.nodes.steering_controller import SteeringController

pytestmark = pytest.mark.ros

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden'
TRUTH, SEEN = GOLDEN / 'truth-nominal', GOLDEN / 'taxinet-midday'
STEPS = 121


def columns(bag, target, **changes):
    recording = open_recording(bag)
    run = dataclasses.replace(recording.run, **changes)
    return replay(recording, run, target=target, perception=run.perception)


@pytest.mark.parametrize('target', TARGETS)
def test_given_a_run_on_the_truth_when_replayed_then_every_answer_is_the_same(target):
    trace, answers = open_recording(TRUTH).columns, columns(TRUTH, target)
    assert len(answers) > 2
    for name, values in answers.items():
        assert len(values) == STEPS
        assert values.tobytes() == trace[name].astype(np.float64).tobytes(), name


@pytest.mark.skipif(
    not same_stack(GOLDEN), reason='the golden bags come from another stack'
)
def test_given_a_bag_without_frames_when_the_network_sees_them_rendered_then_it_says_the_same():
    trace, answers = open_recording(SEEN).columns, columns(SEEN, 'perception')
    assert (trace['est_cte_m'] != trace['cte_m']).all()
    for name in ('est_cte_m', 'est_he_rad'):
        assert np.abs(answers[name] - trace[name]).max() <= NETWORK_TOLERANCE
        assert answers[name].tobytes() == trace[name].tobytes(), name


def test_given_other_gains_when_replayed_then_the_commands_are_others():
    answers = columns(TRUTH, 'steering_controller', gains={'heading_gain': 0.5})
    before = open_recording(TRUTH).columns['steering_rad']
    assert np.abs(answers['steering_rad'] - before).max() > 0.01


def test_given_a_node_that_raises_then_it_and_its_step_are_named(monkeypatch):
    answer = SteeringController._answer

    def broken(self, estimate):
        if estimate.seq == 3:
            raise RuntimeError('out of order')
        answer(self, estimate)

    monkeypatch.setattr(SteeringController, '_answer', broken)
    with pytest.raises(InfraError, match=r'node_error: steering_controller at step 3: .*order'):
        columns(TRUTH, 'steering_controller')


def test_given_a_node_that_falls_silent_then_that_is_told(monkeypatch):
    monkeypatch.setattr(player, 'ANSWER_TIMEOUT_S', 1.0)
    monkeypatch.setattr(SteeringController, '_answer', lambda self, estimate: None)
    with pytest.raises(InfraError, match='timeout: steering_controller at step 0: silent'):
        columns(TRUTH, 'steering_controller')


def test_given_a_node_that_nothing_can_be_replayed_into_then_the_known_ones_are_listed():
    with pytest.raises(UsageError, match=r'into recorder: .*perception, steering_controller'):
        columns(TRUTH, 'recorder')


def test_given_messages_of_another_version_then_they_are_not_misread(monkeypatch):
    monkeypatch.setattr('taxinet_ros.nodes.graph.replay.type_hash', lambda name: 'RIHS01_other')
    with pytest.raises(UsageError, match='another version'):
        columns(TRUTH, 'steering_controller')


@pytest.mark.parametrize('target', ['perception', 'steering_controller'])
def test_given_a_function_that_asks_for_sensors_of_a_run_without_then_it_is_refused(
    target, tmp_path
):
    (tmp_path / 'mine.py').write_text('def mine(seen, sensors):\n    return 0.0, 5.0\n')
    recording = open_recording(GOLDEN / 'truth-nominal')
    words = {'perception': 'truth', 'controller': 'steering'}
    words['perception' if target == 'perception' else 'controller'] = f'{tmp_path}/mine.py:mine'
    with pytest.raises(UsageError, match=f'into {target}: .*mine has a parameter sensors'):
        replay(recording, recording.run, target=target, **words)


@pytest.mark.parametrize('images', [True, False])
def test_given_functions_that_ask_for_sensors_when_replayed_then_they_get_what_they_got(
    images, tmp_path
):
    (tmp_path / 'mine.py').write_text(
        'def told(sensors):\n'
        '    seen = [one.image.mean() / 1000 for one in sensors.camera]\n'
        '    turned = [one.rates_radps[2] for one in sensors.imu]\n'
        '    return sum(seen + turned) + sum(one.altitude_m / 1e4 for one in sensors.gnss)\n'
        'def look(image, sensors):\n    return image.mean() / 500 - 0.2, told(sensors) / 10\n'
        'def steer(estimate, sensors):\n    return told(sensors) / 10 - estimate.cte_m, 4.0\n'
    )
    words = {'perception': f'{tmp_path}/mine.py:look', 'controller': f'{tmp_path}/mine.py:steer'}
    sensors = {
        'gnss': {'rate_hz': 5, 'delay_s': 0.1, 'loss_percent': 30}, 'imu': {'rate_hz': 50},
        'camera': {'rate_hz': 5, 'mount': 'nose'},
    }
    scene = tx.Scenario(duration_s=2, cross_track_m=2, sensors=tx.load_sensors(sensors))
    run = tx.run(scene, **words, specs='phi_always')
    recording = open_recording(run.save_bag(tmp_path / 'run', images=images))
    for target in ('perception', 'steering_controller'):
        answers = replay(recording, recording.run, target=target, **words)
        assert len(answers['seq']) == 21
        for name, values in answers.items():
            assert values.tobytes() == run.trace[name].to_numpy(np.float64).tobytes(), name


def test_given_a_run_that_holds_short_when_replayed_then_it_holds_again(tmp_path):
    line = {'kind': 'hold_line', 'x_m': 727, 'y_m': 0, 'until_s': 7.0}
    scene = tx.Scenario(
        distance_m=700, duration_s=8, sensors='standard', traffic=tx.load_traffic([line])
    )
    run = tx.run(scene, perception='truth', controller='hold_short', specs='phi_always')
    recording = open_recording(run.save_bag(tmp_path / 'run', images=False))
    answers = replay(recording, recording.run, target='steering_controller', perception='truth',
                     controller='hold_short')
    assert answers['speed_cmd_mps'].tobytes() == run.trace['speed_cmd_mps'].to_numpy().tobytes()
    assert answers['speed_cmd_mps'].min() < 1
