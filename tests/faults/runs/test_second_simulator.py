"""A clock that is wrong moves no run, and what it spoils is said; so is an answer of no outcome."""

from __future__ import annotations

from pathlib import Path

import pytest
from graph_runs import PERIOD_NS, files, request, run, steps_in
from rosgraph_msgs.msg import Clock
from tampering import tamper
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import RunStatus

from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import CLOCK, RECORDER
from taxinet_ros.nodes.lockstep.sampler import result_of
from taxinet_ros.nodes.messages.convert import time_of

pytestmark = pytest.mark.ros


def test_f5_given_an_answer_without_an_outcome_then_it_is_an_error_of_the_bench():
    answer = RunScenario.Result(status=RunStatus(outcome='', seq=3))
    result = result_of(answer)
    assert (result.outcome, result.kind, result.who) == (
        Outcome.INFRA_ERROR, 'protocol', 'simulator'
    )
    assert result.detail == "answered '', which is not an outcome"


def disturbed_run(out: Path, stamp_of_step) -> tuple[RunResult, int]:
    """A run in which the clock ticks twice a step; the result, and how many ticks arrived."""
    with composed_graph(GraphOptions(perception='truth', out=out, images='none')) as graph:
        recorder = next(node for node in graph.nodes if node.get_name() == RECORDER)
        steps = []

        def tick(step: int, message):
            steps.append(recorder.bag.steps)
            if stamp_of_step is None:
                return [message]
            return [message, Clock(clock=time_of(stamp_of_step(step)))]

        tamper(graph, CLOCK, tick)
        (result,) = run(graph, request(duration=5.0))
        return result, steps[-1].repeated


def test_given_a_clock_that_runs_backwards_then_not_a_byte_changes(tmp_path):
    alone, ticks = disturbed_run(tmp_path / 'alone', None)
    assert (alone.outcome.judged, ticks) == (True, 0)
    result, ticks = disturbed_run(tmp_path / 'both', lambda step: max(0, step - 7) * PERIOD_NS)
    assert (result.outcome, result.rho) == (alone.outcome, alone.rho)
    assert ticks > 40
    assert files(tmp_path / 'both' / 'run') == files(tmp_path / 'alone' / 'run')


def test_given_a_clock_of_other_steps_then_the_bag_is_not_declared_sound(tmp_path):
    result, _ = disturbed_run(tmp_path, lambda step: step * PERIOD_NS + 12_345)
    assert (result.outcome, result.kind, result.who) == (
        Outcome.INFRA_ERROR, 'protocol', 'simulator'
    )
    assert 'which is not a control step' in result.detail
    assert result.rho == {}
    steps = steps_in(tmp_path / 'run')
    assert steps == list(range(len(steps)))
