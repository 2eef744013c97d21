"""A node that starts long after the others is waited for."""

from __future__ import annotations

import os
import signal
import threading

import pytest
from fault_runs import request, run, steps_in
from waiting import PATIENT_S

from taxinet_ros.bag.reader import read_info
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.nodes.graph import GraphOptions
from taxinet_ros.nodes.interface import PERCEPTION
from taxinet_ros.nodes.processes import process_graph

pytestmark = pytest.mark.ros

LATE_S = 10.0


def start_late(graph, name: str) -> threading.Timer:
    """Stop a node's process before it has come to anything, and have it go on later."""
    pid = next(child.process.pid for child in graph.children if child.name == name)
    os.kill(pid, signal.SIGSTOP)
    timer = threading.Timer(LATE_S, os.kill, (pid, signal.SIGCONT))
    timer.start()
    return timer


def test_given_a_node_that_starts_ten_seconds_late_then_the_run_waits_and_is_whole(tmp_path):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': PATIENT_S},
    )
    with process_graph(options, tmp_path / 'logs') as graph:
        timer = start_late(graph, PERCEPTION)
        (result,) = run(graph, request(duration=2.0))
        assert not timer.is_alive(), 'the run did not wait'
    assert result.outcome.judged, result
    assert read_info(tmp_path / 'run').complete
    assert steps_in(tmp_path / 'run') == list(range(21))


def test_given_a_node_that_starts_too_late_then_the_run_names_it(tmp_path):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': 4.0},
    )
    with process_graph(options, tmp_path / 'logs') as graph:
        timer = start_late(graph, PERCEPTION)
        (result,) = run(graph, request(duration=2.0))
        timer.cancel()
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'not_ready')
    assert PERCEPTION in result.who.split(', ')
    assert result.detail == 'not ready within 4 s'
