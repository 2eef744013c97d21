"""One topic of any type: waits for its publisher, then hears it and reads signals off it."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.field_path import check_field
from taxinet_ros.core.signal_source import SignalSource
from taxinet_ros.nodes.convert import stamp_of
from taxinet_ros.nodes.topic_types import (
    fields_of,
    matching_qos,
    message_class,
    offered_type,
    qos_words,
)

Readings = Mapping[str, tuple[float, str]]
OnMessage = Callable[[str, int | None, Readings], None]
"""Takes the topic, the header's stamp [ns] or None, and value and trouble of each signal."""


class TopicReader:
    """Hears one topic as soon as somebody publishes it, with the quality of service offered.

    Attributes:
        topic: full name of the topic.
        sources: the signals that are read from it.
        type_name: its type, or '' before there is a publisher.
        received: number of messages heard.
    """

    def __init__(
        self, node: Node, topic: str, sources: Sequence[SignalSource], on_message: OnMessage
    ) -> None:
        """Wait for a publisher; nothing is heard before :meth:`look` finds one."""
        self.topic = topic
        self.sources = tuple(sources)
        self.type_name = ''
        self.received = 0
        self._node = node
        self._on_message = on_message
        self._qos: QoSProfile | None = None
        self._heard: Subscription | None = None
        self._stamped = False

    @property
    def qos(self) -> str:
        """The quality of service that it is heard with, or ''."""
        return qos_words(self._qos) if self._qos is not None else ''

    def look(self) -> bool:
        """Look who publishes, and follow what they offer; whether the topic is heard.

        Raises:
            UsageError: the publishers disagree on the type, the type is not installed, or a signal
                reads a field that it does not have.
        """
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if self.type_name:
            publishers = [info for info in publishers if info.topic_type == self.type_name]
        if not publishers:
            return self._heard is not None
        if not self.type_name:
            self._identify(offered_type(self.topic, publishers))
        qos = matching_qos(publishers)
        if self._qos is None or self.qos != qos_words(qos):
            self._subscribe(qos)
        return True

    def absence(self) -> str:
        """What is awaited, in one line, with the name of a topic that may be meant."""
        names = ', '.join(source.name for source in self.sources)
        if self._heard is not None:
            return f'waiting for the first message on {self.topic} (signal {names})'
        topics = [name for name, _ in self._node.get_topic_names_and_types()]
        near = difflib.get_close_matches(self.topic, set(topics) - {self.topic}, 1)
        told = f'; did you mean {near[0]}?' if near else ''
        return f'waiting for a publisher of {self.topic} (signal {names}){told}'

    def _identify(self, type_name: str) -> None:
        try:
            fields = fields_of(type_name)
        except UsageError as error:
            raise UsageError(f'topic {self.topic}: {error}') from None
        for source in self.sources:
            try:
                check_field(source.path, type_name.replace('/msg/', '/'), fields_of)
            except UsageError as error:
                raise UsageError(f"parameter signals: '{source}': {error}") from None
        self._stamped = fields.get('header') == 'std_msgs/Header'
        self.type_name = type_name

    def _subscribe(self, qos: QoSProfile) -> None:
        if self._heard is not None:
            self._node.destroy_subscription(self._heard)
        self._qos = qos
        self._heard = self._node.create_subscription(
            message_class(self.type_name), self.topic, self._take, qos
        )
        self._node.get_logger().info(f'{self.topic}: {self.type_name}, {self.qos}')

    def _take(self, message: Any) -> None:
        self.received += 1
        stamp_ns = stamp_of(message.header.stamp) if self._stamped else None
        self._on_message(
            self.topic, stamp_ns, {source.name: source.read(message) for source in self.sources}
        )
