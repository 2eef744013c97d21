"""Whether a publisher has found those that must hear it.

Counting is not enough: an ``ros2 topic echo`` that was there first would be taken for a node of
the run, and the run's first messages would pass that node by.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible


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
    ends = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(fits(publisher.qos_profile, end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting


def fits(offered: Any, asked: Any) -> bool:
    """Whether quality of service lets a publisher and a subscription of these profiles connect."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)
