"""Who is there first does not count: the ends of a run's nodes have to have found each other."""

from types import SimpleNamespace

import pytest
from graph_runs import on_own_domain
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from taxinet_ros.core import topics
from taxinet_ros.nodes.interface import LOCKSTEP, Topic
from taxinet_ros.nodes.running.domain import heard_by, hears

TALK = Topic(
    name='t', type_name='std_msgs/msg/String', quality=topics.LOCKSTEP, publishers=('one',),
    subscribers=('other',), recorded=None, carries='words',
)
NODES = ('one', 'other')
LATCHED_ONLY = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def end(node_name, qos=LOCKSTEP):
    return SimpleNamespace(node_name=node_name, qos_profile=qos)


def publisher(matched):
    return SimpleNamespace(
        topic_name='/t', qos_profile=LOCKSTEP, get_subscription_count=lambda: matched
    )


def knowing(*ends):
    return SimpleNamespace(get_subscriptions_info_by_topic=lambda topic: list(ends))


@pytest.mark.parametrize(('matched', 'known', 'heard'), [
    (0, [], False),
    (1, [end('echo')], False),
    (1, [end('echo'), end('recorder')], False),
    (2, [end('echo'), end('recorder')], True),
    (1, [end('recorder')], True),
    (1, [end('recorder'), end('latched_echo', LATCHED_ONLY)], True),
])
def test_given_an_outsider_then_a_topic_is_heard_when_the_named_node_is_matched(
    matched, known, heard
):
    assert heard_by(knowing(*known), publisher(matched), {'recorder'}) is heard


@pytest.mark.ros
def test_given_real_nodes_then_both_ends_know_when_they_have_found_each_other():
    with on_own_domain(SingleThreadedExecutor) as spinning:
        executor, context = spinning.executor, spinning.context
        one, other, echo = (Node(name, context=context) for name in ('one', 'other', 'echo'))
        for node in (one, other, echo):
            spinning.add(node)
        speaks = one.create_publisher(String, 't', LOCKSTEP)
        echo.create_subscription(String, 't', print, LOCKSTEP)
        while speaks.get_subscription_count() < 1:
            executor.spin_once(timeout_sec=0.1)
        assert not heard_by(one, speaks, {'other'}), 'the echo is not taken for it'
        listens = other.create_subscription(String, 't', print, LOCKSTEP)
        while not (heard_by(one, speaks, {'other'}) and hears(other, listens, TALK, NODES)):
            executor.spin_once(timeout_sec=0.1)
        assert speaks.get_subscription_count() == 2
