"""What the simulator says of one moment of its world."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from taxinet_msgs.msg import TrackingError

from taxinet_ros.bag.image_cdr import image_cdr
from taxinet_ros.core.world import Observation
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import (
    camera_info_message,
    error_message,
    odometry_message,
    set_header,
    time_of,
)
from taxinet_ros.nodes.interface import Topic


class ObservationMessages:
    """The messages of the present control step; the next one's are the same objects."""

    def __init__(self) -> None:
        """Make what is kept."""
        self._clock = Clock()
        self._odometry = Odometry()
        self._truth = TrackingError()
        self._camera_info = camera_info_message()

    def of(self, now: Observation, run_id: str) -> Iterator[tuple[Topic, Any]]:
        """The messages, or their bytes, in the order in which they are published.

        Args:
            now: what there is to know.
            run_id: the run that it belongs to.
        """
        stamp_ns = now.stamp_ns
        time_of(stamp_ns, self._clock.clock)
        yield interface.CLOCK, self._clock
        yield interface.ODOMETRY, odometry_message(now.state, stamp_ns, self._odometry)
        truth = now.state.tracking_error
        yield interface.TRUTH, error_message(truth, run_id, now.seq, stamp_ns, self._truth)
        set_header(self._camera_info, stamp_ns, interface.CAMERA_FRAME)
        yield interface.CAMERA_INFO, self._camera_info
        if now.image is not None:
            yield interface.IMAGE, image_cdr(now.image, stamp_ns, interface.CAMERA_FRAME)
