"""What is said step by step is taken as bytes and read here, which takes rclpy thrice as long.

rclpy makes a message field by field, and each field with defaults that are then replaced; the
reader that rosbags generates for a type makes it at once. Such an object has the message's fields,
but is of no ROS type: what is to be sent on has to be taken as a message.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from taxinet_ros.bag.decode import decoder
from taxinet_ros.bag.definitions import describe_topic
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic


def read_here(topic: Topic) -> bool:
    """Whether a topic is one of many messages, which is to be subscribed to as raw."""
    return topic.each_step or topic is interface.PROGRESS


def reader_of(topic: Topic) -> Callable[[Any], Any]:
    """From what a subscription gives, raw where :func:`read_here`, to the message's fields.

    The reader raises :class:`~taxinet_ros.bag.errors.BagCorrupt` where bytes are no message of the
    topic's type.
    """
    if not read_here(topic):
        return _as_it_is
    return decoder(describe_topic(name=topic.name, type_name=topic.type_name, qos=''))


def _as_it_is(message: Any) -> Any:
    return message
