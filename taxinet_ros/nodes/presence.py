"""Who is in a graph, with which ends of which topics, as somebody beside it sees it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

from rclpy.node import Node

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.matching import fits

End = tuple[int, ...]
"""The identifier of one publisher or subscription, which is never used again."""

# Which of its possible inputs a perception or a recorder takes, it decides when it starts.
_CHOSEN = {
    interface.IMAGE.name: {interface.PERCEPTION, interface.RECORDER},
    interface.TRUTH.name: {interface.PERCEPTION},
}


def missing(node: Node, names: Sequence[str], gone: Collection[End] = ()) -> dict[str, str]:
    """What keeps a graph from being whole: for each node that is not all there, why, in words.

    Args:
        node: who looks.
        names: of the nodes that belong to the graph.
        gone: ends that are known to belong to processes that died, and linger.
    """
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
            why.setdefault(name, f'quality of service does not fit on {topic.name}')
    return why


def ends_of(node: Node, name: str) -> set[End]:
    """All ends that a node of a graph is known to have."""
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
    """Nodes of the graph that subscribe where another one of it cannot reach them."""
    for speaker in speakers:
        for listener in listeners:
            ours = {speaker.node_name, listener.node_name} <= names
            if ours and not fits(speaker.qos_profile, listener.qos_profile):
                yield str(listener.node_name)
