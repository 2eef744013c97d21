"""What Fast DDS is told for every node of ours: to ask early for what was lost on its way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import taxinet_ros.nodes

PROFILE = Path(taxinet_ros.nodes.__file__).with_name('dds.xml')
NODE = """
import os, rclpy
from taxinet_ros.nodes.ground_truth_perception import GroundTruthPerception
rclpy.init(); node = GroundTruthPerception(); node.destroy_node(); rclpy.shutdown()
print(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'])
"""


@pytest.mark.ros
@pytest.mark.parametrize('own', ['', 'own.xml'])
def test_given_a_node_then_fast_dds_takes_our_profile_and_a_users_own_stays(own, tmp_path):
    given = {name: word for name, word in os.environ.items() if 'FASTRTPS' not in name}
    if own:
        (tmp_path / own).write_text(PROFILE.read_text())
        given['FASTRTPS_DEFAULT_PROFILES_FILE'] = own
    done = subprocess.run(
        [sys.executable, '-c', NODE], cwd=tmp_path, env={**given, 'ROS_DOMAIN_ID': '102'},
        text=True, capture_output=True, check=False,
    )
    # It complains of each line that it does not know.
    assert (done.stdout.strip(), done.stderr) == (own or str(PROFILE), '')


def test_the_profile_has_lost_messages_asked_for_well_before_an_end_in_order_is_over():
    found = ElementTree.parse(PROFILE).findall('.//{*}heartbeatPeriod')
    (period_s,) = (
        int(one.findtext('{*}sec')) + int(one.findtext('{*}nanosec')) / 1e9 for one in found
    )
    assert 0.05 <= period_s <= 0.5
