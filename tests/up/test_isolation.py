"""A graph has its ROS domain for itself, and what else runs on the machine changes nothing."""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import threading
from pathlib import Path

import pandas as pd
import pytest
from graph_runs import on_own_domain
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from standing import ended, taxinet

from taxinet_ros.cli.run.campaign import run_campaign
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions
from taxinet_ros.nodes.running import domain
from taxinet_ros.nodes.running.domain import BY_HAND, own_domain
from taxinet_ros.nodes.running.node_main import spin_until
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

SEEDS = {'first': 5, 'second': 6}


@pytest.fixture(scope='module')
def taken():
    """A ROS domain on which somebody else publishes the clock."""
    with on_own_domain() as spinning:
        node = Node('other_world', namespace='/elsewhere', context=spinning.context)
        node.create_publisher(interface.CLOCK.type, interface.CLOCK.name, interface.CLOCK.qos)
        spinning.add(node)
        yield spinning.context.get_domain_id()


@pytest.mark.parametrize(
    'words',
    [
        ('up', '--perception', 'truth', '--out', 'out', '--domain', '{domain}'),
        ('run', 'nominal', '--perception', 'truth', '--out', 'out'),
        ('node', 'simulator'),
    ],
    ids=lambda words: words[0],
)
def test_given_another_graph_on_the_domain_then_one_line_names_it_and_nothing_is_begun(
    words, taken, tmp_path
):
    more = {BY_HAND: str(taken)} if words[0] == 'run' else {}
    words = [word.format(domain=taken) for word in words]
    code, output, errors = ended(taxinet(*words, cwd=tmp_path, domain=taken, **more))
    assert code == 2, output + errors
    (line,) = errors.splitlines()
    assert line.removeprefix('taxinet: ') == (
        f'error: another graph is on ROS domain {taken}: /elsewhere/other_world publishes /clock; '
        'end it (a killed one disappears after about 20 s), or set another ROS_DOMAIN_ID'
    )
    assert output == ''
    assert list(tmp_path.iterdir()) == []


def begin(folder: Path, name: str) -> subprocess.Popen[str]:
    """A campaign with the network, whose pictures depend on everything, in its own process."""
    return taxinet(
        'run', 'training_full', '--runs', '2', '--seed', str(SEEDS[name]), '--set', 'duration=1',
        '--spec', 'phi_always', '--images', 'none', '--out', name, cwd=folder,
    )


def run_here(out: Path, seed: int, perception: str, runs: int = 1) -> int:
    """The same, in this process."""
    return run_campaign(make_options(
        program='training_full', runs=runs, seed=seed, perception=perception,
        settings=['duration=1'], specs=['phi_always'], images='none', out=out, processes=False,
    ))


def made(folder: Path, name: str) -> tuple[pd.DataFrame, dict[str, str]]:
    """Table of a campaign, and the bytes of its bags."""
    table = read_table(folder / name).drop(columns=['bag', *WALL_CLOCK_COLUMNS])
    bags = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted((folder / name).glob('*/*.mcap'))
    }
    return table, bags


def test_given_two_campaigns_at_once_then_each_is_what_it_is_alone(tmp_path):
    together, alone = tmp_path / 'together', tmp_path / 'alone'
    together.mkdir()
    at_once = [begin(together, name) for name in SEEDS]
    ends = [ended(campaign) for campaign in at_once]
    codes = [code for code, _, _ in ends] + [
        run_here(alone / name, seed, 'taxinet', runs=2) for name, seed in SEEDS.items()
    ]
    assert set(codes) <= {0, 1}, ends
    for name in SEEDS:
        (table, bags), (expected, expected_bags) = made(together, name), made(alone, name)
        assert set(table['outcome']) <= {'PASS', 'FAIL'}
        assert len(bags) == len(table) == 2
        pd.testing.assert_frame_equal(table, expected)
        assert bags == expected_bags
    assert not set(made(alone, 'first')[1].values()) & set(made(alone, 'second')[1].values())


# Somebody who reserves nothing ----------------------------------------------------------------


@pytest.fixture
def standing(tmp_path):
    """A graph as ``ros2 run`` starts it by hand, on a domain that nobody has reserved."""
    with own_domain() as number:
        pass
    foreign = GraphOptions(perception='truth', out=tmp_path / 'foreign', images='none')
    with on_own_domain(domain=number) as spinning:
        for kind, given in foreign.nodes().values():
            overrides = [Parameter(n, value=v) for n, v in given.items()]
            spinning.add(kind(context=spinning.context, parameter_overrides=overrides))
        over = Future(executor=spinning.executor)
        thread = threading.Thread(target=spin_until, args=(spinning.executor, over))
        thread.start()
        yield number
        over.set_result(None)
        thread.join()


def first_choice(number: int, monkeypatch) -> None:
    """Have graphs try one domain first, and then the others in turn."""
    monkeypatch.setattr(domain, '_graphs', itertools.count(number - 1 - os.getpid()))


def test_f5_given_a_graph_that_reserves_nothing_then_its_domain_is_passed_over(
    standing, tmp_path, monkeypatch
):
    first_choice(standing, monkeypatch)
    with own_domain() as other:
        assert other != standing
    first_choice(standing, monkeypatch)
    assert run_here(tmp_path / 'beside', 7, 'original') in (0, 1)
    monkeypatch.undo()
    assert run_here(tmp_path / 'alone', 7, 'original') in (0, 1)
    (table, bags), (expected, expected_bags) = made(tmp_path, 'beside'), made(tmp_path, 'alone')
    assert list(table['perception']) == ['original']
    assert list(table['rho']) == list(expected['rho'])
    assert list(table['outcome']) == list(expected['outcome'])
    assert len(bags) == len(expected_bags) == 1
    assert not (tmp_path / 'foreign').exists()


def test_f5_given_a_graph_that_came_after_the_choice_then_no_verdict_is_its_and_the_next_is_alone(
    standing, tmp_path, monkeypatch
):
    first_choice(standing, monkeypatch)
    monkeypatch.setattr(domain, 'in_use', lambda number: False)
    assert run_here(tmp_path / 'c', 7, 'original', runs=2) == 4
    broken, sound = read_table(tmp_path / 'c').to_dict('records')
    assert (broken['outcome'], broken['kind']) == ('INFRA_ERROR', 'intruder'), broken
    assert sound['outcome'] in ('PASS', 'FAIL')
    assert sound['perception'] == 'original'
