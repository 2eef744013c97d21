"""Publishers and subscribers of a graph's topics: who is matched, who is missing, who is too many.

A publisher must be matched with every node that needs its messages. Counting is not enough: an
earlier ``ros2 topic echo`` would be counted as a node of the run, and that node would miss the
run's first messages.

On each topic of a run every publisher of the table speaks exactly once. rclpy does not report who
sent a message; so this is required before the first step, and again before the verdict. One that
comes between two checks and leaves before the next is noticed by the subscriptions of its topic.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import SIMULATOR, Topic

NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Node name that rmw returns for an endpoint whose name is not known yet."""
_NAME_WAIT_S, _NAME_PERIOD_S = 0.5, 0.02


def heard_by(node: Node, publisher: Publisher, names: Collection[str]) -> bool:
    """Whether a publisher is matched with all of the given nodes."""
    matched = publisher.get_subscription_count()
    if matched < len(names):  # Much cheaper than the check below, and called often.
        return False
    ends = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(fits(publisher.qos_profile, end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting


def hears(
    node: Node, subscription: Subscription, topic: Topic, participants: Sequence[str]
) -> bool:
    """Whether a subscription is matched with each publisher of a run, and there is no other."""
    matched = subscription.get_publisher_count()
    if matched < len(_wanted(topic, participants)):  # as above
        return False
    if not has_its_publishers(node, topic, participants):
        return False
    ends = node.get_publishers_info_by_topic(topic.name)
    return bool(matched >= sum(fits(end.qos_profile, subscription.qos_profile) for end in ends))


def has_its_publishers(node: Node, topic: Topic, participants: Sequence[str]) -> bool:
    """Whether each publisher of a run is there exactly once, and no other.

    The endpoint of a killed node remains until DDS drops it after about 20 s; until then it cannot
    be distinguished from a live one.
    """
    names = [end.node_name for end in node.get_publishers_info_by_topic(topic.name)]
    wanted = _wanted(topic, participants)
    return not _extra(names, topic, wanted) and all(names.count(name) == 1 for name in wanted)


def absent_publishers(node: Node, topic: Topic, participants: Sequence[str]) -> set[str]:
    """Publishers of a run that are missing."""
    names = {end.node_name for end in node.get_publishers_info_by_topic(topic.name)}
    return _wanted(topic, participants) - names


def intruder(node: Node, topic: Topic, participants: Sequence[str]) -> tuple[str, str] | None:
    """A publisher that is one too many on a topic of a run: its node, and a line on it."""
    wanted = _wanted(topic, participants)
    names = publisher_names(node, topic)
    if others := _extra(names, topic, wanted):
        name = min(others)
        return name, f'publishes {topic.name}, which is for {" and ".join(sorted(wanted))}'
    counts = Counter(name for name in names if name in wanted)
    doubled = [name for name, count in sorted(counts.items()) if count > 1]
    if doubled:
        return doubled[0], f'a second node of this name publishes {topic.name}'
    return None


def second_publisher_events(
    topic: Topic, on_second: Callable[[Topic], None]
) -> SubscriptionEventCallbacks:
    """Events of a subscription that report a publisher beside the one of the table, however brief.

    Args:
        topic: its topic; one of several publishers has none to report.
        on_second: called with the topic when another publisher is matched.
    """
    present = 0

    def matched(now: Any) -> None:
        nonlocal present
        before, present = present, now.current_count
        # A publisher that was lost on a busy machine comes back where there is none.
        if before and now.total_count_change:
            on_second(topic)

    alone = len(topic.publishers) == 1
    return SubscriptionEventCallbacks(matched=matched if alone else None)


def brief_intruder(node: Node, topic: Topic, participants: Sequence[str]) -> tuple[str, str]:
    """As :func:`intruder`, of a topic on which a second publisher was just matched."""
    wanted = min(_wanted(topic, participants))
    left = wanted, f'a second publisher of {topic.name} came and left'
    return intruder(node, topic, participants) or left


def publisher_names(node: Node, topic: Topic) -> list[str]:
    """Node of each publisher of a topic; a name may become known only shortly after its end."""
    deadline = time.monotonic() + _NAME_WAIT_S
    while True:
        names = [str(end.node_name) for end in node.get_publishers_info_by_topic(topic.name)]
        if NAMELESS not in names or time.monotonic() > deadline:
            return names
        time.sleep(_NAME_PERIOD_S)  # The middleware's threads discover the name meanwhile.


def _wanted(topic: Topic, participants: Sequence[str]) -> set[str]:
    """Nodes of a run that publish on a topic, with one publisher each.

    If none of them takes part, the node acting as simulator replaces them, as in a replay.
    """
    return topic.speakers(participants) or {SIMULATOR}


def _extra(names: Collection[str], topic: Topic, wanted: set[str]) -> set[str]:
    """Foreign nodes; those of the graph that take no part in the run publish nothing in it."""
    return set(names) - wanted - set(topic.publishers)


def fits(offered: Any, asked: Any) -> bool:
    """Whether these QoS profiles of a publisher and a subscription are compatible."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)


End = tuple[int, ...]
"""Unique identifier (GID) of a publisher or subscription, never reused."""
# A perception or a recorder chooses its inputs at start-up.
_CHOSEN = {
    interface.IMAGE.name: {interface.PERCEPTION, interface.RECORDER},
    interface.TRUTH.name: {interface.PERCEPTION},
}


def missing_nodes(node: Node, names: Sequence[str], gone: Collection[End] = ()) -> dict[str, str]:
    """Nodes that are missing or incomplete without the endpoints ``gone``, each with the reason."""
    why: dict[str, str] = {}
    for topic in interface.TOPICS:
        speakers, listeners = (
            [end for end in ends if tuple(end.endpoint_gid) not in gone]
            for ends in _ends(node, topic)
        )
        expected = (
            ('publish', speakers, topic.speakers(names)),
            ('subscribe to', listeners, topic.listeners(names) - _CHOSEN.get(topic.name, set())),
        )
        for verb, ends, wanted in expected:
            for name in wanted & set(names) - {end.node_name for end in ends}:
                why.setdefault(name, f'does not {verb} {topic.name}')
        for name in _misfits(speakers, listeners, set(names)):
            why.setdefault(name, f'incompatible quality of service on {topic.name}')
    return why


def why_silent(node: Node, name: str, names: Sequence[str]) -> str:
    """Reason why a node of a graph is silent, or '': a missing topic or incompatible endpoint."""
    if why := missing_nodes(node, names).get(name):
        return why
    inputs = [topic for topic in interface.TOPICS if name in _CHOSEN.get(topic.name, ())]
    heard = any(name == end.node_name for topic in inputs for end in _ends(node, topic)[1])
    if heard or name != interface.PERCEPTION:
        return ''
    return f'does not subscribe to {" or ".join(topic.name for topic in inputs)}'


def ends_of(node: Node, name: str) -> set[End]:
    """All known endpoints of a node of a graph."""
    return {
        tuple(end.endpoint_gid)
        for topic in interface.TOPICS for ends in _ends(node, topic) for end in ends
        if end.node_name == name
    }


def _ends(node: Node, topic: Topic) -> tuple[list[Any], list[Any]]:
    return (
        node.get_publishers_info_by_topic(topic.name),
        node.get_subscriptions_info_by_topic(topic.name),
    )


def _misfits(speakers: list[Any], listeners: list[Any], names: set[str]) -> Iterator[str]:
    """Nodes with a subscription incompatible with a publisher of the graph."""
    for speaker in speakers:
        for listener in listeners:
            ours = {speaker.node_name, listener.node_name} <= names
            if ours and not fits(speaker.qos_profile, listener.qos_profile):
                yield str(listener.node_name)
