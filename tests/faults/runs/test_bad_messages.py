"""Messages that are wrong, missing, doubled or out of order: harmless, or the run names who.

Who broke a run is who is named: not the one who noticed, nor the one who passed it on.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from graph_runs import files, request, run, steps_in
from rclpy.action import ActionClient
from tampering import changed, cut_short, tamper

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import (
    COMMAND,
    ESTIMATE,
    IMAGE,
    PERCEPTION,
    STEERING_CONTROLLER,
    TRUTH,
)

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

STEP = 9
DURATION = 3.0


def tampered_run(
    out: Path, topic, how, perception: str = 'truth', whole: bool = True, **timeouts: float
) -> RunResult:
    """A run with something wrong; its bag is whole up to the step (``whole``) where it broke."""
    options = GraphOptions(perception=perception, out=out, images='none', timeouts=timeouts)
    with composed_graph(options) as graph:
        tamper(graph, topic, how)
        (result,) = run(graph, request(duration=DURATION))
    if result.outcome is Outcome.INFRA_ERROR:
        assert result.rho == {}
        steps = steps_in(out / 'run')
        assert steps == list(range(len(steps)))
        assert len(steps) > STEP * whole
    else:
        assert all(not check.findings for check in check_bag(out / 'run').checks)
    return result


def only_at(step: int, *messages_of):
    """Tamper with one step, where each of ``messages_of`` makes one message of the true one."""
    return lambda k, message: [make(message) for make in messages_of] if k == step else [message]


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory) -> tuple[RunResult, dict[str, bytes]]:
    out = tmp_path_factory.mktemp('undisturbed')
    result = tampered_run(out, ESTIMATE, lambda k, message: [message])
    assert result.outcome.judged
    return result, files(out / 'run')


def with_(**values: Any) -> Any:
    return lambda message: changed(message, **values)


FRAME = ('node_error', PERCEPTION, IMAGE)
WRONG = {
    'frame of another encoding': (*FRAME, with_(encoding='32FC3'), "image encoding is '32FC3'"),
    'frame too small': (
        *FRAME, with_(height=10, width=10, step=30, data=bytes(300)),
        'image is (10, 10, 3), expected (200, 360, 3)',
    ),
    'frame of too few bytes': (*FRAME, with_(data=bytes(300)), 'has step 1080 and 300 bytes'),
    'frame torn': (*FRAME, cut_short, 'ends before its pixels'),
    'truth not finite': (
        'invalid_run', '', TRUTH, with_(cross_track_error=math.nan),
        'no whole, finite sequence of samples',
    ),
    'estimate of a frame to come': (
        'protocol', PERCEPTION, ESTIMATE, with_(seq=STEP + 1),
        f'answered frame {STEP + 1}, which is not out yet',
    ),
    'command not finite': (
        'protocol', STEERING_CONTROLLER, COMMAND, with_(steering_angle=math.nan),
        'commanded nan rad at 5 m/s',
    ),
}


@pytest.mark.parametrize('case', WRONG)
def test_given_a_message_that_is_wrong_then_the_run_names_who_sent_it_and_why(case, tmp_path):
    kind, who, topic, change, words = WRONG[case]
    perception = 'taxinet' if topic is IMAGE else 'truth'
    result = tampered_run(tmp_path, topic, only_at(STEP, change), perception=perception)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, kind), result
    assert who in ('', result.who)
    assert words in result.detail
    if topic is IMAGE:
        assert result.last_seq == STEP


def test_given_runs_then_a_goal_succeeds_only_where_it_was_judged(tmp_path, monkeypatch):
    """A behaviour tree goes by the goal's status."""
    states: list[int] = []
    take = ActionClient._get_result_async

    def taken(self: Any, handle: Any) -> Any:
        future = take(self, handle)
        future.add_done_callback(lambda done: states.append(done.result().status))
        return future

    monkeypatch.setattr(ActionClient, '_get_result_async', taken)
    outcomes = []
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        outcomes += run(graph, request('judged', duration=1.0))
        outcomes += run(graph, request('refused', participants=(PERCEPTION, 'recorder')))
        tamper(graph, COMMAND, lambda k, m: [changed(m, speed=-1.0)])
        outcomes += run(graph, request('broken', duration=1.0))
    assert [result.outcome for result in outcomes] == [
        Outcome.FAIL, Outcome.REJECTED, Outcome.INFRA_ERROR]
    assert outcomes[1].detail == (
        'participants: a run needs steering_controller, mtl_monitor as well, got only perception, '
        'recorder'
    )
    assert not (tmp_path / 'refused').exists()
    assert states == [
        GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_ABORTED]


ESTIMATES = [
    *((value, 0.0, True) for value in (math.nan, math.inf, -math.inf)),
    (0.0, math.nan, True), (math.nan, math.nan, True), (0.0, 0.0, False),
]


def test_given_estimates_that_are_none_then_the_aircraft_stops_and_rho_is_that_of_the_truth(
    tmp_path,
):
    def how(k, message):
        if not STEP <= k < STEP + len(ESTIMATES):
            return [message]
        cte, he, valid = ESTIMATES[k - STEP]
        return [changed(message, cross_track_error=cte, heading_error=he, valid=valid)]

    result = tampered_run(tmp_path, ESTIMATE, how)
    assert result.outcome.judged
    assert all(math.isfinite(value) for value in result.rho.values())
    assert result.statistics.unusable_estimates == len(ESTIMATES)
    trace = open_recording(tmp_path / 'run').columns
    bad = slice(STEP, STEP + len(ESTIMATES))
    assert trace['steering_rad'][bad].tolist() == [0.0] * len(ESTIMATES)
    assert trace['speed_cmd_mps'][bad].tolist() == [0.0] * len(ESTIMATES)
    assert trace['speed_cmd_mps'][:STEP].all()


def test_given_absurd_estimates_then_the_steering_keeps_to_its_stops_and_rho_is_finite(tmp_path):
    result = tampered_run(
        tmp_path, ESTIMATE, lambda k, m: [changed(m, cross_track_error=1.7e308) if k >= STEP else m]
    )
    assert result.outcome.judged
    assert all(math.isfinite(value) for value in result.rho.values())
    steering = open_recording(tmp_path / 'run').columns['steering_rad'][STEP:]
    assert len(steering) > 20
    assert max(abs(steering)) == SteeringGains().max_steering_rad


@pytest.mark.parametrize('topic', [ESTIMATE, COMMAND, TRUTH], ids=lambda topic: topic.name)
def test_given_messages_twice_and_old_ones_again_then_not_a_byte_changes(
    topic, tmp_path, undisturbed
):
    before = []

    def how(k, message):
        before.append(message)
        return [*before[-3:-1], message, message]

    result = tampered_run(tmp_path, topic, how)
    expected, bag = undisturbed
    assert len(before) == read_info(tmp_path / 'run').counts['/taxi_command'] or topic is not TRUTH
    assert (result.outcome, result.rho) == (expected.outcome, expected.rho)
    assert files(tmp_path / 'run') == bag
