"""Two standing graphs with namespaces of their own on one domain; a third with one of theirs."""

from __future__ import annotations

import re

import pytest
from standing import ended, standing, taxinet

from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]


def test_given_two_standing_graphs_on_one_domain_then_each_runs_its_own_scenes(tmp_path):
    folders = {name: tmp_path / name for name in ('left', 'right')}
    for folder in folders.values():
        folder.mkdir()
    with own_domain() as domain:
        pass
    options = ['--domain', str(domain), '--no-record', '--namespace']
    with (
        standing(folders['left'], *options, 'left') as left,
        standing(folders['right'], *options, '/right/hand') as right,
    ):
        assert left.printed.splitlines()[0].startswith(
            f'ROS domain {domain}, this machine only; namespace /left; perception truth'
        )
        for graph, name in ((left, '/left'), (right, '/right/hand')):
            (line,) = re.findall('scenario_sampler --ros-args.*', graph.printed)
            assert line.endswith(f' -r __ns:={name} -r /clock:=clock')
        same = taxinet(
            'up', '--perception', 'truth', '--out', 'third', *options, 'left', cwd=tmp_path,
        )
        code, _, errors = ended(same)
        assert code == 2, errors
        assert errors.startswith(
            f'taxinet: error: another graph is on ROS domain {domain}: /left/simulator publishes '
            '/left/clock; '
        )
        asked = [
            taxinet(
                'node', 'scenario_sampler', '--ros-args', '-p', 'program:=nominal',
                '-p', f'seed:={seed}', '-p', f'out:={folders[name]}/table', '-p', 'runs:=1',
                '-p', 'set:=["duration=1"]', '-p',
                'participants:=[perception,steering_controller,mtl_monitor]',
                '-r', f'__ns:=/{within}', '-r', '/clock:=clock', cwd=tmp_path, domain=domain,
            )
            for seed, (name, within) in enumerate((('left', 'left'), ('right', 'right/hand')))
        ]
        for sampler in asked:
            code, output, errors = ended(sampler)
            assert code == 0, output + errors
        assert left.printed.count(': PASS') == right.printed.count(': PASS') == 1
    for folder in folders.values():
        assert list(read_table(folder / 'table')['outcome']) == ['PASS']


def test_given_a_name_that_is_no_namespace_then_one_line_says_so(tmp_path):
    code, _, errors = ended(taxinet('up', '--namespace', 'a b', cwd=tmp_path))
    assert code == 2
    assert errors.startswith('taxinet: error: --namespace a b: ')
    assert list(tmp_path.iterdir()) == []
