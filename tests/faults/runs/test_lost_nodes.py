"""A node's process that is killed, or hangs, at any step: the run says which, and keeps its bag."""

from __future__ import annotations

import os
import platform
import random
import signal
import time
from pathlib import Path

import pytest
from graph_runs import once, request, run, steps_in
from waiting import PATIENT_S

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.bag.info import info
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes.graph.runner import GraphOptions, process_graph
from taxinet_ros.nodes.interface import PERCEPTION, RECORDER, SIMULATOR

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

FUTEX, *OTHER_WAITS = {
    'x86_64': ('202', '219', '45'), 'aarch64': ('98', '128', '207'),
}[platform.machine()]
"""Numbers of the system calls futex, restart_syscall and recvfrom, in which threads wait."""

FUTEX_COMMAND, FUTEX_WAITS = 0x7F, (0, 9)
"""Mask without a futex operation's flags, and the operations that wait: the others wake."""

KIND = {
    signal.SIGKILL: ('died', ('killed by SIGKILL',)),
    # Where another node was silent first, on a busy machine, the recorder is missed at the end.
    signal.SIGSTOP: ('timeout', ('silent for ', 'did not finish its bag')),
}


@pytest.mark.parametrize('who', [SIMULATOR, PERCEPTION, RECORDER])
@pytest.mark.parametrize('number', KIND, ids=lambda number: number.name)
def test_given_a_node_that_is_lost_at_any_step_then_the_run_names_it_and_the_bag_stays(
    number, who, tmp_path, capfd
):
    step = random.Random(f'{number}{who}').randrange(3, 90)
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none',
        # The simulator is silent while it makes its first pictures. Of the dead others know.
        timeouts={'answer_timeout': 2.0 if number is signal.SIGSTOP else PATIENT_S},
        patience={'silence_timeout': 12.0},
    )
    with process_graph(options, tmp_path / 'logs') as graph:
        pid = next(child.process.pid for child in graph.children if child.name == who)
        with once(lambda: graph.seq >= step, lambda: lose(pid, number)):
            (result,) = run(graph, request())
    assert result.outcome is Outcome.INFRA_ERROR
    kind, words = KIND[number]
    assert (result.kind, result.who) == (kind, who), result
    assert any(some in result.detail for some in words), result
    assert result.rho == {}
    assert result.last_seq >= step
    check_bag(tmp_path / 'run', result, who, capfd)


def lose(pid: int, number: signal.Signals) -> None:
    """Kill a process, or stop it while it waits.

    Stopped in the middle of sending, it would have told one node and not the next, or would keep
    the lock of the memory in which another one is told things; that one would be the silent one.
    """
    os.kill(pid, number)
    while number is signal.SIGSTOP and not waits(pid):
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.001)
        os.kill(pid, number)


def waits(pid: int) -> bool:
    """Whether every thread of a process that is being stopped was waiting for work."""
    threads = list(Path(f'/proc/{pid}/task').iterdir())
    while not all('T (stopped)' in (thread / 'status').read_text() for thread in threads):
        time.sleep(0.001)
    calls = [(thread / 'syscall').read_text().split() for thread in threads]
    return all(call in OTHER_WAITS or waits_for_futex(call, rest) for call, *rest in calls)


def waits_for_futex(call: str, arguments: list[str]) -> bool:
    return call == FUTEX and int(arguments[1], 16) & FUTEX_COMMAND in FUTEX_WAITS


def check_bag(bag, result, who, capfd) -> None:
    """It has every step up to the last one that the run reached, or all but one."""
    steps = steps_in(bag)
    assert steps == list(range(len(steps)))
    assert len(steps) >= result.last_seq - 8 * (who == RECORDER)
    if who in (RECORDER, SIMULATOR):
        saved = bag.with_name('saved')
        recover(bag, saved)
        assert steps_in(saved) == steps
        # One that hung is woken when the graph ends, and may still finish its bag.
        woken = who == RECORDER and result.kind == 'timeout' and read_info(bag).complete
        if who == RECORDER and not woken:
            assert info(bag) == 3
            out = capfd.readouterr().out
            assert 'NOT WHOLE: ' in out
            assert f'taxinet bag recover {bag} --out NEW' in out
        if not woken:
            return
    assert read_info(bag).complete
    facts = open_recording(bag).facts
    assert (facts.outcome, facts.kind, facts.who) == ('INFRA_ERROR', result.kind, who)
