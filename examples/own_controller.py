"""Controller node that needs only rclpy and the message package.

Start it in every graph: ``taxinet run s_falsif --controller 'cmd:python3 own_controller.py'``. Test
it against the contract: ``taxinet check-node 'python3 own_controller.py'``.
"""

import contextlib
import math

import rclpy
from rclpy.executors import ExternalShutdownException
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
        self.create_subscription(TrackingError, 'perception/tracking_error', self.steer, EACH_STEP)
        self.create_subscription(Scenario, 'scenario', self.begin, LATCHED)
        self.create_timer(0.02, self.get_ready)

    def begin(self, scenario):
        """Begin a run; a controller with state resets it here."""
        if self.get_name() in scenario.participants:
            self.scenario = scenario

    def get_ready(self):
        """Report READY once per run, when all connections are established."""
        if (run := self.scenario) is None:
            return
        listeners = {'simulator', 'mtl_monitor', 'recorder'} & {'simulator', *run.participants}
        if self.commands.get_subscription_count() >= len(listeners) \
                and self.count_publishers('perception/tracking_error'):
            self.scenario = None
            self.status.publish(NodeStatus(
                run_id=run.run_id, node=self.get_name(), state=NodeStatus.READY,
                implementation='proportional', listens=['perception/tracking_error', 'scenario'],
            ))

    def steer(self, estimate):
        """Publish one command per estimate, with the estimate's stamp, run and step."""
        command = TaxiCommand(header=estimate.header, run_id=estimate.run_id, seq=estimate.seq)
        command.header.frame_id = 'base_link'
        angle = -0.05 * estimate.cross_track_error - 1.2 * estimate.heading_error
        if estimate.valid and math.isfinite(angle):  # else nose wheel straight, brakes on
            command.steering_angle, command.speed = max(-0.26, min(0.26, angle)), 5.0
        self.commands.publish(command)


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OwnController())


if __name__ == '__main__':
    main()
