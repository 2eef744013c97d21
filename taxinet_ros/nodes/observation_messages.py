"""What the simulator says of one moment of its world."""

from __future__ import annotations

from collections.abc import Iterator

from taxinet_ros.bag.image_cdr import image_cdr
from taxinet_ros.core.world import Observation
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.step_cdr import camera_info_cdr, clock_cdr, error_cdr, odometry_cdr


def observation_messages(now: Observation, run_id: str) -> Iterator[tuple[Topic, bytes]]:
    """The serialised messages of a control step, in the order in which they are published.

    Args:
        now: what there is to know.
        run_id: the run that it belongs to.
    """
    stamp_ns = now.stamp_ns
    yield interface.CLOCK, clock_cdr(stamp_ns)
    yield interface.ODOMETRY, odometry_cdr(now.state, stamp_ns)
    yield interface.TRUTH, error_cdr(now.state.tracking_error, run_id, now.seq, stamp_ns)
    yield interface.CAMERA_INFO, camera_info_cdr(stamp_ns)
    if now.image is not None:
        yield interface.IMAGE, image_cdr(now.image, stamp_ns, interface.CAMERA_FRAME)
