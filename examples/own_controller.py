"""A controller node of one's own, with nothing but rclpy and the message package.

Start it in every graph: ``taxinet run s_falsif --controller-cmd 'python3 own_controller.py'``.
"""

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from taxinet_msgs.msg import NodeStatus, Scenario, TaxiCommand, TrackingError

EACH_STEP = QoSProfile(depth=16)  # reliable, volatile
LATCHED = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class OwnController(Node):
    def __init__(self):
        super().__init__('steering_controller')
        self.scenario = None
        self.status = self.create_publisher(NodeStatus, 'node_status', LATCHED)
        self.commands = self.create_publisher(TaxiCommand, 'taxi_command', EACH_STEP)
        self.create_subscription(
            TrackingError, 'perception/tracking_error', self.steer, EACH_STEP)
        self.create_subscription(Scenario, 'scenario', self.get_ready, LATCHED)
        self.create_timer(0.02, self.report)

    def get_ready(self, scenario):
        """A run begins: a controller with a memory forgets the one before."""
        self.scenario = scenario

    def report(self):
        """Say READY once for a run, when all ends have found each other: see the docs."""
        run = self.scenario
        wanted = len({'simulator', 'mtl_monitor', 'recorder'} & {'simulator', *run.participants}) \
            if run else 0
        if run and self.commands.get_subscription_count() >= wanted \
                and self.count_publishers('perception/tracking_error'):
            self.scenario = None
            self.status.publish(NodeStatus(
                run_id=run.run_id, node='steering_controller', state=NodeStatus.READY,
                implementation='proportional', listens=['perception/tracking_error', 'scenario'],
            ))

    def steer(self, estimate):
        """One estimate in, one command out, with the estimate's stamp, run and step."""
        angle = -0.05 * estimate.cross_track_error - 1.2 * estimate.heading_error
        command = TaxiCommand(header=estimate.header, run_id=estimate.run_id, seq=estimate.seq)
        command.header.frame_id = 'base_link'
        if estimate.valid:  # without a usable estimate: nose wheel straight, brakes on
            command.steering_angle, command.speed = max(-0.26, min(0.26, angle)), 5.0
        self.commands.publish(command)


def main():
    rclpy.init()
    rclpy.spin(OwnController())


if __name__ == '__main__':
    main()
