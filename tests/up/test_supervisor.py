"""Looking after processes, whatever they are: those that die at once, and one that never joins."""

from __future__ import annotations

import os
import time

import pytest
from graph_runs import on_own_domain
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.node_process import NodeProcess
from taxinet_ros.nodes.graph.supervisor import (
    GraphLostError,
    Restart,
    RestartLimit,
    Supervisor,
)
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.processes.child import end_all

PROGRAMS = {
    'torn': 'raise SystemExit(3)',
    'mistaken': 'import sys; print("error: gain: too big", file=sys.stderr); sys.exit(2)',
    'absent': 'import time; time.sleep(3600)',
    'deaf': 'import signal, time; [signal.signal(s, signal.SIG_IGN) for s in (2, 15)];'
    'print("deaf", flush=True); time.sleep(3600)',
}


@given(
    times=st.integers(0, 4), window_s=st.floats(0.1, 100),
    gaps_s=st.lists(st.floats(0, 50), max_size=30),
)
def test_given_any_deaths_then_no_window_holds_more_starts_than_allowed(times, window_s, gaps_s):
    limit, now_s, starts = RestartLimit(times, window_s), 0.0, []
    for gap_s in gaps_s:
        now_s += gap_s
        number = limit.spend(now_s)
        recent = [start for start in starts if now_s - start <= window_s]
        assert number == (len(recent) + 1 if len(recent) < times else 0)
        if number:
            starts.append(now_s)


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Start programs of :data:`PROGRAMS` in the place of nodes."""
    for name, program in PROGRAMS.items():
        (tmp_path / f'{name}_program.py').write_text(program)
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    started: list[NodeProcess] = []

    def start(name: str, program: str, domain: int = 0) -> NodeProcess:
        kind = type('Kind', (), {'__module__': f'{program}_program'})
        process = NodeProcess.of_ours(
            name, kind, {}, domain=domain, log=tmp_path / f'{name}.log', scratch=tmp_path
        )
        started.append(process)
        return process

    yield start
    end_all(started, ())


def looked_after(start, name: str, program: str, **care) -> list[str]:
    """What is said of one process until the supervisor is done with it."""
    said: list[str] = []
    with on_own_domain() as spinning:
        context = spinning.context
        process = start(name, program, context.get_domain_id())
        supervisor = Supervisor([process], said.append, context=context, **care)
        spinning.add(supervisor)
        try:
            spin_until(spinning.executor, supervisor.ended)
        except (GraphLostError, UsageError) as error:
            said.append(f'{type(error).__name__}: {error}')
    return said


@pytest.mark.ros
def test_given_a_node_that_dies_again_and_again_then_it_is_started_so_often_and_given_up(
    start, tmp_path
):
    said = looked_after(start, 'recorder', 'torn', limit=2, window_s=3600)
    assert said == [
        'recorder died: exit code 3; restarted (1 of 2 in 3600 s)',
        'recorder died: exit code 3; restarted (2 of 2 in 3600 s)',
        'GraphLostError: recorder died: exit code 3; it has died 3 times in 3600 s; '
        f'see {tmp_path}/recorder.log',
    ]


@pytest.mark.ros
def test_given_a_mistake_of_the_users_then_the_node_is_not_started_again(start):
    said = looked_after(start, 'steering_controller', 'mistaken', restart=Restart.ON_FAILURE)
    assert said == ['UsageError: gain: too big']


@pytest.mark.ros
def test_given_a_node_that_does_not_join_then_it_is_named_with_what_it_lacks(start, tmp_path):
    (line,) = looked_after(start, 'perception', 'absent', ready_s=0.5)
    assert line.startswith('GraphLostError: not ready within 0.5 s: perception does not ')
    assert line.endswith(f'; see {tmp_path}/perception.log')


def test_given_a_process_that_ignores_every_request_then_it_is_killed_in_the_end(start, tmp_path):
    deaf = start('recorder', 'deaf')
    while 'deaf' not in (tmp_path / 'recorder.log').read_text() and not deaf.dead:
        time.sleep(0.01)
    asked = [(2, 0.05), (15, 0.05)]
    assert end_all([deaf], asked) == ['recorder']
    assert deaf.how_it_ended() == 'killed by SIGKILL'


@pytest.mark.parametrize('number', [9, 64])
def test_given_any_signal_then_the_obituary_names_it(start, number):
    process = start('recorder', 'absent')
    process.process.send_signal(number)
    process.process.wait()
    assert process.how_it_ended() == {9: 'killed by SIGKILL', 64: 'killed by SIGRTMAX'}[number]
