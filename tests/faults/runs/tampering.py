"""What a node says, changed on its way out."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import stamp_of

PERIOD_NS = 100_000_000

Tamper = Callable[[int, Any], Iterable[Any]]
"""Given a control step and the message on it, the messages that go out in its place."""


class _Tampered:
    def __init__(self, publisher: Any, topic: Topic, tamper: Tamper) -> None:
        self._publisher, self._topic, self._tamper = publisher, topic, tamper

    def __getattr__(self, name: str) -> Any:
        return getattr(self._publisher, name)

    def publish(self, message: Any) -> None:
        if isinstance(message, bytes):
            message = deserialize_message(message, self._topic.type)
        stamp = message.clock if self._topic is interface.CLOCK else message.header.stamp
        for one in self._tamper(stamp_of(stamp) // PERIOD_NS, message):
            self._publisher.publish(one)


def tamper(graph: Any, topic: Topic, how: Tamper) -> None:
    """Have a topic's speaker in a composed graph say something else."""
    speaker = topic.publishers[0]
    node = next(node for node in graph.nodes if node.get_name() == speaker)
    if speaker == interface.SIMULATOR:
        speakers = node.ends.speakers
        speakers[topic.name] = _Tampered(speakers[topic.name], topic, how)
        return
    name = {interface.ESTIMATE.name: '_estimates', interface.COMMAND.name: '_commands'}[topic.name]
    setattr(node, name, _Tampered(getattr(node, name), topic, how))


def changed(message: Any, **values: Any) -> Any:
    """A copy of a message with other values in some of its fields."""
    other = copy.deepcopy(message)
    for name, value in values.items():
        setattr(other, name, value)
    return other


def cut_short(message: Any) -> bytes:
    """A message of which the end was lost."""
    return bytes(serialize_message(message)[:40])
