"""A smoke test of the graph for launch_testing: ``launch_test tests/ros2/graph_launch.py``.

The launch file drives one short run with the true tracking error; every node ends with exit code 0,
and the run is in the table. ``test_launch_testing.py`` runs it in a process of its own, because
launch_testing's plug-in for pytest, which pyproject.toml turns off, is of another age than pytest.
"""

from __future__ import annotations

import csv
import tempfile
import unittest
from pathlib import Path

import launch
import launch_testing
import launch_testing.actions
import launch_testing.asserts
import pytest
from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

SHORT = '/**/scenario_sampler: {ros__parameters: {set: ["duration=1"]}}\n'
NODES = ('simulator', 'perception', 'steering_controller', 'mtl_monitor', 'recorder',
         'scenario_sampler')
HOME = tempfile.TemporaryDirectory()
OUT = Path(HOME.name, 'campaign')


@pytest.mark.launch_test
def generate_test_description() -> launch.LaunchDescription:
    parameters = Path(HOME.name, 'short.yaml')
    parameters.write_text(SHORT)
    words = {'perception': 'truth', 'scenario': 'nominal', 'runs': '1', 'out': str(OUT),
             'params': str(parameters)}
    source = Path(get_package_share_directory('taxinet_ros'), 'launch', 'taxinet.launch.py')
    return launch.LaunchDescription([
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(source)), launch_arguments=words.items()),
        launch_testing.actions.ReadyToTest(),
    ])


class TestRunning(unittest.TestCase):

    def test_every_node_begins_and_the_campaign_ends_by_itself(self, proc_info):
        for node in NODES:
            proc_info.assertWaitForStartup(process=node, timeout=60)
        proc_info.assertWaitForShutdown(process='scenario_sampler', timeout=300)


@launch_testing.post_shutdown_test()
class TestEnded(unittest.TestCase):

    def test_all_ended_well_and_the_run_is_recorded(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)
        with (OUT / 'runs.csv').open() as table:
            (run,) = csv.DictReader(table)
        assert run['outcome'] == 'PASS'
        assert list(OUT.glob('*/*.mcap'))
