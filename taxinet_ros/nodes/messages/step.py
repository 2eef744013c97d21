"""Serialise, decode and collect the messages of a control step.

rclpy publishes bytes unchanged, and passes them to subscribers of raw messages. It converts message
objects field by field, which takes several times as long. Floats pass unchanged, so the graph is
bit-identical to the core.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from taxinet_msgs import msg as taxinet

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.cdr.fields import MessageTemplate
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.topics import TopicInfo, describe_topic
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError, quaternion
from taxinet_ros.core.world import Observation
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.messages.convert import camera_info_message, header, stamp_of

_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_STEP = (*_STAMP, 'seq')
_KEPT = 256
"""Cache size of templates per kind: more than the formulas of a run."""


def clock_cdr(stamp_ns: int) -> bytes:
    """Simulated time [ns]."""
    return _clock().filled(*divmod(stamp_ns, NS_PER_S))


def camera_info_cdr(stamp_ns: int) -> bytes:
    """Intrinsics of the wing camera, stamped [ns]."""
    return _camera_info().filled(*divmod(stamp_ns, NS_PER_S))


def odometry_cdr(state: AircraftState, stamp_ns: int) -> bytes:
    """True state: pose in map, velocity in base_link."""
    return _odometry().filled(
        *divmod(stamp_ns, NS_PER_S), state.x_m, state.y_m, state.z_m,
        *quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad),
        state.speed_mps, state.yaw_rate_radps,
    )


def error_cdr(error: TrackingError, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """True or estimated tracking error."""
    return _error(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, error.cte_m, error.he_rad, error.valid
    )


def command_cdr(command: TaxiCommand, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """A command."""
    return _command(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, command.steering_rad, command.speed_mps
    )


def robustness_cdr(spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """Current robustness of one formula."""
    return _robustness(spec.name, spec.text, run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, reading.lower, reading.upper, reading.verdict,
        reading.final, reading.valid, reading.samples, reading.rejected, reading.trusted,
    )


def progress_cdr(
    node: str, implementation: str, fingerprint: str, run_id: str, seq: int, stamp_ns: int
) -> bytes:
    """Status of a lockstep node with progress up to ``seq``.

    Args:
        node: its name.
        implementation: name of its implementation.
        fingerprint: sha256 of the weights that decide its behaviour, or ''.
        run_id: its run.
        seq: the last control step it has finished.
        stamp_ns: simulated time of that [ns].
    """
    return _progress(node, implementation, fingerprint, run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq
    )


@functools.cache
def _clock() -> MessageTemplate:
    return _template(interface.CLOCK, Clock(), 'clock.sec', 'clock.nanosec')


@functools.cache
def _camera_info() -> MessageTemplate:
    return _template(interface.CAMERA_INFO, camera_info_message(), *_STAMP)


@functools.cache
def _odometry() -> MessageTemplate:
    message = Odometry(header=header(0), child_frame_id=interface.BASE_FRAME)
    return _template(
        interface.ODOMETRY, message, *_STAMP,
        *(f'pose.pose.position.{axis}' for axis in 'xyz'),
        *(f'pose.pose.orientation.{axis}' for axis in 'xyzw'),
        'twist.twist.linear.x', 'twist.twist.angular.z',
    )


@functools.lru_cache(_KEPT)
def _error(run_id: str) -> MessageTemplate:
    message = taxinet.TrackingError(header=header(0), run_id=run_id)
    fields = 'cross_track_error', 'heading_error', 'valid'
    return _template(interface.TRUTH, message, *_STEP, *fields)


@functools.lru_cache(_KEPT)
def _command(run_id: str) -> MessageTemplate:
    message = taxinet.TaxiCommand(header=header(0, interface.BASE_FRAME), run_id=run_id)
    return _template(interface.COMMAND, message, *_STEP, 'steering_angle', 'speed')


@functools.lru_cache(_KEPT)
def _robustness(name: str, text: str, run_id: str) -> MessageTemplate:
    message = taxinet.Robustness(header=header(0), run_id=run_id, spec=name, formula=text)
    return _template(
        interface.ROBUSTNESS, message, *_STEP,
        'rho_lower', 'rho_upper', 'verdict', 'final', 'valid', 'samples', 'rejected', 'trusted',
    )


@functools.lru_cache(_KEPT)
def _progress(node: str, implementation: str, fingerprint: str, run_id: str) -> MessageTemplate:
    message = taxinet.NodeStatus(
        header=header(0, ''), run_id=run_id, node=node, state=taxinet.NodeStatus.PROGRESS,
        implementation=implementation, fingerprint=fingerprint,
    )
    return _template(interface.PROGRESS, message, *_STEP)


def _template(topic: Topic, message: Any, *fields: str) -> MessageTemplate:
    described = describe_topic(name=topic.name, type_name=topic.type_name, qos='')
    return MessageTemplate(described, bytes(serialize_message(message)), fields)


def observation_messages(now: Observation, run_id: str) -> Iterator[tuple[Topic, bytes]]:
    """Serialised messages of a control step, in order of publication.

    Args:
        now: the observation.
        run_id: the run it belongs to.
    """
    stamp_ns = now.stamp_ns
    yield interface.CLOCK, clock_cdr(stamp_ns)
    yield interface.ODOMETRY, odometry_cdr(now.state, stamp_ns)
    yield interface.TRUTH, error_cdr(now.state.tracking_error, run_id, now.seq, stamp_ns)
    yield interface.CAMERA_INFO, camera_info_cdr(stamp_ns)
    if now.image is not None:
        yield interface.IMAGE, image_cdr(now.image, stamp_ns, interface.CAMERA_FRAME)


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
        x_m: position along the runway [m].
        speed_mps: ground speed along the body x axis [m/s].
    """

    x_m: float
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
    motion = Motion(message.pose.pose.position.x, message.twist.twist.linear.x)
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
        return _as_it_is
    # rclpy's message objects cost three times as much, a seventh of a run (docs/performance.md).
    decode = decoder(describe_topic(name=topic.name, type_name=topic.type_name, qos=''))
    read = _READ[topic.name]
    return lambda cdr: read(decode(cdr))


def _as_it_is(message: Any) -> Any:
    return message


class TransformBroadcaster:
    """Publishes ``tf_static`` once (latched), and ``tf`` with each odometry."""

    def __init__(
        self, node: Node, *, prefix: str = '', odometry: TopicInfo | None = None
    ) -> None:
        """Publish the camera transform.

        Args:
            node: publishing node.
            prefix: prefix of the topic names, with slash.
            odometry: as in :class:`.OdometryTransforms`.
        """
        static, moving = (
            node.create_publisher(topic.type, prefix + topic.name, topic.qos)
            for topic in interface.TRANSFORMS
        )
        self._moving = moving
        self._transform_of = OdometryTransforms(odometry)
        static.publish(camera_transform())

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


class _Pending:
    """Messages of a step by topic, number still missing, and excused topics."""

    __slots__ = ('excused', 'messages', 'missing')

    def __init__(self, missing: int) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.missing = missing
        self.excused: set[str] = set()
