"""A perception node of one's own, with nothing but rclpy, NumPy and the message package.

Start it in every graph: ``taxinet run s_falsif --perception-cmd 'python3 own_perception.py'``, or
into one that waits for it: ``taxinet up --perception external``. This one looks for the centre of
the bright paint in the lower half of the frame, and calls that the centreline.
"""

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from taxinet_msgs.msg import NodeStatus, Scenario, TrackingError

EACH_STEP = QoSProfile(depth=16)  # reliable, volatile
LATCHED = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STEP_NS = 100_000_000


class OwnPerception(Node):
    def __init__(self):
        super().__init__('perception')
        self.scenario = None
        self.status = self.create_publisher(NodeStatus, 'node_status', LATCHED)
        self.estimates = self.create_publisher(
            TrackingError, 'perception/tracking_error', EACH_STEP)
        self.images = self.create_subscription(Image, 'camera/image_raw', self.see, EACH_STEP)
        self.create_subscription(Scenario, 'scenario', self.get_ready, LATCHED)
        self.create_timer(0.02, self.report)

    def get_ready(self, scenario):
        """A run begins: forget the one before."""
        self.scenario = scenario

    def report(self):
        """Say READY once for a run, when all ends have found each other: see the docs."""
        run = self.scenario
        listeners = {'simulator', 'steering_controller', 'mtl_monitor', 'recorder'}
        wanted = len(listeners & {'simulator', *run.participants}) if run else 0
        found = self.estimates.get_subscription_count()
        if run and found >= wanted and self.count_publishers('camera/image_raw'):
            self.scenario, self.run_id = None, run.run_id
            self.status.publish(NodeStatus(
                run_id=run.run_id, node='perception', state=NodeStatus.READY,
                implementation='bright paint', listens=['camera/image_raw', 'scenario'],
            ))

    def see(self, image):
        """One frame in, one estimate out; the frame's stamp says which control step it is."""
        stamp = image.header.stamp
        frame = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
        bright = frame[100:].min(axis=2) > 200
        answer = TrackingError(header=image.header, run_id=self.run_id, valid=bool(bright.any()))
        answer.header.frame_id = 'map'
        answer.seq = (stamp.sec * 1_000_000_000 + stamp.nanosec) // STEP_NS
        if answer.valid:
            middle = np.nonzero(bright)[1].mean() / image.width - 0.5
            answer.cross_track_error = float(10.0 * middle)
        self.estimates.publish(answer)


def main():
    rclpy.init()
    rclpy.spin(OwnPerception())


if __name__ == '__main__':
    main()
