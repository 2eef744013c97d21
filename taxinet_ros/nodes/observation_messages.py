"""What the simulator says of one moment of its world."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from taxinet_ros.bag.image_cdr import image_cdr
from taxinet_ros.core.world import Observation
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import error_message, header, odometry_message, time_of
from taxinet_ros.nodes.interface import Topic


def observation_messages(
    now: Observation, run_id: str, camera_info: CameraInfo
) -> Iterator[tuple[Topic, Any]]:
    """The messages of one control step, in the order in which they are published.

    Args:
        now: what there is to know.
        run_id: the run that it belongs to.
        camera_info: the camera's, which is stamped here.
    """
    yield interface.CLOCK, Clock(clock=time_of(now.stamp_ns))
    yield interface.ODOMETRY, odometry_message(now.state, now.stamp_ns)
    truth = error_message(now.state.tracking_error, run_id, now.seq, now.stamp_ns)
    yield interface.TRUTH, truth
    camera_info.header = header(now.stamp_ns, interface.CAMERA_FRAME)
    yield interface.CAMERA_INFO, camera_info
    if now.image is not None:
        yield interface.IMAGE, image_cdr(now.image, now.stamp_ns, interface.CAMERA_FRAME)
