"""A recorder that is slow loses nothing, however many formulas a run has."""

from __future__ import annotations

import os
import signal
import time

import pytest
from graph_runs import grown, once, request, run, steps_in

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.core.pacing.timing import AT_ONCE, free_timing
from taxinet_ros.core.topics import RECORDER
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.nodes.graph.runner import GraphOptions, process_graph

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

FORMULAS = tuple(f'within_{k}=always(abs(cte) <= {k})' for k in range(5, 17))
LOOK_S = 0.3


def stop_for_a_while(graph) -> None:
    """Until time has come as far as it does without a recorder, as far as one can see."""
    pid = next(child.process.pid for child in graph.children if child.name == RECORDER)
    os.kill(pid, signal.SIGSTOP)
    before = None
    while before != (before := graph.seq):
        time.sleep(LOOK_S)
    os.kill(pid, signal.SIGCONT)


@pytest.mark.parametrize('timing', [AT_ONCE, free_timing('max')], ids=['lockstep', 'free'])
def test_given_a_recorder_that_stands_still_for_a_while_then_its_bag_is_whole(timing, tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path, images='none', timing=timing)
    with (
        process_graph(options, tmp_path / 'logs') as graph,
        once(lambda: grown(tmp_path / 'run'), lambda: stop_for_a_while(graph)),
    ):
        (result,) = run(graph, request(duration=60.0, judging=Judging(specs=FORMULAS)))
    assert result.outcome.judged, result
    assert steps_in(tmp_path / 'run') == list(range(601))
    assert check_bag(tmp_path / 'run').findings == ()
