"""Whether the two ends of a topic have found each other.

Counting is not enough: an ``ros2 topic echo`` that was there first would be taken for a node of
the run, and the run's first messages would pass that node by.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
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
    return _found(
        publisher.get_subscription_count(), names,
        lambda: node.get_subscriptions_info_by_topic(publisher.topic_name),
        lambda other: fits(publisher.qos_profile, other),
    )


def hears_from(node: Node, subscription: Subscription, names: Collection[str]) -> bool:
    """Whether a subscription knows the publishers of all of some nodes.

    Args:
        node: that the subscription belongs to.
        subscription: the listening end.
        names: of the nodes that must be heard.
    """
    return _found(
        subscription.get_publisher_count(), names,
        lambda: node.get_publishers_info_by_topic(subscription.topic_name),
        lambda other: fits(other, subscription.qos_profile),
    )


def fits(offered: Any, asked: Any) -> bool:
    """Whether quality of service lets a publisher and a subscription of these profiles connect."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)


def _found(
    matched: int, names: Collection[str], known: Callable[[], Sequence[Any]],
    fit: Callable[[Any], bool],
) -> bool:
    """Whether as many ends are matched as are known and fit, all named ones among them.

    Args:
        matched: number of other ends that are connected.
        names: of nodes that must have one of them.
        known: the other ends as the graph knows them.
        fit: whether quality of service lets an end with the given profile connect.
    """
    if matched < len(names):  # Far cheaper than what follows, and asked many times.
        return False
    ends = known()
    fitting = sum(fit(end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting
