"""Read signals from one topic of any installed type, once it has a publisher."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.extras.live_monitor.signal_source import SignalSource, check_field
from taxinet_ros.nodes.messages.convert import stamp_of

_DEPTH = 1000
_TYPE = re.compile(r'(?P<package>[a-z][a-z0-9_]*)(?:/msg)?/(?P<name>[A-Z][A-Za-z0-9]*)')


def message_class(type_name: str) -> type[Any]:
    """Class of a message type, ``package/msg/Name`` or ``package/Name``.

    Type names come from the network, so only packages made by the ROS interface generators are
    imported.
    """
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise UsageError(f'{type_name} is not the name of a message type')
    package, name = match['package'], match['name']
    if not _is_interface_package(package):
        raise UsageError(
            f'type {type_name}: message package {package} is not installed; source its workspace'
        )
    found = getattr(importlib.import_module(f'{package}.msg'), name, None)
    if found is None or not hasattr(found, 'get_fields_and_field_types'):
        raise UsageError(f'type {type_name}: the installed {package} has no {name}')
    return found


def fields_of(type_name: str) -> Mapping[str, str]:
    """Types of a message's fields by name, in the generators' notation."""
    return message_class(type_name).get_fields_and_field_types()


def offered_type(topic: str, publishers: Sequence[TopicEndpointInfo]) -> str:
    """The common type of a topic's publishers."""
    types = sorted({info.topic_type for info in publishers})
    if len(types) != 1:
        raise UsageError(f'topic {topic} has publishers of {len(types)} types: {", ".join(types)}')
    return types[0]


def matching_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Strictest quality of service compatible with every publisher.

    Reliable if all are, else best effort; transient local if all are. A reader that requests more
    than a writer offers receives nothing from it.
    """
    offers = [info.qos_profile for info in publishers]
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def qos_words(qos: QoSProfile) -> str:
    """Reliability and durability as text."""
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return f'{"reliable" if reliable else "best effort"}, {"latched" if latched else "volatile"}'


def _is_interface_package(package: str) -> bool:
    spec = importlib.util.find_spec(package)  # for a top-level name, this does not execute it
    folders = (spec.submodule_search_locations if spec else None) or []
    return any(
        Path(folder, 'msg', '__init__.py').is_file()
        and any(Path(folder).glob(f'{package}_s__rosidl_typesupport_c*'))
        for folder in folders
    )


Readings = Mapping[str, tuple[float, str]]
OnMessage = Callable[[str, int | None, Readings], None]
"""Called with topic, header stamp [ns] or None, and value and problem of each signal."""


class TopicReader:
    """Subscribes to one topic once it has a publisher, with the quality of service offered.

    Attributes:
        topic: full name of the topic.
        sources: signals read from it.
        type_name: its type, or '' without a publisher.
        received: number of messages received.
    """

    def __init__(
        self, node: Node, topic: str, sources: Sequence[SignalSource], on_message: OnMessage
    ) -> None:
        """Prepare; nothing is received before :meth:`find_publishers` finds a publisher."""
        self.topic = topic
        self.sources = tuple(sources)
        self.type_name = ''
        self.received = 0
        self._node = node
        self._on_message = on_message
        self._qos: QoSProfile | None = None
        self._subscription: Subscription | None = None
        self._stamped = False

    @property
    def qos(self) -> str:
        """Quality of service of the subscription, or ''."""
        return qos_words(self._qos) if self._qos is not None else ''

    def find_publishers(self) -> bool:
        """Match the subscription to the current publishers; return whether there is one."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if self.type_name:
            publishers = [info for info in publishers if info.topic_type == self.type_name]
        if not publishers:
            return self._subscription is not None
        if not self.type_name:
            self._identify(offered_type(self.topic, publishers))
        qos = matching_qos(publishers)
        if self._qos is None or self.qos != qos_words(qos):
            self._subscribe(qos)
        return True

    def awaited(self) -> str:
        """One line on what is awaited, with a similar topic name if any."""
        names = ', '.join(source.name for source in self.sources)
        if self._subscription is not None:
            return f'waiting for the first message on {self.topic} (signal {names})'
        topics = [name for name, _ in self._node.get_topic_names_and_types()]
        hint = near_miss(self.topic, set(topics) - {self.topic})
        return f'waiting for a publisher of {self.topic} (signal {names}){hint}'

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
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._qos = qos
        self._subscription = self._node.create_subscription(
            message_class(self.type_name), self.topic, self._take, qos
        )
        self._node.get_logger().info(f'{self.topic}: {self.type_name}, {self.qos}')

    def _take(self, message: Any) -> None:
        self.received += 1
        stamp_ns = stamp_of(message.header.stamp) if self._stamped else None
        self._on_message(
            self.topic, stamp_ns, {source.name: source.read(message) for source in self.sources}
        )
