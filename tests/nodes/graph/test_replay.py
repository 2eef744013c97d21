"""A node that is fed with a recorded run answers as it did in the graph, or it is told how not."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

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
def test_given_a_function_that_asks_for_sensors_then_a_replay_is_refused_by_name(target, tmp_path):
    (tmp_path / 'mine.py').write_text('def mine(seen, sensors):\n    return 0.0, 5.0\n')
    recording = open_recording(GOLDEN / 'truth-nominal')
    words = {'perception': 'truth', 'controller': 'steering'}
    words['perception' if target == 'perception' else 'controller'] = f'{tmp_path}/mine.py:mine'
    with pytest.raises(UsageError, match=f'into {target}: its function has a parameter sensors'):
        replay(recording, recording.run, target=target, **words)
