"""A node that starts long after the others is waited for."""

from __future__ import annotations

import os
import signal
import threading

import pytest
from graph_runs import request, run, steps_in
from rclpy.parameter import Parameter
from waiting import PATIENT_S, wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes.graph.runner import GraphOptions, SampledGraph, node_processes, process_graph
from taxinet_ros.nodes.interface import PARTICIPANTS, PERCEPTION, SIMULATOR
from taxinet_ros.nodes.running.domain import missing_nodes, own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.simulator import Simulator

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

LATE_S = 5.0


def stopped(children, name: str) -> int:
    """Stop a node's process before it has come to anything; its number."""
    pid = next(child.process.pid for child in children if child.name == name)
    os.kill(pid, signal.SIGSTOP)
    return pid


def test_given_a_node_that_starts_late_then_the_run_waits_and_is_whole(tmp_path):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': PATIENT_S},
    )
    with process_graph(options, tmp_path / 'logs') as graph:
        pid = stopped(graph.children, PERCEPTION)
        timer = threading.Timer(LATE_S, os.kill, (pid, signal.SIGCONT))
        timer.start()
        (result,) = run(graph, request(duration=2.0))
        assert not timer.is_alive(), 'the run did not wait'
    assert result.outcome.judged, result
    assert read_info(tmp_path / 'run').complete
    assert steps_in(tmp_path / 'run') == list(range(21))


def test_r8_given_a_node_that_does_not_come_then_it_is_named_alone(tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    impatient = [Parameter('ready_timeout', value=2.0)]
    with (
        own_domain() as domain,
        node_processes(options, domain, tmp_path / 'logs', without=(SIMULATOR,)) as children,
        NodeExecutor(domain) as spinning,
    ):
        pid = stopped(children, PERCEPTION)
        simulator = Simulator(context=spinning.context, parameter_overrides=impatient)
        spinning.add(simulator)
        # Its time runs only when it has found all others, however long the machine takes for that.
        wait_for(lambda: set(missing_nodes(simulator, PARTICIPANTS)) == {PERCEPTION})
        (result,) = run(SampledGraph(spinning, {}, children), request(duration=2.0))
        os.kill(pid, signal.SIGCONT)
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'not_ready')
    assert (result.who, result.detail.partition(':')[0]) == (PERCEPTION, 'not ready within 2 s')
