"""Foxglove's own packages read a run's bag.

Needs Node and, in ``NODE_PATH`` or an enclosing ``node_modules``: ``npm install @mcap/core
@foxglove/rosmsg @foxglove/rosmsg2-serialization fzstd``.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from whole_runs import STEPS, run_messages, write_run

from taxinet_ros.bag.trace import read_trace

READER = Path(__file__).with_name('read_with_mcap_core.cjs')
NODE = shutil.which('node')


def has_packages() -> bool:
    words = ['node', '-e', "require('@mcap/core'); require('@foxglove/rosmsg2-serialization')"]
    return NODE is not None and subprocess.run(
        words, capture_output=True, cwd=READER.parent, check=False
    ).returncode == 0


@pytest.mark.skipif(NODE is None, reason='no Node on this machine')
def test_given_a_run_when_foxgloves_packages_read_it_then_values_are_the_same(
    tmp_path: Path,
) -> None:
    if not has_packages():
        pytest.skip('no @mcap/core; see the head of this file for what to install')
    bag = write_run(tmp_path / 'run')
    done = subprocess.run(
        ['node', str(READER), str(bag)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, '')
    read = json.loads(done.stdout)
    assert read['profile'] == 'ros2'
    assert sum(read['counts'].values()) == len(run_messages())
    assert read['counts']['/camera/image_raw'] == STEPS
    assert read['angles'] == read_trace(bag)['steering_rad'].tolist()
    assert read['attachments'] == ['manifest.json', 'scenario.json']
