"""The ROS 2 nodes: thin shells that move messages between the graph and the core."""

import os
from pathlib import Path

# Read by Fast DDS when the first node of a process is created, and inherited by child processes;
# rclpy has no API for it. A profile set by the user is kept.
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(Path(__file__).with_name('dds.xml')))
