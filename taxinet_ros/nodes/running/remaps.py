"""Detect remaps that separate a node from the rest of its graph, which ROS accepts silently."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from rclpy.node import Node

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import PARTICIPANTS, SIMULATOR, Topic

_TOPICS = (*interface.TOPICS, interface.OBITUARY)


def cut_off(node: Node) -> list[str]:
    """One line for each topic of the table on which a remap separates the node from its peers.

    A remap separates a node if its peers are found on another topic and not on its own. So a remap
    shared by all nodes does not, and the first node of a graph reports none yet.
    """
    spoken = {end.topic_name for end in node.publishers}
    heard = {end.topic_name for end in node.subscriptions}
    space = node.get_namespace().rstrip('/')
    lines = []
    for topic in _TOPICS:
        own = node.resolve_topic_name(topic.name)
        # A graph in a namespace has all topics in it, including the clock, whose name is absolute.
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
    """Topics that nodes use instead of one of the table, after a remap or in another namespace.

    Args:
        node: the observing node.
        topic: topic of the table.
        names: names of the nodes.
        publish: whether they publish; else they subscribe.

    Returns:
        Name of the node, and a topic of the same type that is neither in the table nor part of
        another complete graph.
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
    """All endpoints of one kind on an absolute topic."""
    # By its DDS name, since rclpy would apply the remap rules of the observing node to others.
    if publish:
        return list(node.get_publishers_info_by_topic(f'rt{topic}', no_mangle=True))
    return list(node.get_subscriptions_info_by_topic(f'rt{topic}', no_mangle=True))
