"""Bridge from perception messages of others to ``TrackingError``; needs only rclpy and messages.

It turns ``pose`` (geometry_msgs/PoseWithCovarianceStamped: the aircraft in ``map``, the runway's
frame, with what is claimed of y and yaw) and ``line`` (geometry_msgs/PolygonStamped, in place of
the line detections of vision_msgs: a near and a far point of the centreline in ``base_link``, of
which nothing is claimed) into estimates. Whoever publishes these copies the stamp of the camera
frame. How to start both by one command: docs/ros.md.
"""

import contextlib
import math

import rclpy
from geometry_msgs.msg import PolygonStamped, PoseWithCovarianceStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from taxinet_msgs.msg import NodeStatus, Scenario, TrackingError

EACH_STEP = QoSProfile(depth=16)  # reliable, volatile
LATCHED = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STEP_NS = 10**9 // 10  # 10 Hz; of another rate, Scenario.camera has control_rate_hz
Y, YAW = 1, 5  # of the six rows x, y, z, roll, pitch, yaw
ASKED, TOLD = ('camera/image_raw', 'ground_truth/odom'), ('pose', 'line')


class PerceptionBridge(Node):
    def __init__(self):
        super().__init__('perception')
        self.scenario, self.run_id = None, ''
        self.status = self.create_publisher(NodeStatus, 'node_status', LATCHED)
        self.estimates = self.create_publisher(
            TrackingError, 'perception/tracking_error', EACH_STEP)
        self.create_subscription(PoseWithCovarianceStamped, 'pose', self.take_pose, EACH_STEP)
        self.create_subscription(PolygonStamped, 'line', self.take_line, EACH_STEP)
        self.create_subscription(Scenario, 'scenario', self.begin, LATCHED)
        self.create_timer(0.02, self.get_ready)

    def begin(self, scenario):
        if self.get_name() in scenario.participants:
            self.scenario = scenario

    def get_ready(self):
        """Report READY once per run, when those who publish for it hear what they need."""
        if (run := self.scenario) is None:
            return
        listeners = {'steering_controller', 'mtl_monitor', 'recorder'} & set(run.participants)
        theirs = {end.node_name for one in TOLD for end in self.get_publishers_info_by_topic(one)}
        theirs.discard('_NODE_NAME_UNKNOWN_')  # soon known
        heard = [
            f'{one}@{end.node_name}' for one in ASKED
            for end in self.get_subscriptions_info_by_topic(one) if end.node_name in theirs
        ]
        if heard and self.estimates.get_subscription_count() > len(listeners):
            self.scenario, self.run_id = None, run.run_id
            self.status.publish(NodeStatus(
                run_id=run.run_id, node=self.get_name(), state=NodeStatus.READY,
                implementation='bridge', listens=['scenario', *heard],
            ))

    def take_pose(self, said):
        turn, claimed = said.pose.pose.orientation, said.pose.covariance
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y),
                         1 - 2 * (turn.y * turn.y + turn.z * turn.z))
        self.answer(said.header, said.pose.pose.position.y, yaw,
                    [float(claimed[6 * row + column]) for row in (Y, YAW) for column in (Y, YAW)])

    def take_line(self, said):
        near, far = said.polygon.points
        ahead, left = far.x - near.x, far.y - near.y
        aside = (left * near.x - ahead * near.y) / math.hypot(ahead, left)
        self.answer(said.header, aside, -math.atan2(left, ahead), [0.0] * 4)

    def answer(self, header, cross_track, heading, covariance):
        seq = (header.stamp.sec * 1_000_000_000 + header.stamp.nanosec) // STEP_NS
        header.frame_id = 'map'
        self.estimates.publish(TrackingError(
            header=header, run_id=self.run_id, seq=seq, cross_track_error=cross_track,
            heading_error=heading, valid=True, covariance=covariance,
        ))


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(PerceptionBridge())


if __name__ == '__main__':
    main()
