"""The ROS 2 nodes: thin shells that move messages between the graph and the core.

Importing it raises :class:`.UsageError` for variables with which rclpy would end the process.
"""

import os
import subprocess
import sys
from pathlib import Path

from taxinet_ros.errors import UsageError

_RMW, _RANGE = 'RMW_IMPLEMENTATION', 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
_LOAD = 'from rclpy.impl.implementation_singleton import rclpy_implementation'
if os.environ.get(_RANGE) and os.environ[_RANGE] not in _RANGES:
    raise UsageError(f'{_RANGE}={os.environ[_RANGE]}: unknown; known: {", ".join(_RANGES)}')
# librcl exits with 102 where it cannot load the middleware, so another process asks.
if os.environ.get(_RMW, '') not in ('', 'rmw_fastrtps_cpp') and 'rclpy' not in sys.modules and (
    subprocess.run([sys.executable, '-c', _LOAD], capture_output=True, check=False).returncode
) == 102:
    words = f'{_RMW}={os.environ[_RMW]}: this ROS 2 has no such middleware'
    raise UsageError(f'{words}; unset {_RMW}, or install it')

# Read by Fast DDS when the first node of a process is created, and inherited by child processes;
# rclpy has no API for it. A profile set by the user is kept.
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(Path(__file__).with_name('dds.xml')))
