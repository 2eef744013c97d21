"""What a terminal shows of a standing graph."""

from __future__ import annotations

import collections
import os
from types import SimpleNamespace

import pytest
from rich.console import Console

from taxinet_ros.cli.run.up_view import UpView
from taxinet_ros.nodes.graph.runner import GraphOptions


def a_node(name: str, restarts: int = 0, pid: int = 0) -> SimpleNamespace:
    process = SimpleNamespace(pid=pid or os.getpid())
    return SimpleNamespace(
        name=name, restarts=restarts, since_s=100.0, process=process,
    )


@pytest.fixture
def supervisor():
    runs = SimpleNamespace(
        running=True, run_id='s_falsif-s0-00012', seq=173,
        outcomes=collections.Counter({'PASS': 9, 'FAIL': 3}),
    )
    nodes = [
        a_node('simulator'), a_node('perception', restarts=2), a_node('mtl_monitor', pid=2**22),
    ]
    return SimpleNamespace(nodes=nodes, runs=runs, ready=True)


def shown(supervisor, tmp_path) -> list[str]:
    graph = GraphOptions(perception='truth', out=tmp_path)
    console = Console(width=100, record=True, file=open(os.devnull, 'w'))  # noqa: SIM115 (closed below)
    with console.file:
        console.print(UpView(console, graph).picture(supervisor, 3725.9 + 100.0))
        return [line.rstrip() for line in console.export_text().splitlines()]


def test_given_a_graph_amid_a_run_then_the_table_names_each_nodes_state_and_the_step(
    supervisor, tmp_path
):
    lines = [line.split() for line in shown(supervisor, tmp_path)]
    assert lines[1] == ['node', 'since', 'process', 'memory', 'restarts']
    pid = str(os.getpid())
    name, since, process, memory, unit = lines[2]
    assert (name, since, process, unit) == ('simulator', '1:02:05', pid, 'MB')
    assert int(memory) > 1
    assert (lines[3][0], lines[3][-1]) == ('perception', '2')
    assert lines[4] == ['mtl_monitor', '1:02:05', str(2**22)]
    assert lines[6] == ['run', 's_falsif-s0-00012:', 'step', '173', '3', 'FAIL', '9', 'PASS']
    assert all(len(line) < 80 for line in shown(supervisor, tmp_path))


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'running': False}, 'run s_falsif-s0-00012: starting'),
        ({'running': False, 'run_id': ''}, 'idle'),
    ],
)
def test_given_no_step_yet_then_the_line_on_runs_says_why(supervisor, changes, words, tmp_path):
    vars(supervisor.runs).update(changes)
    assert any(line.startswith(words) for line in shown(supervisor, tmp_path))
