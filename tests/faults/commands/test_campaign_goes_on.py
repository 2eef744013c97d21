"""A run that breaks costs its campaign that run; a campaign that is killed loses none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pandas as pd
import pytest
from campaign_records import results
from command_process import ended, taxinet
from process_table import children, gone
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

NODES = Path(sys.prefix, 'lib', 'taxinet_ros')


def grown(bag: Path) -> bool:
    return sum(file.stat().st_size for file in bag.glob('*.mcap')) > 60_000


def test_given_a_node_that_is_killed_then_the_campaign_goes_on_with_the_next_run(tmp_path):
    words = ('run', 'nominal', '--runs', '2', '--perception', 'truth', '--images', 'none',
             '--set', 'duration=180', '--processes', '--out', 'c')
    with taxinet(*words, cwd=tmp_path) as campaign:
        wait_for(lambda: grown(tmp_path / 'c/nominal-s0-00000'))
        pids = [*children(campaign.pid, 'nodes.')]
        (victim,) = children(campaign.pid, 'nodes.ground_truth_perception')
        os.kill(victim, signal.SIGKILL)
        code, out, err = ended(campaign)
    assert (code, err) == (4, '')
    broken, whole = read_table(tmp_path / 'c').itertuples()
    assert (broken.outcome, broken.kind, broken.who) == ('INFRA_ERROR', 'died', 'perception')
    assert broken.detail == 'killed by SIGKILL'
    assert pd.isna(broken.rho)
    assert whole.outcome in ('PASS', 'FAIL'), out
    assert 'INFRA_ERROR died perception: killed by SIGKILL' in out
    assert '1 INFRA_ERROR' in out
    assert read_info(tmp_path / 'c' / whole.bag).counts['/taxi_command'] == 1801
    assert all(map(gone, pids)), 'the broken graph is not used again'


SEARCH = ('program:=nominal', 'sampler:=ce', 'sampler_options:=["every=1"]', 'seed:=4', 'runs:=5',
          'set:=["duration=1"]', 'specs:=["close=always(abs(cte) <= 0.3)"]')


class Standing:
    """Nodes that somebody started, and samplers on them, all of which end with the ``with``."""

    def __init__(self, domain: int, bags: Path) -> None:
        self._environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
        self.started = [
            self.start(name) for name in
            ('simulator', 'ground_truth_perception', 'steering_controller', 'mtl_monitor')
        ]
        self.started.append(self.start('recorder', f'out:={bags}', 'images:=none'))

    def start(self, name: str, *parameters: str) -> subprocess.Popen[str]:
        words = [str(NODES / name), *(['--ros-args'] if parameters else [])]
        words += [word for parameter in parameters for word in ('-p', parameter)]
        return subprocess.Popen(
            words, env=self._environment, text=True, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )

    def sampler(self, *parameters: str) -> subprocess.Popen[str]:
        self.started.append(self.start('scenario_sampler', *SEARCH, *parameters))
        return self.started[-1]

    def __enter__(self) -> Standing:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self.started:
            process.terminate()
        for process in self.started:
            with process:  # its pipe is closed, and its end waited for
                pass


def test_given_a_sampler_that_is_killed_when_resumed_then_the_table_is_as_if_not(tmp_path):
    with own_domain() as domain, Standing(domain, tmp_path / 'bags') as graph:
        whole = graph.sampler(f'out:={tmp_path / "whole"}', 'seed:=4')
        _, err = whole.communicate()
        assert whole.returncode == 1, err
        out = tmp_path / 'killed'
        killed = graph.sampler(f'out:={out}')
        wait_for(lambda: results(out) >= 2)
        killed.kill()
        killed.communicate()
        assert results(out) < 5
        again = resumed(graph, out)
    assert again.returncode == 1
    named = ['run_id', 'bag', 'retries', *WALL_CLOCK_COLUMNS]
    expected, table = (read_table(one).drop(columns=named) for one in (tmp_path / 'whole', out))
    assert len(expected) == 5
    pd.testing.assert_frame_equal(table, expected)


def resumed(graph: Standing, out: Path) -> subprocess.Popen[str]:
    """A sampler that goes on, once the killed one is forgotten, which takes some 20 s."""
    pause = threading.Event()
    while True:
        again = graph.sampler(f'out:={out}', 'resume:=true')
        _, err = again.communicate()
        if again.returncode != 4:
            return again
        assert 'another sampler drives this graph' in err or 'is busy' in err, err
        pause.wait(4.0)
