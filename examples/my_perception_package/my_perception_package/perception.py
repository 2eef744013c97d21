"""Perception node that needs only rclpy, NumPy and the message package.

Start it in every graph: ``taxinet run s_falsif --perception 'cmd:python3 perception.py'``, or in a
graph that waits for it: ``taxinet up --perception external``. Test it against the contract:
``taxinet check-node 'python3 perception.py'``. It takes the mean position of the bright paint in
the lower half of the frame as the centreline, which is a poor estimate.
"""

import contextlib

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from taxinet_msgs.msg import NodeStatus, Scenario, TrackingError

EACH_STEP = QoSProfile(depth=16)  # reliable, volatile
LATCHED = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STEP_NS = 10**9 // 10  # 10 Hz; of another rate, Scenario.camera has control_rate_hz


class OwnPerception(Node):
    def __init__(self):
        super().__init__('perception')
        self.scenario, self.run_id = None, ''
        self.status = self.create_publisher(NodeStatus, 'node_status', LATCHED)
        self.estimates = self.create_publisher(
            TrackingError, 'perception/tracking_error', EACH_STEP)
        self.create_subscription(Image, 'camera/image_raw', self.see, EACH_STEP)
        self.create_subscription(Scenario, 'scenario', self.begin, LATCHED)
        self.create_timer(0.02, self.get_ready)

    def begin(self, scenario):
        """Begin a run; a perception with state resets it here."""
        if self.get_name() in scenario.participants:
            self.scenario = scenario

    def get_ready(self):
        """Report READY once per run, when all connections are established."""
        if (run := self.scenario) is None:
            return
        listeners = {'steering_controller', 'mtl_monitor', 'recorder'} & set(run.participants)
        if self.estimates.get_subscription_count() > len(listeners) \
                and self.count_publishers('camera/image_raw'):  # > : and the simulator
            self.scenario, self.run_id = None, run.run_id
            self.status.publish(NodeStatus(
                run_id=run.run_id, node=self.get_name(), state=NodeStatus.READY,
                implementation='bright paint', listens=['camera/image_raw', 'scenario'],
            ))

    def see(self, image):
        """Publish one estimate per frame; the control step follows from the frame's stamp."""
        stamp = image.header.stamp
        answer = TrackingError(header=image.header, run_id=self.run_id)
        answer.header.frame_id = 'map'
        answer.seq = (stamp.sec * 1_000_000_000 + stamp.nanosec) // STEP_NS
        if (image.encoding, len(image.data)) == ('rgb8', 200 * 360 * 3):
            frame = np.frombuffer(image.data, np.uint8).reshape(200, 360, 3)
            bright = np.nonzero(frame[100:].min(axis=2) > 200)[1]
            answer.valid = bool(bright.size)
            if answer.valid:
                answer.cross_track_error = float(10.0 * (bright.mean() / 360 - 0.5))
        self.estimates.publish(answer)


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OwnPerception())


if __name__ == '__main__':
    main()
