"""Coordinate frames for tf2: ``tf`` follows odometry, ``tf_static`` mounts the camera.

By ROS's convention anybody may speak on these two topics, of frames of his own. So what a bag of
ours says there is not what was heard, but made of the odometry that is in it: ``tf`` says where
``base_link`` is in ``map``, bit for bit as ``ground_truth/odom``. Simulator, recorder and player
all make it here.
"""

from __future__ import annotations

import functools
import struct

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.cdr.image import ENCAPSULATION, aligned, with_text
from taxinet_ros.bag.run.topics import BASE_FRAME, CAMERA_FRAME
from taxinet_ros.bag.topics import TopicInfo, describe_topic
from taxinet_ros.core import topics
from taxinet_ros.core.camera.camera import WING
from taxinet_ros.core.rig.camera_model import CameraModel

_STAMP, _POSE = struct.Struct('<IiI'), struct.Struct('<7d')


class OdometryTransforms:
    """Makes a message of ``tf`` of each message of odometry."""

    def __init__(self, odometry: TopicInfo | None = None) -> None:
        """Learn what odometry is laid out like: as installed, or as a bag describes it.

        Raises:
            BagForeign: the topic carries no definition that could be used.
        """
        row = topics.ODOMETRY
        self._decode = decoder(
            odometry or describe_topic(name=row.name, type_name=row.type_name, qos='')
        )

    def __call__(self, odometry: bytes) -> bytes:
        """The serialised ``TFMessage`` that says where odometry's child frame is, with its stamp.

        Raises:
            BagCorrupt: the bytes are no odometry.
        """
        message = self._decode(odometry)
        stamp, pose = message.header.stamp, message.pose.pose
        place, turn = pose.position, pose.orientation
        return _transform(
            stamp.sec, stamp.nanosec, message.header.frame_id, message.child_frame_id,
            place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w,
        )


@functools.lru_cache(16)
def camera_transform(camera: CameraModel = WING) -> bytes:
    """The serialised ``TFMessage`` that says where ``camera_optical`` is in ``base_link``.

    The optical frame is REP-103's: z ahead along the optical axis, x right and y down in the
    picture.
    """
    pose = *camera.offset_m, *camera.attitude
    return _transform(0, 0, BASE_FRAME, CAMERA_FRAME, *pose)


def _transform(sec: int, nanosec: int, frame: str, child: str, *pose: float) -> bytes:
    """One transform: translation x, y, z [m] and rotation x, y, z, w of ``child`` in ``frame``."""
    return b''.join((
        ENCAPSULATION, _STAMP.pack(1, sec, nanosec), _names(frame, child), _POSE.pack(*pose),
    ))


@functools.lru_cache(16)
def _names(frame: str, child: str) -> bytes:
    """Both names and the gap behind them, as they lie behind the stamp."""
    before = bytes(_STAMP.size)
    body = with_text(with_text(before, frame.encode()), child.encode())
    return aligned(body, 8)[len(before):]
