"""The short path of one's own nodes: run in a graph of processes, and checked."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest
from taxinet_process import taxinet, taxinet_apart

from taxinet_ros.bag.run.recording import open_recording

EXAMPLES = Path(__file__).parents[3] / 'examples'
PERCEPTION, CONTROLLER = (
    shlex.join([sys.executable, str(EXAMPLES / name)])
    for name in ('my_perception_package/my_perception_package/perception.py', 'own_controller.py')
)

pytestmark = pytest.mark.ros


def test_given_nodes_of_ones_own_then_they_drive_a_run_that_ends_with_a_verdict(tmp_path):
    done = taxinet(
        'run', 'nominal', '--perception', f'cmd:{PERCEPTION}', '--controller', f'cmd:{CONTROLLER}',
        '--images', 'none', '--set', 'duration=1', '--out', 'own', cwd=tmp_path,
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    run = open_recording(tmp_path / 'own' / 'nominal-s0-00000').run
    assert (run.perception, run.controller) == ('bright paint', 'proportional')


@pytest.mark.nightly
def test_given_a_controller_of_ones_own_when_checked_then_it_keeps_the_contract(tmp_path):
    done = taxinet_apart('check-node', CONTROLLER, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == 'controller: 14 kept, 0 broken, 0 not tried'
