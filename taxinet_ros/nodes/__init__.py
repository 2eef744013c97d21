"""The ROS 2 nodes: thin shells that move messages between the graph and the core."""

import os
from pathlib import Path

# Read by Fast DDS when the first node of a process is made, and by the nodes that it starts in
# turn; rclpy has no way to say it. Whoever has a profile of his own keeps it.
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(Path(__file__).with_name('dds.xml')))
