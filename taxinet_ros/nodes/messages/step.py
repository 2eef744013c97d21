"""The messages of a control step: read back, collected, and the transforms that follow them.

rclpy publishes bytes as they are (:mod:`taxinet_ros.bag.run.messages` makes them), and hands them
to subscribers that ask for raw messages. A message object it converts field by field, which takes
several times as long. Floats pass unchanged, so the graph matches the core's bits.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from taxinet_msgs.msg import Timing

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.topics import TopicInfo, describe_topic
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
        cte_m=message.cross_track_error, he_rad=message.heading_error, valid=message.valid
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


def subnormal(value: TrackingError | TaxiCommand) -> str:
    """Say which numbers of a valid answer no node can have meant, or ''.

    rclpy copies a float field as a double from the memory of whatever object is in it, unless
    ``ROS_PYTHON_CHECK_FIELDS`` is 1. Of an int, a bool, a string, an array or another number of
    NumPy than float64, these bytes are a subnormal number.
    """
    if isinstance(value, TrackingError):
        numbers = (value.cte_m, value.he_rad) if value.valid else ()
        words = f'{value.cte_m:g} m, {value.he_rad:g} rad'
    else:
        numbers = value.steering_rad, value.speed_mps
        words = f'{value.steering_rad:g} rad at {value.speed_mps:g} m/s'
    if not any(0 < abs(number) < sys.float_info.min for number in numbers):
        return ''
    return f'{words}: subnormal, an int or array in a float field? see docs/own_nodes.md'


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
    # rclpy's message objects cost three times as much, a seventh of a run (docs/performance.md).
    decode = decoder(describe_topic(name=topic.name, type_name=topic.type_name, qos=''))
    read = _READ[topic.name]
    return lambda cdr: read(decode(cdr))


class TransformBroadcaster:
    """Publishes ``tf_static`` once (latched), and ``tf`` with each odometry."""

    def __init__(
        self, node: Node, *, prefix: str = '', odometry: TopicInfo | None = None
    ) -> None:
        """Publish the wing camera's transform.

        Args:
            node: publishing node.
            prefix: prefix of the topic names, with slash.
            odometry: as in :class:`.OdometryTransforms`.
        """
        self._static, self._moving = (
            node.create_publisher(topic.type, prefix + topic.name, topic.qos)
            for topic in interface.TRANSFORMS
        )
        self._transform_of = OdometryTransforms(odometry)
        self._mounted = WING
        self._static.publish(camera_transform())

    def mount(self, camera: CameraModel) -> None:
        """Publish another camera's transform, if it is another."""
        if camera != self._mounted:
            self._mounted = camera
            self._static.publish(camera_transform(camera))

    def follow(self, odometry: bytes) -> None:
        """Publish ``base_link`` from serialised odometry, if there are subscribers.

        Raises:
            BagCorrupt: the bytes are not odometry.
        """
        if self._moving.get_subscription_count():
            self._moving.publish(self._transform_of(odometry))


Step = tuple[int, dict[str, list[Any]]]
"""Control step number and its messages by topic."""


class StepCollector:
    """Collects messages per topic and step, and returns complete steps in order."""

    def __init__(self, expected: Mapping[str, int]) -> None:
        """``expected``: topic name to number of messages per step."""
        self._expected = dict(expected)
        self._total = sum(expected.values())
        self._pending: dict[int, _Pending] = {}
        self._next = 0
        self.repeated = 0

    def add(self, topic: str, seq: int, message: Any) -> Sequence[Step]:
        """Add one message; return the steps now complete, oldest first.

        A message beyond the expected number (a repetition, or of a step already returned) is
        counted in :attr:`repeated` and ignored.
        """
        if seq < self._next:
            self.repeated += 1
            return ()
        step = self._pending.get(seq)
        if step is None:
            step = self._pending[seq] = _Pending(self._total)
        messages = step.messages.get(topic)
        if topic in step.excused:
            self.repeated += 1
            return ()
        if messages is None:
            messages = step.messages[topic] = []
        if len(messages) == self._expected[topic]:
            self.repeated += 1
            return ()
        messages.append(message)
        step.missing -= 1
        return () if step.missing or seq != self._next else self._whole()

    def excuse(self, topic: str, seq: int) -> Sequence[Step]:
        """Drop a topic from a step, including messages received; return as :meth:`add`."""
        if seq < self._next:
            return ()
        step = self._pending.setdefault(seq, _Pending(self._total))
        if topic not in step.excused:
            step.excused.add(topic)
            step.missing -= self._expected[topic] - len(step.messages.pop(topic, ()))
        return () if step.missing or seq != self._next else self._whole()

    def settle(self, timing: Timing) -> list[Step]:
        """Drop the answers that frames of a free run do not get; return as :meth:`add`."""
        settled = (
            (interface.ESTIMATE.name, timing.unestimated),
            (interface.COMMAND.name, timing.uncommanded),
        )
        return [
            step for topic, frames in settled for frame in frames
            for step in self.excuse(topic, frame)
        ]

    def _whole(self) -> list[Step]:
        whole = []
        while (step := self._pending.get(self._next)) is not None and not step.missing:
            del self._pending[self._next]
            whole.append((self._next, step.messages))
            self._next += 1
        return whole

    def torn(self) -> list[Step]:
        """Incomplete steps, oldest first, left by an aborted run."""
        return sorted((seq, step.messages) for seq, step in self._pending.items())


class FreeProgress:
    """What a follower of a free run reports: how far it has come, and its messages."""

    def __init__(self, topics: Iterable[Topic]) -> None:
        """``topics``: those of the simulator that it follows."""
        self._arrived = {topic.name: -1 for topic in topics}
        self._reported = (-1, -1)

    def arrived(self, topic: str, seq: int) -> bool:
        """Record the newest message of a topic; False if it is not one of those followed."""
        if topic in self._arrived:
            self._arrived[topic] = seq
        return topic in self._arrived

    def news(self, done: int) -> tuple[int, int] | None:
        """Steps done and arrived, if they have changed since the last report."""
        now = max(done, 0), max(min(self._arrived.values()), 0)
        if now == self._reported:
            return None
        self._reported = now
        return now


class _Pending:
    """Messages of a step by topic, number still missing, and excused topics."""

    __slots__ = ('excused', 'messages', 'missing')

    def __init__(self, missing: int) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.missing = missing
        self.excused: set[str] = set()
