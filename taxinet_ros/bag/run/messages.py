"""Serialise the messages of a run from core values, without ROS.

Nodes publish these bytes, and a run in one process writes them to its bag. Floats are not changed,
so graph and loop give the same bits. The bytes equal those of ROS for messages with the same values
(``tests/nodes/messages``).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr.alignment import FORMATS
from taxinet_ros.bag.cdr.decode import typestore
from taxinet_ros.bag.cdr.fields import MessageTemplate
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.run.topics import (
    BASE_FRAME,
    CAMERA2_FRAME,
    CAMERA_FRAME,
    MAP_FRAME,
    topic_info,
)
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.topics import Topic
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError, quaternion
from taxinet_ros.errors import UsageError

_STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
_STEP = (*_STAMP, 'seq')
_KEPT = 256
"""Cache size of templates per kind: more than the formulas of a run."""
_PROGRESS_STATE = 1
"""``NodeStatus.PROGRESS``."""
_GNSS_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2
"""``NavSatStatus.STATUS_FIX``, ``SERVICE_GPS``; ``NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN``."""

Values = Mapping[str, Any]
"""Fields of a message by name; nested messages are mappings, missing fields are zero."""


def header_values(stamp_ns: int, frame_id: str = MAP_FRAME) -> Values:
    """Header at simulated time ``stamp_ns``."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return {'stamp': {'sec': sec, 'nanosec': nanosec}, 'frame_id': frame_id}


def message_cdr(topic: Topic, values: Values) -> bytes:
    """Serialise any message of a topic."""
    store = typestore(topic_info(topic))
    return bytes(store.serialize_cdr(_message(store, topic.type_name, values), topic.type_name))


def _message(store: Any, type_name: str, values: Values) -> Any:
    kinds = dict(store.fielddefs[type_name][1])
    if unknown := set(values) - set(kinds):
        raise UsageError(
            f'{type_name}, as it is installed, has no {", ".join(sorted(unknown))}: it is of '
            'another version; build taxinet_msgs anew'
        )
    fields = {name: _field(store, kind, values.get(name)) for name, kind in kinds.items()}
    return store.types[type_name](**fields)


def _field(store: Any, kind: Any, value: Any) -> Any:
    node, what = kind
    if node is Nodetype.NAME:
        return _message(store, what, value or {})
    if node is Nodetype.BASE:
        empty = '' if what[0] == 'string' else np.dtype(what[0]).type(0).item()
        return empty if value is None else value
    element, count = what
    if element[0] is Nodetype.BASE and element[1][0] in FORMATS:
        given = [0] * (count if node is Nodetype.ARRAY else 0) if value is None else value
        return np.array(given, dtype=element[1][0])
    return [_field(store, element, one) for one in value or ()]


def clock_cdr(stamp_ns: int) -> bytes:
    """Serialise a clock message with simulated time [ns]."""
    return _clock().filled(*divmod(stamp_ns, NS_PER_S))


def camera_info_cdr(
    stamp_ns: int, camera: CameraModel = WING, frame_id: str = CAMERA_FRAME
) -> bytes:
    """Serialise a camera's intrinsics, with a stamp [ns]."""
    return _camera_info(camera, frame_id).filled(*divmod(stamp_ns, NS_PER_S))


def odometry_cdr(state: AircraftState, stamp_ns: int) -> bytes:
    """Serialise the true state: pose in map, velocity in base_link."""
    return _odometry().filled(
        *divmod(stamp_ns, NS_PER_S), state.x_m, state.y_m, state.z_m,
        *quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad),
        state.speed_mps, state.yaw_rate_radps,
    )


