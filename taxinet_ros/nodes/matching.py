"""Whether the two ends of a topic have found each other.

Counting is not enough: an ``ros2 topic echo`` that was there first would be taken for a node of
the run, and the run's first messages would pass that node by.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription


def heard_by(node: Node, publisher: Publisher, names: Collection[str]) -> bool:
    """Whether whatever a publisher says now reaches all of some nodes.

    Args:
        node: that the publisher belongs to.
        publisher: the speaking end.
        names: of the nodes that must hear it.
    """
    matched = publisher.get_subscription_count()
    if matched < len(names):  # Far cheaper than what follows, and asked many times.
        return False
    known = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(_fits(publisher.qos_profile, one.qos_profile) for one in known)
    return set(names) <= {one.node_name for one in known} and matched >= fitting


def hears_from(node: Node, subscription: Subscription, names: Collection[str]) -> bool:
    """Whether a subscription knows the publishers of all of some nodes.

    Args:
        node: that the subscription belongs to.
        subscription: the listening end.
        names: of the nodes that must be heard.
    """
    matched = subscription.get_publisher_count()
    if matched < len(names):
        return False
    known = node.get_publishers_info_by_topic(subscription.topic_name)
    fitting = sum(_fits(one.qos_profile, subscription.qos_profile) for one in known)
    return set(names) <= {one.node_name for one in known} and matched >= fitting


def _fits(offered: Any, asked: Any) -> bool:
    return qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR
