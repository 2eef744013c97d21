"""What is said step by step is taken as bytes and read here, as values of the core.

rclpy makes a message field by field, and each field with defaults that are then replaced: that
takes several times as long. It is the inverse of :mod:`taxinet_ros.nodes.step_cdr`; floats pass
unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from taxinet_ros.bag.definitions import describe_topic
from taxinet_ros.bag.message_fields import FieldReader
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic


class Said(NamedTuple):
    """What one message of a control step says.

    Attributes:
        stamp_ns: simulated time since the start of the run [ns].
        value: a :class:`TrackingError`, a :class:`TaxiCommand`, a :class:`Motion`, or the name of
            the node that reports progress.
        run_id: the run that it belongs to; '' where messages of the topic do not tell.
        seq: number of the step as the message has it; -1 where they do not tell.
    """

    stamp_ns: int
    value: Any
    run_id: str = ''
    seq: int = -1


class Motion(NamedTuple):
    """What is monitored of odometry.

    Attributes:
        x_m: place along the runway [m].
        speed_mps: ground speed along the body x axis [m/s].
    """

    x_m: float
    speed_mps: float


def _error(
    stamp_ns: int, seq: int, cte_m: float, he_rad: float, valid: bool, run_id: str
) -> Said:
    return Said(stamp_ns, TrackingError(cte_m=cte_m, he_rad=he_rad, valid=valid), run_id, seq)


def _command(stamp_ns: int, seq: int, steering_rad: float, speed_mps: float, run_id: str) -> Said:
    command = TaxiCommand(steering_rad=steering_rad, speed_mps=speed_mps)
    return Said(stamp_ns, command, run_id, seq)


def _motion(stamp_ns: int, x_m: float, speed_mps: float) -> Said:
    return Said(stamp_ns, Motion(x_m, speed_mps))


def _progress(stamp_ns: int, seq: int, run_id: str, node: str) -> Said:
    return Said(stamp_ns, node, run_id, seq)


_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_ERROR = ('seq', 'cross_track_error', 'heading_error', 'valid'), ('run_id',), _error
_READ: dict[str, tuple[tuple[str, ...], tuple[str, ...], Callable[..., Said]]] = {
    interface.TRUTH.name: _ERROR,
    interface.ESTIMATE.name: _ERROR,
    interface.COMMAND.name: (('seq', 'steering_angle', 'speed'), ('run_id',), _command),
    interface.ODOMETRY.name: (
        ('pose.pose.position.x', 'twist.twist.linear.x'), (), _motion,
    ),
    interface.PROGRESS.name: (('seq',), ('run_id', 'node'), _progress),
}


def read_here(topic: Topic) -> bool:
    """Whether a topic is one of many messages, which is to be subscribed to as raw."""
    return topic.name in _READ


def reader_of(topic: Topic) -> Callable[[Any], Any]:
    """From what a subscription gives, raw where :func:`read_here`, to :class:`Said`.

    Messages of other topics stay as they are. The reader raises
    :class:`~taxinet_ros.bag.errors.BagCorrupt` where bytes are no message of the topic's type.
    """
    if not read_here(topic):
        return _as_it_is
    numbers, texts, said = _READ[topic.name]
    described = describe_topic(name=topic.name, type_name=topic.type_name, qos='')
    fields = FieldReader(described, (*_STAMP, *numbers), texts)

    def read(cdr: bytes) -> Said:
        sec, nanosec, *rest = fields(cdr)
        return said(sec * NS_PER_S + nanosec, *rest)

    return read


def _as_it_is(message: Any) -> Any:
    return message