def error_cdr(error: TrackingError, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """Serialise a true or estimated tracking error."""
    return _error(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, error.cte_m, error.he_rad, error.valid, *error.covariance
    )


def command_cdr(command: TaxiCommand, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """Serialise a command."""
    return _command(run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, command.steering_rad, command.speed_mps
    )


def robustness_cdr(spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int) -> bytes:
    """Serialise the current robustness of one formula."""
    return _robustness(spec.name, spec.text, run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq, reading.lower, reading.upper, reading.verdict,
        reading.final, reading.valid, reading.samples, reading.rejected, reading.trusted,
    )


def progress_cdr(
    node: str, implementation: str, fingerprint: str, run_id: str, seq: int, stamp_ns: int
) -> bytes:
    """Serialise the status of a lockstep node with progress up to ``seq``.

    Args:
        node: name of the node.
        implementation: name of its implementation.
        fingerprint: SHA-256 of its weights, or ''.
        run_id: id of the run.
        seq: last completed control step.
        stamp_ns: simulated time of that step [ns].
    """
    return _progress(node, implementation, fingerprint, run_id).filled(
        *divmod(stamp_ns, NS_PER_S), seq
    )


def observation_messages(
    now: Observation, image: NDArray[np.uint8] | None, run_id: str, camera: CameraModel = WING
) -> Iterator[tuple[Topic, bytes]]:
    """Serialised messages of a control step, in order of publication.

    Args:
        now: the observation.
        image: its picture (200, 360, 3) uint8 RGB, or None to leave it out.
        run_id: id of the run.
        camera: the camera that took the picture.
    """
    stamp_ns = now.stamp_ns
    yield topics.CLOCK, clock_cdr(stamp_ns)
    yield topics.ODOMETRY, odometry_cdr(now.state, stamp_ns)
    yield topics.TRUTH, error_cdr(now.truth, run_id, now.seq, stamp_ns)
    if now.measured is not None:
        yield from sensor_messages(now.measured)
    yield topics.CAMERA_INFO, camera_info_cdr(stamp_ns, camera)
    if image is not None:
        yield topics.IMAGE, image_cdr(image, stamp_ns, CAMERA_FRAME)


def sensor_messages(measured: Measured) -> Iterator[tuple[Topic, bytes]]:
    """Serialised measurements of the sensors beside the camera, oldest first of each."""
    for fix in measured.gnss:
        yield topics.GNSS, _gnss(fix.sigma_m).filled(
            *divmod(fix.stamp_ns, NS_PER_S), fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
    for turned in measured.imu:
        yield topics.IMU, _imu(turned.sigmas).filled(
            *divmod(turned.stamp_ns, NS_PER_S), *turned.orientation, *turned.rates_radps,
            *turned.acceleration_mps2)
    for speed in measured.wheel:
        yield topics.WHEEL, _wheel(speed.sigma_mps).filled(
            *divmod(speed.stamp_ns, NS_PER_S), speed.speed_mps)
    for picture in measured.camera:
        yield topics.CAMERA2, image_cdr(picture.image, picture.stamp_ns, CAMERA2_FRAME)


@functools.cache
def _clock() -> MessageTemplate:
    return _template(topics.CLOCK, {}, 'clock.sec', 'clock.nanosec')


@functools.lru_cache(_KEPT)
def _camera_info(camera: CameraModel, frame_id: str) -> MessageTemplate:
    matrix = camera.intrinsics
    return _template(topics.CAMERA_INFO, {
        'header': header_values(0, frame_id),
        'height': camera.height_px,
        'width': camera.width_px,
        'distortion_model': 'plumb_bob',
        'd': list(camera.distortion),
        'k': matrix.ravel(),
        'r': np.eye(3).ravel(),
        'p': np.hstack([matrix, np.zeros((3, 1))]).ravel(),
    }, *_STAMP)


@functools.cache
def _odometry() -> MessageTemplate:
    return _template(
        topics.ODOMETRY, {'header': header_values(0), 'child_frame_id': BASE_FRAME}, *_STAMP,
        *(f'pose.pose.position.{axis}' for axis in 'xyz'),
        *(f'pose.pose.orientation.{axis}' for axis in 'xyzw'),
        'twist.twist.linear.x', 'twist.twist.angular.z',
    )


def _diagonal(sigma: float) -> list[float]:
    return list(map(float, (np.eye(3) * sigma ** 2).ravel()))


@functools.lru_cache(_KEPT)
def _gnss(sigma_m: float) -> MessageTemplate:
    return _template(topics.GNSS, {
        'header': header_values(0, BASE_FRAME),
        'status': {'status': _GNSS_FIX, 'service': _GPS},
        'position_covariance': _diagonal(sigma_m),
        'position_covariance_type': _DIAGONAL_KNOWN if sigma_m else 0,
    }, *_STAMP, 'latitude', 'longitude', 'altitude')


@functools.lru_cache(_KEPT)
def _imu(sigmas: tuple[float, float, float]) -> MessageTemplate:
    heading_rad, rate_radps, acceleration_mps2 = sigmas
    return _template(
        topics.IMU, {
            'header': header_values(0, BASE_FRAME),
            'orientation_covariance': _diagonal(heading_rad),
            'angular_velocity_covariance': _diagonal(rate_radps),
            'linear_acceleration_covariance': _diagonal(acceleration_mps2),
        }, *_STAMP, *(f'orientation.{axis}' for axis in 'xyzw'),
        *(f'angular_velocity.{axis}' for axis in 'xyz'),
        *(f'linear_acceleration.{axis}' for axis in 'xyz'),
    )


@functools.lru_cache(_KEPT)
def _wheel(sigma_mps: float) -> MessageTemplate:
    return _template(topics.WHEEL, {
        'header': header_values(0, BASE_FRAME),
        'twist': {'covariance': [sigma_mps ** 2, *[0.0] * 35]},
    }, *_STAMP, 'twist.twist.linear.x')


@functools.lru_cache(_KEPT)
def _error(run_id: str) -> MessageTemplate:
    values = {'header': header_values(0), 'run_id': run_id}
    return _template(
        topics.TRUTH, values, *_STEP, 'cross_track_error', 'heading_error', 'valid',
        *(f'covariance[{number}]' for number in range(4)),
    )


@functools.lru_cache(_KEPT)
def _command(run_id: str) -> MessageTemplate:
    values = {'header': header_values(0, BASE_FRAME), 'run_id': run_id}
    return _template(topics.COMMAND, values, *_STEP, 'steering_angle', 'speed')


@functools.lru_cache(_KEPT)
def _robustness(name: str, text: str, run_id: str) -> MessageTemplate:
    values = {'header': header_values(0), 'run_id': run_id, 'spec': name, 'formula': text}
    return _template(
        topics.ROBUSTNESS, values, *_STEP,
        'rho_lower', 'rho_upper', 'verdict', 'final', 'valid', 'samples', 'rejected', 'trusted',
    )


@functools.lru_cache(_KEPT)
def _progress(node: str, implementation: str, fingerprint: str, run_id: str) -> MessageTemplate:
    values = {
        'header': header_values(0, ''), 'run_id': run_id, 'node': node, 'state': _PROGRESS_STATE,
        'implementation': implementation, 'fingerprint': fingerprint,
    }
    return _template(topics.PROGRESS, values, *_STEP)


def _template(topic: Topic, values: Values, *fields: str) -> MessageTemplate:
    return MessageTemplate(topic_info(topic), message_cdr(topic, values), fields)
