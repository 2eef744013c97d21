"""Who broke a run is who is named: not the one who noticed, nor the one who passed it on."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from graph_runs import request, run
from rclpy.action import ActionClient
from tampering import changed, tamper

from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import COMMAND, ESTIMATE, MTL_MONITOR, PERCEPTION

pytestmark = pytest.mark.ros

STEP = 9


def tampered_run(out: Path, topic: Any, how: Any) -> RunResult:
    with composed_graph(GraphOptions(perception='truth', out=out, images='none')) as graph:
        tamper(graph, topic, how)
        (result,) = run(graph, request(duration=3.0))
    return result


@pytest.mark.parametrize('late', [False, True])
def test_r8_given_a_perception_that_answers_a_wrong_frame_then_it_is_charged_and_not_who_follows(
    late, tmp_path, monkeypatch
):
    """Also where the command that follows comes in before the estimate that it follows."""
    held: list[Any] = []
    overtaken: list[Any] = []

    def how(step: int, message: Any) -> list[Any]:
        return [changed(message, seq=STEP + 1) if step == STEP else message]

    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph:
        tamper(graph, ESTIMATE, how)
        simulator = next(n for n in graph.nodes if n.get_name() == interface.SIMULATOR)
        if late:
            on_estimate, on_command = simulator._on_estimate, simulator._on_command
            hear = simulator._take

            def take(run: Any, callback: Any, message: Any) -> None:
                if callback == on_estimate and message.seq == STEP + 1:
                    held.append(message)
                    return
                hear(run, callback, message)
                if callback == on_command and held:
                    overtaken.append(held.pop())
                    hear(run, on_estimate, overtaken[0])

            monkeypatch.setattr(simulator, '_take', take)
        (result,) = run(graph, request(duration=3.0))
    assert len(overtaken) == late
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, InfraKind.PROTOCOL), result
    assert result.who == PERCEPTION
    assert result.detail == f'answered frame {STEP + 1}, which is not out yet'


def test_r8_given_a_controller_that_answers_a_wrong_frame_by_itself_then_it_is_charged(tmp_path):
    result = tampered_run(
        tmp_path, COMMAND, lambda k, m: [changed(m, seq=STEP + 2)] if k == STEP else [m]
    )
    assert (result.kind, result.who) == (InfraKind.PROTOCOL, interface.STEERING_CONTROLLER)


@pytest.mark.parametrize(('topic', 'who'), [
    (ESTIMATE, PERCEPTION), (COMMAND, interface.STEERING_CONTROLLER),
], ids=['estimate', 'command'])
def test_r8_given_an_answer_stamped_off_every_step_then_who_sent_it_is_charged(
    topic, who, tmp_path
):
    def how(step: int, message: Any) -> list[Any]:
        late = copy.deepcopy(message)
        late.header.stamp.nanosec += 7
        return [late if step == STEP else message]

    result = tampered_run(tmp_path, topic, how)
    assert (result.kind, result.who) == (InfraKind.PROTOCOL, who), result


def test_r8_given_a_follower_that_is_ahead_of_time_then_it_is_charged(tmp_path, monkeypatch):
    from taxinet_ros.nodes.mtl_monitor import MtlMonitor

    said = MtlMonitor.progress
    monkeypatch.setattr(
        MtlMonitor, 'progress', lambda self, seq, stamp_ns: said(self, seq + 500, stamp_ns))
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        (result,) = run(graph, request(duration=3.0))
    assert (result.outcome, result.kind, result.who) == (
        Outcome.INFRA_ERROR, InfraKind.PROTOCOL, MTL_MONITOR)


def test_r8_given_too_few_participants_then_the_goal_is_refused_with_who_is_missing(tmp_path):
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        (result,) = run(graph, request(participants=(PERCEPTION, 'recorder')))
    assert (result.outcome, result.detail) == (
        Outcome.REJECTED, 'participants: a run needs steering_controller, mtl_monitor as well, got '
        'only perception, recorder',
    )
    assert not (tmp_path / 'run').exists()


def test_r9_given_a_run_then_its_goal_succeeds_only_where_it_was_judged(tmp_path, monkeypatch):
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
        outcomes += run(graph, request('refused', participants=()))
        tamper(graph, COMMAND, lambda k, m: [changed(m, speed=-1.0)])
        outcomes += run(graph, request('broken', duration=1.0))
    assert [result.outcome for result in outcomes] == [
        Outcome.FAIL, Outcome.REJECTED, Outcome.INFRA_ERROR]
    assert states == [
        GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_ABORTED]
