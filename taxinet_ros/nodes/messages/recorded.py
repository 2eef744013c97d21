"""The topics of a bag: messages published as they are stored."""

from __future__ import annotations

import importlib
import time
from collections.abc import Collection

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.playback import Check, Portion, message_check, recorded_quality
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.core.perception.network import IMAGE_SHAPE, usual_frame
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import time_of
from taxinet_ros.recordings.reader import IMAGES, picture, stamp_of

_DELIVERY_S = 5.0


class RecordedTopics:
    """Publishers of the topics of a bag; the clock is made if the bag has none.

    Attributes:
        publishers: publisher by recorded name.
        checks: check of a topic's bytes by recorded name.
        latched: recorded names of latched topics.
        count: number of messages published.
    """

    def __init__(
        self, node: Node, info: BagInfo, *, excluded: Collection[str], picture: str = ''
    ) -> None:
        """Create publishers; topics without a message class are skipped with a warning.

        Args:
            node: publishing node.
            info: table of contents of the bag.
            excluded: recorded names of topics to leave out.
            picture: recorded name of pictures to publish as frames of ours; '' for none.

        Raises:
            UsageError: nothing is left, or ``picture`` is no topic of pictures.
        """
        self._node, self._picture = node, picture
        self.publishers: dict[str, Publisher] = {}
        self.checks: dict[str, Check] = {}
        self.latched: set[str] = set()
        self.count = 0
        self._heard: set[str] = set()
        self._under_way: set[Publisher] = set()
        for topic in info.topics:
            if topic.name not in excluded:
                self._add(topic)
        if not self.publishers:
            raise UsageError(f'bag_player: no playable topics left in {info.path} to play')
        clock, self._own_clock = interface.CLOCK, None
        if not {clock.name} & (self.publishers.keys() | excluded):
            self._own_clock = node.create_publisher(clock.type, clock.name, clock.qos)

    def _add(self, topic: TopicInfo) -> None:
        check = message_check(topic) if topic.encoding == 'cdr' else None
        if check is None:
            why = 'is not installed' if topic.encoding == 'cdr' else f'in {topic.encoding}'
            self._node.get_logger().warning(
                f'skipping {topic.name}: {topic.type or "no type"} {why}'
            )
            return
        self.checks[topic.name] = check
        quality = recorded_quality(topic)
        if quality.latched:
            self.latched.add(topic.name)
        package, _, name = topic.type.split('/')
        kind, target = getattr(importlib.import_module(f'{package}.msg'), name), topic.name
        if topic.name == self._picture:
            if topic.type not in IMAGES:
                raise UsageError(f'bag_player: picture: {topic.name} is a {topic.type}')
            self._decode = decoder(topic)
            kind, target = interface.IMAGE.type, interface.IMAGE.name
        self.publishers[topic.name] = self._node.create_publisher(
            kind, relative(target), interface.qos_profile(quality)
        )

    def publish(self, portion: Portion) -> float:
        """Publish one portion; return the time [s] spent waiting for its delivery.

        Latched messages configure nodes for what follows, and a topic's first message confirms that
        both ends are matched, so nothing may overtake those.
        """
        waited = 0.0
        if self._own_clock is not None:
            self._own_clock.publish(Clock(clock=time_of(portion.stamp_ns)))
        for message in portion.messages:
            name = message.topic.name
            latched, first = name in self.latched, name not in self._heard
            if not latched:
                waited += _deliver(self._under_way)
                self._under_way.clear()
            publisher = self.publishers[name]
            publisher.publish(
                self._as_frame(message.cdr) if name == self._picture else message.cdr)
            self.count += 1
            self._heard.add(name)
            if latched:
                # Fast DDS requests acknowledgement every 3 s, so all are awaited together.
                self._under_way.add(publisher)
            elif first:
                waited += _deliver((publisher,))
        return waited

    def deliver(self) -> None:
        """Wait until reliable subscribers have acknowledged everything, with a time limit."""
        _deliver(self.publishers.values())

    def _as_frame(self, cdr: bytes) -> bytes:
        """A recorded picture as a frame of ours; black if it cannot be read."""
        message = self._decode(cdr)
        try:
            pixels = usual_frame(picture(message))
        except ValueError as error:
            self._node.get_logger().warning(f'a black frame: {error}', once=True)
            pixels = np.zeros(IMAGE_SHAPE, np.uint8)
        return image_cdr(pixels, stamp_of(message), message.header.frame_id)


def _deliver(publishers: Collection[Publisher]) -> float:
    """Wait until all is acknowledged, with a time limit; return the time waited [s]."""
    begun = time.monotonic()
    for publisher in publishers:
        left = max(0.0, begun + _DELIVERY_S - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=left))
    return time.monotonic() - begun


def relative(name: str) -> str:
    """Relative name to publish on, so that a namespace can be prepended."""
    return name if name == interface.CLOCK.name else name.lstrip('/')
