"""Remaps that part a node from the rest of its graph, which ROS takes without a word."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rclpy.node import Node

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import PARTICIPANTS, SIMULATOR, Topic

_TOPICS = (*interface.TOPICS, interface.OBITUARY)


def cut_off(node: Node) -> list[str]:
    """What remaps have parted a node from, a line for each topic of the table.

    A remap parts a node where those whom it is to meet are found on another topic, and not on its
    own: one that all nodes share does not, and the first node that is up knows of none yet.
    """
    spoken = {end.topic_name for end in node.publishers}
    heard = {end.topic_name for end in node.subscriptions}
    space = node.get_namespace().rstrip('/')
    lines = []
    for topic in _TOPICS:
        own = node.resolve_topic_name(topic.name)
        # A graph in a namespace has all topics there, also the clock, whose name is absolute.
        if own in (node.resolve_topic_name(topic.name, only_expand=True),
                   f'{space}/{topic.name.lstrip("/")}'):
            continue
        partners = (
            (heard, True, set(topic.publishers), 'publishes'),
            (spoken, False, topic.listeners(PARTICIPANTS) | {*topic.subscribers}, 'subscribes to'),
        )
        for ours, publish, names, verb in partners:
            there = {end.node_name for end in _ends(node, own, publish=publish)}
            if own not in ours or there & names - {node.get_name()}:
                continue
            for name, other in elsewhere(node, topic, names - {node.get_name()}, publish=publish):
                lines.append(f'{topic.name} is remapped to {own}, but {name} {verb} {other}')
                break
    return lines


def elsewhere(
    node: Node, topic: Topic, names: Collection[str], *, publish: bool
) -> list[tuple[str, str]]:
    """What nodes have in the place of a topic of the table, after a remap or in another namespace.

    Args:
        node: who looks.
        topic: of the table.
        names: of the nodes.
        publish: whether they publish, or subscribe.

    Returns:
        Name of the node, and a topic of the same type that is none of the table and of no other
        whole graph.
    """
    graphs = {
        space for name, space in node.get_node_names_and_namespaces()
        if name == SIMULATOR and space != node.get_namespace()
    }
    known = {node.resolve_topic_name(one.name) for one in _TOPICS}
    return [
        (str(end.node_name), other)
        for other, types in node.get_topic_names_and_types()
        if topic.type_name in types and other not in known
        for end in _ends(node, other, publish=publish)
        if end.node_name in names and end.node_namespace not in graphs
    ]


def _ends(node: Node, topic: str, *, publish: bool) -> list[Any]:
    """All ends of one kind on an absolute topic."""
    # By its name in DDS: to any other rclpy would apply the rules of the node that looks.
    if publish:
        return list(node.get_publishers_info_by_topic(f'rt{topic}', no_mangle=True))
    return list(node.get_subscriptions_info_by_topic(f'rt{topic}', no_mangle=True))
