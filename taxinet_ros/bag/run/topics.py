"""Topic and frame names of a run's bag, for reading without ROS."""

from __future__ import annotations

from taxinet_ros.bag.topics import TopicInfo, describe_topic
from taxinet_ros.core import topics

SCENARIO = topics.SCENARIO.name
NODE_STATUS = topics.NODE_STATUS.name
CLOCK = topics.CLOCK.name.lstrip('/')
IMAGE = topics.IMAGE.name
CAMERA2 = topics.CAMERA2.name
CAMERA_INFO = topics.CAMERA_INFO.name
ODOMETRY = topics.ODOMETRY.name
TRUTH = topics.TRUTH.name
ESTIMATE = topics.ESTIMATE.name
COMMAND = topics.COMMAND.name
ROBUSTNESS = topics.ROBUSTNESS.name
VERDICT = topics.VERDICT.name
RUN_STATUS = topics.RUN_STATUS.name
TF = topics.TF.name
TF_STATIC = topics.TF_STATIC.name

NODE_READY, RUN_ENDED = 0, 2
"""States of ``NodeStatus`` and of ``RunStatus``."""
SIMULATOR = 'simulator'
"""Name of the node that reports a run's timing."""

MAP_FRAME = 'map'
BASE_FRAME = 'base_link'
CAMERA_FRAME, CAMERA2_FRAME = 'camera_optical', 'camera2_optical'

ONCE = frozenset(
    topic.name for topic in (*topics.TOPICS, *topics.TRANSFORMS)
    if topic.recorded and not topic.each_step
)
"""Topics whose messages belong to no control step."""


def is_topic(name: str, relative: str) -> bool:
    """Whether ``name`` is the topic ``relative`` in any namespace."""
    return name == relative or name.endswith('/' + relative)


def topic_info(topic: topics.Topic) -> TopicInfo:
    """A topic of ours with the installed definition of its type, for serialising and decoding."""
    return describe_topic(name=topic.name, type_name=topic.type_name, qos='')


def is_of_sensors(name: str) -> bool:
    """Whether a topic has measurements of sensors beside the camera, in any namespace."""
    return any(
        is_topic(name, topic.name) for topic in (*topics.SENSORS.values(), topics.CAMERA2_INFO))


def is_of_frames(name: str) -> bool:
    """Whether a topic has transforms, which are derived from odometry and shared with others."""
    return is_topic(name, TF) or is_topic(name, TF_STATIC)
