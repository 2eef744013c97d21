"""A node leaves for good: Fast DDS waits for callbacks with a limit, and before rmw asks it to."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from taxinet_ros.nodes.running import leave
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.leave import leave_graph

pytestmark = pytest.mark.ros
_GET_LISTENER = '_ZNK8eprosima7fastdds3dds17DomainParticipant12get_listenerEv'


def test_given_a_node_that_leaves_then_its_participant_has_no_listener_when_it_is_destroyed():
    calls = leave._calls()
    assert calls is not None, 'the functions of Fast DDS that we ship with are not found'
    get_listener = ctypes.CDLL('libfastrtps.so.2.14')[_GET_LISTENER]
    get_listener.argtypes, get_listener.restype = [ctypes.c_void_p], ctypes.c_void_p
    rmw_node, participant_of, _ = calls
    seen = []
    with own_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        node = Node('leaving', context=context)
        participant = participant_of(rmw_node(node.handle.pointer))
        seen.append(get_listener(participant))
        destroy = node.destroy_node

        def destroyed() -> None:
            seen.append(get_listener(participant))
            destroy()

        node.destroy_node = destroyed  # type: ignore[method-assign]
        leave_graph(node)
        rclpy.shutdown(context=context)
    assert seen[0]
    assert seen[1:] == [None]


_CROWD = """
import sys, time, rclpy
from rclpy.node import Node
from std_msgs.msg import String
from taxinet_ros.nodes.running.leave import leave_graph
rclpy.init()
node = Node(f'one_{sys.argv[1]}')
for number in range(20):
    node.create_publisher(String, f'topic_{sys.argv[1]}_{number}', 1)
while sum(name.startswith('one_') for name in node.get_node_names()) < int(sys.argv[2]):
    time.sleep(0.01)
print('whole', flush=True)
sys.stdin.read()  # all are let go at once
leave_graph(node)
rclpy.shutdown()
"""


@pytest.mark.nightly
def test_given_a_crowd_that_leaves_at_once_then_everybody_gets_out():
    crowd = 6
    with own_domain() as domain:
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
        nodes = [
            subprocess.Popen(
                [sys.executable, '-c', _CROWD, str(number), str(crowd)], env=environment,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )
            for number in range(crowd)
        ]
        for node in nodes:
            assert node.stdout is not None
            assert node.stdout.readline() == 'whole\n'
        for node in nodes:
            assert node.stdin is not None
            node.stdin.close()
        assert [node.wait() for node in nodes] == [0] * crowd
        for node in nodes:
            node.stdout.close()


def test_given_another_middleware_then_nodes_leave_without_its_functions(monkeypatch):
    leave._calls.cache_clear()
    monkeypatch.setattr(leave, 'get_rmw_implementation_identifier', lambda: 'rmw_zenoh_cpp')
    try:
        assert leave._calls() is None
        with own_domain() as domain:
            context = Context()
            rclpy.init(context=context, domain_id=domain)
            leave_graph(Node('leaving', context=context))
            rclpy.shutdown(context=context)
    finally:
        leave._calls.cache_clear()
