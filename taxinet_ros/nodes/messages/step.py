"""The messages of a control step: read back, and the transforms that follow them.

rclpy publishes bytes as they are (:mod:`taxinet_ros.bag.run.messages` makes them), and hands them
to subscribers that ask for raw messages. A message object it converts field by field, which takes
several times as long. Floats pass unchanged, so the graph matches the core's bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.node import Node

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.run.topics import topic_info
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import stamp_of


class StepMessage(NamedTuple):
    """Content of one message of a control step.

    Attributes:
        stamp_ns: simulated time since the start of the run [ns].
        value: a :class:`TrackingError`, a :class:`TaxiCommand`, a :class:`Motion`, or the name of
            the node that reports progress.
        run_id: the run it belongs to; '' if the message type has no run_id.
        seq: step number in the message; -1 if the message type has none.
    """

    stamp_ns: int
    value: Any
    run_id: str = ''
    seq: int = -1


class Motion(NamedTuple):
    """Monitored values of odometry.

    Attributes:
        x_m, y_m: position in ``map`` [m].
        attitude: as x, y, z, w.
        speed_mps: ground speed along the body x axis [m/s].
    """

    x_m: float
    y_m: float
    attitude: tuple[float, float, float, float]
    speed_mps: float


def _read_error(message: Any) -> StepMessage:
    error = TrackingError(
        cte_m=message.cross_track_error, he_rad=message.heading_error, valid=message.valid,
        covariance=message.covariance,
    )
    return StepMessage(stamp_of(message.header.stamp), error, message.run_id, message.seq)


def _read_command(message: Any) -> StepMessage:
    command = TaxiCommand(steering_rad=message.steering_angle, speed_mps=message.speed)
    return StepMessage(stamp_of(message.header.stamp), command, message.run_id, message.seq)


def _read_motion(message: Any) -> StepMessage:
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    motion = Motion(
        place.x, place.y, (turn.x, turn.y, turn.z, turn.w), message.twist.twist.linear.x
    )
    return StepMessage(stamp_of(message.header.stamp), motion)


def _read_progress(message: Any) -> StepMessage:
    return StepMessage(
        stamp_of(message.header.stamp), message.node, message.run_id, message.seq
    )


_READ: dict[str, Callable[[Any], StepMessage]] = {
    interface.TRUTH.name: _read_error,
    interface.ESTIMATE.name: _read_error,
    interface.COMMAND.name: _read_command,
    interface.ODOMETRY.name: _read_motion,
    interface.PROGRESS.name: _read_progress,
}


def is_read_raw(topic: Topic) -> bool:
    """Whether a high-rate topic is subscribed to with raw messages."""
    return topic.name in _READ


def step_reader(topic: Topic) -> Callable[[Any], Any]:
    """Return a converter from subscribed messages to :class:`StepMessage`.

    Messages are raw if :func:`is_read_raw`; those of other topics are passed unchanged. The
    converter raises :class:`~taxinet_ros.bag.errors.BagCorrupt` if bytes are not a message of the
    topic's type.
    """
    if not is_read_raw(topic):
        return lambda message: message
    # rclpy's message objects cost three times as much, a seventh of a run (benchmarks/RESULTS.md).
    decode = decoder(topic_info(topic))
    read = _READ[topic.name]
    return lambda cdr: read(decode(cdr))


class TransformBroadcaster:
    """Publishes ``tf_static`` once (latched), and ``tf`` with each odometry."""

    def __init__(self, node: Node) -> None:
        """Publish the wing camera's transform."""
        self._static, self._moving = (
            node.create_publisher(topic.type, topic.name, topic.qos)
            for topic in interface.TRANSFORMS
        )
        self._transform_of = OdometryTransforms()
        self._mounted: tuple[CameraModel, ...] = (WING,)
        self._static.publish(camera_transform())

    def mount(self, *cameras: CameraModel) -> None:
        """Publish the transforms of other cameras, if they are others."""
        if cameras != self._mounted:
            self._mounted = cameras
            self._static.publish(camera_transform(*cameras))

    def follow(self, odometry: bytes) -> None:
        """Publish ``base_link`` from serialised odometry, if there are subscribers.

        Raises:
            BagCorrupt: the bytes are not odometry.
        """
        if self._moving.get_subscription_count():
            self._moving.publish(self._transform_of(odometry))
