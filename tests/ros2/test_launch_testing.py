"""The graph under launch_testing, as ``colcon test`` has packages test theirs."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from taxinet_ros.nodes.running.domain import own_domain


@pytest.mark.ros
@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ('launch_ros', 'launch_testing'))),
    reason='launch_ros and launch_testing are not installed, and do not come as wheels',
)
def test_given_launch_testing_then_a_campaign_of_the_launch_file_ends_well(tmp_path):
    with own_domain() as domain:
        done = subprocess.run(
            [sys.executable, '-P', '-m', 'launch_testing.launch_test',
             str(Path(__file__).with_name('graph_launch.py'))],
            cwd=tmp_path, capture_output=True, text=True, check=False,
            env={
                **os.environ, 'ROS_DOMAIN_ID': str(domain), 'ROS_LOG_DIR': str(tmp_path),
                'AMENT_PREFIX_PATH': f'{sys.prefix}:{os.environ.get("AMENT_PREFIX_PATH", "")}',
            },
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'Ran 1 test' in done.stderr
