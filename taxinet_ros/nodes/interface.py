"""Topics of :mod:`taxinet_ros.core.topics` with rclpy message classes and QoS profiles."""

from __future__ import annotations

import functools
import importlib
from dataclasses import fields, replace
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from taxinet_msgs.action import RunScenario

from taxinet_ros.bag.run.topics import BASE_FRAME as BASE_FRAME
from taxinet_ros.bag.run.topics import CAMERA_FRAME as CAMERA_FRAME
from taxinet_ros.bag.run.topics import MAP_FRAME as MAP_FRAME
from taxinet_ros.core import topics
from taxinet_ros.core.topics import BESIDE as BESIDE
from taxinet_ros.core.topics import CHAIN as CHAIN
from taxinet_ros.core.topics import FOLLOWERS as FOLLOWERS
from taxinet_ros.core.topics import MTL_MONITOR as MTL_MONITOR
from taxinet_ros.core.topics import PARTICIPANTS as PARTICIPANTS
from taxinet_ros.core.topics import PER_NODE as PER_NODE
from taxinet_ros.core.topics import PER_RUN as PER_RUN
from taxinet_ros.core.topics import PER_SPEC as PER_SPEC
from taxinet_ros.core.topics import PER_STEP as PER_STEP
from taxinet_ros.core.topics import PERCEPTION as PERCEPTION
from taxinet_ros.core.topics import RECORDER as RECORDER
from taxinet_ros.core.topics import RUNTIME_MONITOR as RUNTIME_MONITOR
from taxinet_ros.core.topics import SCENARIO_SAMPLER as SCENARIO_SAMPLER
from taxinet_ros.core.topics import SCENE_MARKERS as SCENE_MARKERS
from taxinet_ros.core.topics import SIMULATOR as SIMULATOR
from taxinet_ros.core.topics import STEERING_CONTROLLER as STEERING_CONTROLLER
from taxinet_ros.core.topics import SUPERVISOR as SUPERVISOR


@functools.cache
def qos_profile(quality: topics.Quality) -> QoSProfile:
    """QoS profile of a quality of service; the same object each time."""
    return QoSProfile(
        depth=quality.depth, history=HistoryPolicy[quality.history.upper()],
        reliability=ReliabilityPolicy[quality.reliability.upper()],
        durability=DurabilityPolicy[quality.durability.upper()],
    )


class Topic(topics.Topic):
    """A topic with its message class and QoS profile."""

    @functools.cached_property
    def type(self) -> type[Any]:
        """The message class."""
        package, _, name = self.type_name.split('/')
        message: type[Any] = getattr(importlib.import_module(f'{package}.msg'), name)
        return message

    @functools.cached_property
    def qos(self) -> QoSProfile:
        """Quality of service of both ends, as recorded in bags."""
        return qos_profile(self.quality)

    @property
    def end_qos(self) -> QoSProfile:
        """QoS profile of both ends."""
        depth = self.queue or self.quality.depth
        return qos_profile(replace(self.quality, depth=depth))


@functools.cache
def _topic(row: topics.Topic) -> Topic:
    return Topic(**{field.name: getattr(row, field.name) for field in fields(row)})


LOCKSTEP = qos_profile(topics.LOCKSTEP)
NEWEST = qos_profile(topics.NEWEST)
LATCHED = qos_profile(topics.LATCHED)
SCENARIO = _topic(topics.SCENARIO)
NODE_STATUS = _topic(topics.NODE_STATUS)
CLOCK = _topic(topics.CLOCK)
IMAGE = _topic(topics.IMAGE)
CAMERA_INFO = _topic(topics.CAMERA_INFO)
CAMERA2 = _topic(topics.CAMERA2)
CAMERA2_INFO = _topic(topics.CAMERA2_INFO)
ODOMETRY = _topic(topics.ODOMETRY)
TRUTH = _topic(topics.TRUTH)
SENSORS = {name: _topic(topic) for name, topic in topics.SENSORS.items()}
ESTIMATE = _topic(topics.ESTIMATE)
COMMAND = _topic(topics.COMMAND)
ROBUSTNESS = _topic(topics.ROBUSTNESS)
VERDICT = _topic(topics.VERDICT)
PROGRESS = _topic(topics.PROGRESS)
RUN_STATUS = _topic(topics.RUN_STATUS)
TIMING = _topic(topics.TIMING)
OBITUARY = _topic(topics.OBITUARY)
TF_STATIC = _topic(topics.TF_STATIC)
TF = _topic(topics.TF)
DIAGNOSTICS = _topic(topics.DIAGNOSTICS)
ALARM = _topic(topics.ALARM)
SCENE_RUNWAY = _topic(topics.SCENE_RUNWAY)
SCENE_AIRCRAFT = _topic(topics.SCENE_AIRCRAFT)
TOPICS = tuple(map(_topic, topics.TOPICS))
TRANSFORMS = tuple(map(_topic, topics.TRANSFORMS))
SCENE = tuple(map(_topic, topics.SCENE))
RUN_SCENARIO = 'run_scenario'
RUN_SCENARIO_TYPE = RunScenario
