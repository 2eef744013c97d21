"""A perception of somebody who knows no taxinet: from the true odometry, with noise that it claims.

``others_perception.py pose`` publishes PoseWithCovarianceStamped, ``line`` PolygonStamped; with a
second word, ``wrong``, the covariance is none.
"""

import contextlib
import math
import sys

import rclpy
from geometry_msgs.msg import Point32, PolygonStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

SIGMA_M, SIGMA_RAD, BOTH = 0.5, 0.02, 0.004
KIND, WRONG = ''.join(sys.argv[1:2]), 'wrong' in sys.argv


class Localiser(Node):
    def __init__(self):
        super().__init__('localiser')
        kind = {'pose': PoseWithCovarianceStamped, 'line': PolygonStamped}[KIND]
        self.said = self.create_publisher(kind, KIND, 16)
        self.create_subscription(Odometry, 'ground_truth/odom', getattr(self, KIND), 16)

    def pose(self, odometry):
        told = PoseWithCovarianceStamped(header=odometry.header)
        told.pose.pose = odometry.pose.pose
        told.pose.pose.position.y += noise_m(odometry)
        covariance = [0.0] * 36
        covariance[7], covariance[35] = SIGMA_M**2, -1.0 if WRONG else SIGMA_RAD**2
        covariance[11] = covariance[31] = BOTH
        told.pose.covariance = covariance
        self.said.publish(told)

    def line(self, odometry):
        """Where the centreline is 5 and 20 m ahead along the runway, seen from the aircraft."""
        at, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        yaw = 2 * math.atan2(turn.z, turn.w)
        told = PolygonStamped(header=odometry.header)
        told.polygon.points = [
            Point32(x=x * math.cos(yaw) - at.y * math.sin(yaw),
                    y=-x * math.sin(yaw) - at.y * math.cos(yaw)) for x in (5.0, 20.0)
        ]
        self.said.publish(told)


def noise_m(odometry):
    """0.4 m to either side, and every fourth time 0.8 m."""
    seq = odometry.header.stamp.sec * 10 + odometry.header.stamp.nanosec // 100_000_000
    return (0.8 if seq % 4 == 0 else 0.4) * (-1) ** seq


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Localiser())


if __name__ == '__main__':
    main()
