"""Every node is an executable that starts in any order, and says in one line what it cannot do."""

from __future__ import annotations

import subprocess

import pandas as pd
import pytest
from graph_runs import parameters, start_node

from taxinet_ros.bag.reader import read_info
from taxinet_ros.nodes.running.domain import own_domain

pytestmark = pytest.mark.ros

def start(name: str, domain: int | str, *values: str, **how) -> subprocess.Popen[str]:
    return start_node(name, domain, *parameters(*values), **how)


def test_given_nodes_started_one_by_one_in_an_odd_order_then_a_campaign_runs_on_them(tmp_path):
    with own_domain() as domain:
        sampler = start(
            'scenario_sampler', domain, 'program:=nominal', 'runs:=2', f'out:={tmp_path}/table',
            'set:=["duration=3"]', 'specs:=["phi_always"]',
        )
        nodes = [
            start('recorder', domain, f'out:={tmp_path}/bags'),
            start('mtl_monitor', domain),
            start('ground_truth_perception', domain),
            start('steering_controller', domain, 'heading_gain:=1.5'),
            start('simulator', domain),
        ]
        try:
            _, errors = sampler.communicate()
        finally:
            for node in nodes:
                node.terminate()
            ends = [node.communicate() for node in nodes]
            sampler.kill()
    assert sampler.returncode == 0, errors
    assert [node.returncode for node in nodes] == [0] * 5, ends
    table = pd.read_parquet(tmp_path / 'table' / 'runs.parquet')
    assert list(table['outcome']) == ['PASS', 'PASS']
    assert list(table['perception']) == ['truth', 'truth']
    for run_id in table['run_id']:
        info = read_info(tmp_path / 'bags' / run_id)
        assert info.complete
        assert info.counts['/camera/image_raw'] == 31


@pytest.mark.parametrize('domain', [
    233, 'x', *(pytest.param(one, marks=pytest.mark.nightly) for one in (-1, 500, '7 ')),
])
def test_given_a_domain_that_is_none_then_the_node_says_so_and_no_exit_code_is_a_verdict(domain):
    node = start('steering_controller', domain)
    _, errors = node.communicate()
    assert node.returncode == 2, errors
    assert errors == (
        f"error: ROS_DOMAIN_ID '{domain}': a ROS domain is an integer from 0 to 232\n")


@pytest.mark.parametrize(
    ('name', 'parameter', 'words'),
    [
        ('steering_controller', 'heading_gan:=1.0', 'did you mean heading_gain?'),
        ('simulator', 'answer_timeout:=5000', 'value: 5000.0: answer_timeout; allowed: 0.1..3600'),
        ('mtl_monitor', 'formula:=x', "unknown parameter 'formula'"),
        ('taxinet_perception', 'weights:=gone.safetensors', 'no such file'),
        ('recorder', 'min_free:=-5', 'min_free'),
        ('scenario_sampler', 'program:=nowhere', 'known: anywhere, crossing'),
        ('bag_player', 'bag:=gone.mcap', 'gone.mcap'),
        *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
            ('steering_controller', 'heading_gain:=100.0', 'allowed: 0.0..10.0'),
            ('steering_controller', 'heading_gain:=fast', 'expecting type'),
            ('simulator', 'answer_timeout:=-1.0', 'answer_timeout'),
            ('simulator', 'use_sim_time:=perhaps', 'use_sim_time'),
            ('ground_truth_perception', 'weights:=x', "unknown parameter 'weights'"),
            ('runtime_monitor', 'monitor:=nothing', "'nothing' is unknown; known: original"),
            ('scene_markers', 'colour:=red', "unknown parameter 'colour'"),
            ('foxglove_server', 'port:=70000', 'allowed: 0..65535'),
            ('scenario_sampler', 'sampler:=luck', "sampler 'luck' is unknown; known: random"),
        ]),
    ],
)
def test_given_a_bad_parameter_then_the_node_says_so_in_one_line_and_leaves(
    name, parameter, words, tmp_path
):
    with own_domain() as domain:
        node = start(name, domain, parameter, cwd=tmp_path)
        _, errors = node.communicate()
    assert node.returncode == 2, errors
    (line,) = errors.strip().splitlines()
    assert line.startswith('error: ')
    assert words in line
    assert list(tmp_path.iterdir()) == []
