"""Whether somebody is on a ROS domain, as the machine's UDP ports tell it.

What Fast DDS is told for every node of ours: to ask early for what was lost on its way.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from graph_runs import on_own_domain
from rclpy.node import Node

import taxinet_ros.nodes
from taxinet_ros.nodes.running import domain
from taxinet_ros.nodes.running.domain import in_use, own_domain, refuse_neighbours


def test_given_a_domain_then_its_ports_tell_whether_a_node_is_there():
    with own_domain() as number:
        assert not in_use(number)
        with on_own_domain(domain=number) as spinning:
            spinning.add(Node('somebody', context=spinning.context))
            assert in_use(number)


def test_given_nobody_there_then_only_who_may_be_on_other_machines_is_looked_for(monkeypatch):
    looked: list[float] = []
    monkeypatch.setattr(domain, '_clocks_on', lambda *_: looked.append(1.0) or [])
    with own_domain() as number:
        refuse_neighbours(number)
        assert not looked
        monkeypatch.setenv('ROS_STATIC_PEERS', '192.0.2.1')
        refuse_neighbours(number)
        assert looked


PROFILE = Path(taxinet_ros.nodes.__file__).with_name('dds.xml')
NODE = """
import os, rclpy
from taxinet_ros.nodes.ground_truth_perception import GroundTruthPerception
from taxinet_ros.nodes.running.leave import leave_graph
rclpy.init(); node = GroundTruthPerception(); leave_graph(node); rclpy.shutdown()
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
