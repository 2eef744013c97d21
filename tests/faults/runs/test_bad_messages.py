"""Messages that are wrong, missing, doubled or out of order: harmless, or the run names who."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from graph_runs import request, run, steps_in
from tampering import changed, cut_short, tamper

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import COMMAND, ESTIMATE, IMAGE, TRUTH

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

STEP = 9
DURATION = 3.0


def tampered_run(
    out: Path, topic, how, perception: str = 'truth', images: str = 'none', **timeouts: float
) -> RunResult:
    """A run with something wrong, and after a broken one that the graph is none the worse."""
    options = GraphOptions(perception=perception, out=out, images=images, timeouts=timeouts)
    with composed_graph(options) as graph:
        tamper(graph, topic, how)
        (result,) = run(graph, request(duration=DURATION))
    if result.outcome is Outcome.INFRA_ERROR:
        assert result.rho == {}
        steps = steps_in(out / 'run')
        assert steps == list(range(len(steps)))
        assert len(steps) > STEP
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


def files(bag: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in bag.iterdir()}


FRAMES = {
    'encoding': (lambda m: changed(m, encoding='32FC3'), "image encoding is '32FC3'"),
    'too small': (
        lambda m: changed(m, height=10, width=10, step=30, data=bytes(300)),
        'image is (10, 10, 3), expected (200, 360, 3)',
    ),
    'too few bytes': (lambda m: changed(m, data=bytes(300)), 'has step 1080 and 300 bytes'),
    'torn': (cut_short, 'ends before its pixels'),
}


@pytest.mark.parametrize('case', FRAMES)
def test_given_a_frame_that_is_none_then_the_perception_says_why(case, tmp_path):
    change, words = FRAMES[case]
    result = tampered_run(tmp_path, IMAGE, only_at(STEP, change), perception='taxinet')
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'node_error')
    assert (result.who, result.last_seq) == (interface.PERCEPTION, STEP)
    assert words in result.detail


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


def test_given_a_truth_that_is_not_finite_then_there_is_no_verdict(tmp_path):
    result = tampered_run(
        tmp_path, TRUTH, only_at(STEP, lambda m: changed(m, cross_track_error=math.nan))
    )
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'invalid_run')
    assert 'no whole, finite sequence of samples' in result.detail


COMMANDS = {
    'nan': ({'steering_angle': math.nan}, 'commanded nan rad at 5 m/s'),
    'backwards': ({'speed': -1.0}, 'at -1 m/s'),
    'of two frames': ({'seq': STEP - 1}, f'its answer to frame {STEP - 1} is stamped 0.9 s'),
}


@pytest.mark.parametrize('case', COMMANDS)
def test_given_a_command_that_is_none_then_the_controller_is_named(case, tmp_path):
    values, words = COMMANDS[case]
    result = tampered_run(tmp_path, COMMAND, only_at(STEP, lambda m: changed(m, **values)))
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'protocol')
    assert result.who == interface.STEERING_CONTROLLER
    assert words in result.detail


@pytest.mark.parametrize('topic', [ESTIMATE, COMMAND], ids=lambda topic: topic.publishers[0])
def test_given_an_answer_that_is_left_out_then_the_watchdog_names_who_owes_it(topic, tmp_path):
    result = tampered_run(tmp_path, topic, only_at(STEP), answer_timeout=5.0)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'timeout')
    assert (result.who, result.last_seq) == (topic.publishers[0], STEP)


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
