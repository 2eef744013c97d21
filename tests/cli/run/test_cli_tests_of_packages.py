"""The fixture for users' tests: what it runs, when it fails, and the example that uses it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import onnx_samples
import pytest
import yaml
from taxinet_process import taxinet

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.testing.campaign import _judge, launch_test, run_campaign

PACKAGE = Path(__file__).parents[3] / 'examples' / 'my_perception_package'
PLUGIN = ('-p', 'taxinet_ros.pytest_plugin', '-p', 'no:cacheprovider')


def run(folder: Path, **given):
    return run_campaign('s_falsif', **{
        'runs': 2, 'at_least': 1.0, 'perception': 'truth', 'settings': {'duration': 1},
        'specs': ['on_runway'], 'folder': folder, **given,
    })


@pytest.fixture
def mine(tmp_path, monkeypatch) -> Path:
    """A folder with a function of one's own, from which runs are made."""
    (tmp_path / 'mine.py').write_text(
        'def steer(estimate):\n    return -0.05 * estimate.cte_m - estimate.he_rad, 5.0\n'
        'def fails(estimate):\n    return 1 / 0\n'
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def workflow() -> str:
    """The shell command by which the example's workflow tests."""
    job = yaml.safe_load((PACKAGE / '.github/workflows/test.yml').read_text())['jobs']['test']
    return job['steps'][-1]['run']


@pytest.mark.nightly
@pytest.mark.ros
@pytest.mark.parametrize(('scenes', 'which'), [
    ('2', ('-k', 'runway')), pytest.param('4', (), marks=pytest.mark.nightly),
])
def test_given_the_example_then_its_workflow_passes(tmp_path, scenes, which):
    package = shutil.copytree(PACKAGE, tmp_path / 'package')
    python, *words = shlex.split(workflow())
    assert python == 'python'
    done = subprocess.run(
        [sys.executable, *words, *PLUGIN, *which, '-v'], cwd=package, text=True,
        capture_output=True, check=False, env={**os.environ, 'SCENES': scenes},
    )
    assert done.returncode == 0, done.stdout
    assert f'{1 if which else 2} passed' in done.stdout


def test_given_the_example_then_its_files_agree_with_each_other():
    name = PACKAGE.name
    assert f'<name>{name}</name>' in (PACKAGE / 'package.xml').read_text()
    assert (PACKAGE / 'resource' / name).exists()
    assert f"NAME = '{name}'" in (PACKAGE / 'setup.py').read_text()
    assert (PACKAGE / 'setup.cfg').read_text().count(f'$base/lib/{name}') == 2


def test_given_a_function_of_one_s_own_then_the_campaign_comes_with_its_interval(mine):
    # One of the two scenes begins beyond 3.7 m.
    half = {'specs': ['never=always(abs(cte) < 3.7 m)'], 'at_least': 0.5, 'seed': 7}
    campaign = run(mine, controller='mine.py:steer', **half)
    assert campaign.folder == mine / 'campaign-1'
    assert list(campaign.rows['outcome']) == ['FAIL', 'PASS']
    assert (campaign.facts['controller'], campaign.facts['seed']) == ('mine.py:steer', 7)
    assert campaign.rates['failed'].rate.other.low == pytest.approx(0.0126, abs=0.001)
    with pytest.raises(AssertionError, match=r'^1 of 2 scenes .* 51% wanted'):
        run(mine, **{**half, 'at_least': 0.51})


def test_given_just_the_share_that_is_wanted_then_it_passes():
    for passed, runs, share in ((14, 25, 0.56), (29, 100, 0.29), (3, 3, 1.0), (57, 1000, 0.057)):
        rows = [types.SimpleNamespace(index=n, outcome=Outcome.PASS if n < passed else Outcome.FAIL)
                for n in range(runs)]
        recorded = types.SimpleNamespace(rows=rows)
        _judge(types.SimpleNamespace(recorded=recorded), runs, share, '')


@pytest.mark.nightly
def test_given_a_network_in_onnx_then_it_drives(mine):
    network = onnx_samples.save(mine)
    campaign = run(mine, perception=str(network), at_least=0.01, specs=['cte < 1000'])
    assert campaign.facts['perception'] == str(network)


@pytest.mark.nightly
@pytest.mark.ros
def test_given_too_few_satisfied_then_they_are_named_with_the_command_that_repeats_one(mine):
    with pytest.raises(AssertionError) as failed:
        run(mine, specs=['never=always(abs(cte) < 0.01 m)'], at_least=0.5)
    first, *rows, again, why = str(failed.value).splitlines()
    assert first == '0 of 2 scenes of s_falsif.scenic satisfied (95 % interval 0%-84%), 50% ' \
        'wanted; 0 without a verdict'
    assert [re.match(r' +(\d)  FAIL  rho ', row)[1] for row in rows] == ['0', '1']
    assert why == f'to find the causes: taxinet why {mine}/campaign-1'
    program, *words = shlex.split(again.removeprefix('to repeat one: '))
    assert program == 'taxinet'
    assert words[:3] == ['run', '--from', f'{mine}/campaign-1/s_falsif-s0-00000']
    done = taxinet(*words, cwd=mine)
    assert (done.returncode, done.stdout.splitlines()[-1][:9]) == (0, 'the same:'), done.stderr


@pytest.mark.nightly
def test_given_runs_without_a_verdict_then_no_share_is_enough(mine):
    with pytest.raises(AssertionError, match=r'^0 of 2 scenes .*; 2 without a verdict') as failed:
        run(mine, controller='mine.py:fails', at_least=0.01)
    assert 'INFRA_ERROR' in str(failed.value)
    assert 'mine.py:4: ZeroDivisionError' in str(failed.value)


@pytest.mark.parametrize(('given', 'says'), [
    ({'at_least': 95}, 'at_least=95: a share, within 0..1'),
    ({'perception': 'nobody'}, "perception: 'nobody' is unknown"),
    ({'settings': {'colour': 'red'}}, 'colour'),
])
def test_given_what_cannot_be_then_it_is_refused_and_no_test_passes(mine, given, says):
    with pytest.raises(UsageError, match=says) as refused:
        run(mine, **given)
    assert '\n' not in str(refused.value)


@pytest.mark.ros
def test_given_actions_of_launch_then_they_begin_on_a_domain_that_the_campaign_gets(monkeypatch):
    class Action(tuple):
        def __new__(cls, *words):
            return super().__new__(cls, words)

    for name, given in {
        'launch': {'LaunchDescription': list},
        'launch.actions': {'SetEnvironmentVariable': Action},
        'launch_testing': {}, 'launch_testing.actions': {'ReadyToTest': Action},
    }.items():
        module = types.ModuleType(name)
        vars(module).update(given)
        monkeypatch.setitem(sys.modules, name, module)
    description, arguments = launch_test('node')
    (name, domain), discovery, node, ready = description
    assert (name, discovery) == ('ROS_DOMAIN_ID', ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST'))
    assert (node, ready) == ('node', ())
    assert [*arguments] == ['taxinet_campaign']
    assert arguments['taxinet_campaign'].keywords == {'domain': int(domain)}


CASE = """
import sys
import unittest

from launch.actions import ExecuteProcess
from taxinet_ros.testing.campaign import launch_test


def generate_test_description():
    command = [sys.executable, {program!r}, '--ros-args', '-r', '__node:=perception']
    return launch_test(ExecuteProcess(cmd=command))


class TestDrives(unittest.TestCase):
    def test_on_the_runway(self, taxinet_campaign):
        campaign = taxinet_campaign(
            's_falsif', perception='external', runs=1, at_least=1.0, specs=['on_runway'],
            settings={{'duration': 1}},
        )
        self.assertEqual(campaign.facts['perception'], 'external')
"""


@pytest.mark.ros
@pytest.mark.nightly
@pytest.mark.skipif(
    find_spec('launch_testing') is None,
    reason='launch_testing is not installed, and does not come as a wheel',
)
def test_given_launch_testing_then_a_node_of_a_launch_description_drives(tmp_path):
    (tmp_path / 'case.py').write_text(
        CASE.format(program=str(PACKAGE / 'my_perception_package' / 'perception.py'))
    )
    done = subprocess.run(
        [sys.executable, '-m', 'launch_testing.launch_test', 'case.py'], cwd=tmp_path, text=True,
        capture_output=True, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
