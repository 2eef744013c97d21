"""Coordinate frames for tf2: ``tf`` follows odometry, ``tf_static`` mounts the camera.

In ROS any node may publish on these two topics. So the transforms in a run's bag are not recorded
from the topics but derived from the bag's odometry: ``tf`` is the pose of ``base_link`` in ``map``,
bit for bit as in ``ground_truth/odom``. Simulator and recorder use this module.
"""

from __future__ import annotations

import functools
import struct

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.cdr.image import ENCAPSULATION, aligned, with_text
from taxinet_ros.bag.run.messages import header_values, message_cdr
from taxinet_ros.bag.run.topics import (
    BASE_FRAME,
    CAMERA2_FRAME,
    CAMERA_FRAME,
    MAP_FRAME,
    topic_info,
)
from taxinet_ros.core import topics
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.types import NS_PER_S, AircraftState, quaternion

_STAMP, _POSE = struct.Struct('<IiI'), struct.Struct('<7d')


class OdometryTransforms:
    """Converts odometry messages to ``tf`` messages."""

    def __init__(self) -> None:
        self._decode = decoder(topic_info(topics.ODOMETRY))

    def __call__(self, odometry: bytes) -> bytes:
        """Serialised ``TFMessage`` with the pose of odometry's child frame, with its stamp.

        Raises:
            BagCorrupt: not an odometry message.
        """
        message = self._decode(odometry)
        stamp, pose = message.header.stamp, message.pose.pose
        place, turn = pose.position, pose.orientation
        return _transform(
            stamp.sec, stamp.nanosec, message.header.frame_id, message.child_frame_id,
            place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w,
        )


def aircraft_transform(state: AircraftState, stamp_ns: int) -> bytes:
    """Serialised ``TFMessage`` with the pose of the aircraft in ``map``, as from its odometry."""
    return _transform(
        *divmod(stamp_ns, NS_PER_S), MAP_FRAME, BASE_FRAME, state.x_m, state.y_m, state.z_m,
        *quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad),
    )


@functools.lru_cache(16)
def camera_transform(camera: CameraModel = WING, *more: CameraModel) -> bytes:
    """Serialised ``TFMessage`` with the pose of ``camera_optical`` in ``base_link``.

    With a second camera it also has that of ``camera2_optical``.

    The optical frame follows REP-103: z forward along the optical axis, x right and y down in the
    image.
    """
    if more:
        return message_cdr(topics.TF_STATIC, {'transforms': [{
            'header': header_values(0, BASE_FRAME), 'child_frame_id': frame,
            'transform': {
                'translation': dict(zip('xyz', one.offset_m, strict=True)),
                'rotation': dict(zip('xyzw', one.attitude, strict=True)),
            },
        } for frame, one in zip((CAMERA_FRAME, CAMERA2_FRAME), (camera, *more), strict=True)]})
    pose = *camera.offset_m, *camera.attitude
    return _transform(0, 0, BASE_FRAME, CAMERA_FRAME, *pose)


def _transform(sec: int, nanosec: int, frame: str, child: str, *pose: float) -> bytes:
    """One transform: translation x, y, z [m] and rotation x, y, z, w of ``child`` in ``frame``."""
    return b''.join((
        ENCAPSULATION, _STAMP.pack(1, sec, nanosec), _names(frame, child), _POSE.pack(*pose),
    ))


@functools.lru_cache(16)
def _names(frame: str, child: str) -> bytes:
    """Serialised frame names and the gap after them, at their offset after the stamp."""
    before = bytes(_STAMP.size)
    body = with_text(with_text(before, frame.encode()), child.encode())
    return aligned(body, 8)[len(before):]
