"""Who can be on a ROS domain, as the machine's UDP ports tell it."""

from __future__ import annotations

from unittest.mock import Mock

import psutil
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from taxinet_ros.nodes import dds_ports, domain
from taxinet_ros.nodes.dds_ports import anybody_here
from taxinet_ros.nodes.domain import own_domain, refuse_neighbours


def test_given_a_domain_then_its_ports_tell_whether_a_node_is_there():
    with own_domain() as number:
        assert anybody_here(number) is False
        context = Context()
        rclpy.init(context=context, domain_id=number)
        node = Node('somebody', context=context)
        try:
            assert anybody_here(number)
        finally:
            node.destroy_node()
            rclpy.try_shutdown(context=context)


def test_given_another_middleware_or_system_then_nothing_is_sure(monkeypatch):
    with own_domain() as number:
        with monkeypatch.context() as patch:
            patch.setattr(dds_ports, 'get_rmw_implementation_identifier', lambda: 'rmw_zenoh_cpp')
            assert anybody_here(number) is None
        monkeypatch.setattr(psutil, 'net_connections', Mock(side_effect=psutil.AccessDenied))
        assert anybody_here(number) is None


def test_given_nobody_there_then_only_who_may_be_on_other_machines_is_looked_for(monkeypatch):
    looked: list[float] = []
    monkeypatch.setattr(domain, 'clock_keepers', lambda _: looked.append(1.0) or [])
    monkeypatch.setattr(domain, '_LOOK_FAR_S', 0.1)
    with own_domain() as number:
        refuse_neighbours(number)
        assert not looked
        monkeypatch.setenv('ROS_STATIC_PEERS', '192.0.2.1')
        refuse_neighbours(number)
        assert looked
