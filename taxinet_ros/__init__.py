"""Closed-loop testing of vision-based aircraft taxiing on ROS 2."""

__version__ = '0.1.0'
