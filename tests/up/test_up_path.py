"""A standing graph runs what a sampler in another terminal asks for, and ends when asked to."""

from __future__ import annotations

import pytest
from standing import ended, standing

from taxinet_ros.bag.reader import read_info
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.trials.record.table import read_table

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def graph(tmp_path_factory):
    with standing(tmp_path_factory.mktemp('up')) as graph:
        yield graph
        assert graph.ask_to_end() == 130
    assert graph.errors == ''


@pytest.mark.nightly
def test_given_a_standing_graph_then_it_says_where_and_how_to_have_it_run_scenes(graph):
    lines = graph.printed.splitlines()
    assert lines[0] == (
        f'ROS domain {graph.domain}, this machine only; perception truth; bags and logs in up'
    )
    assert f'ROS_DOMAIN_ID={graph.domain} ' in lines[2]
    assert ' scenario_sampler --ros-args' in lines[2]
    assert f'ready: {", ".join(("simulator", *PARTICIPANTS))}' in lines
    assert {path.stem for path in (graph.out / 'logs').iterdir()} == {'simulator', *PARTICIPANTS}


def test_given_a_sampler_in_another_terminal_then_its_runs_are_made_and_recorded(graph):
    code, output, errors = ended(graph.sampler('runs:=2', 'set:=["duration=1"]', seed=1))
    assert code == 0, output + errors
    table = read_table(graph.folder / 'table-1')
    assert list(table['outcome']) == ['PASS'] * 2
    for run_id in table['run_id']:
        assert read_info(graph.out / run_id).complete
    graph.wait_to_say('run table-1-00001: PASS')
