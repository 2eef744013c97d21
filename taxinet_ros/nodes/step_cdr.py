"""The bytes of what is said in every control step, made of the core's values.

rclpy publishes bytes as they are; a message object it converts field by field, once it is made,
which takes several times as long. Floats pass unchanged, so the graph matches the core's bits.
"""

from __future__ import annotations

import functools
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from taxinet_msgs import msg as taxinet

from taxinet_ros.bag.definitions import describe_topic
from taxinet_ros.bag.message_template import MessageTemplate
from taxinet_ros.core.attitude import quaternion
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import camera_info_message, header
from taxinet_ros.nodes.interface import Topic

_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_STEP = (*_STAMP, 'seq')
_KEPT = 256
"""Templates of a kind that are kept: more than a run has formulas, which take turns."""


def clock_cdr(stamp_ns: int) -> bytes:
    """Simulated time [ns]."""
    return _clock().filled(*divmod(stamp_ns, NS_PER_S))


def camera_info_cdr(stamp_ns: int) -> bytes:
    """Intrinsics of the wing camera, stamped [ns]."""
    return _camera_info().filled(*divmod(stamp_ns, NS_PER_S))


def odometry_cdr(state: AircraftState, stamp_ns: int) -> bytes:
    """The true state: pose in map, velocity in base_link."""
    return _odometry().filled(
        *divmod(stamp_ns, NS_PER_S), state.x_m, state.y_m, state.z_m,
        *quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad),
        state.speed_mps, state.yaw_rate_radps,
    )


def error_cdr(error: TrackingError, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """Truth or estimate."""
    return _error(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, error.cte_m, error.he_rad, error.valid
    )


def command_cdr(command: TaxiCommand, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """A command."""
    return _command(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, command.steering_rad, command.speed_mps
    )


def robustness_cdr(spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """One formula's reading."""
    return _robustness(spec.name, spec.text, run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, reading.lower, reading.upper, reading.verdict,
        reading.final, reading.valid, reading.samples, reading.rejected, reading.trusted,
    )


def progress_cdr(
    node: str, implementation: str, fingerprint: str, run_id: str, seq: int, stamp_ns: int
) -> bytes:
    """The status of a node of the lockstep that has come as far as ``seq``.

    Args:
        node: its name.
        implementation: which of the exchangeable kinds it is.
        fingerprint: sha256 of the weights that decide its behaviour, or ''.
        run_id: its run.
        seq: the last control step that it is done with.
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
