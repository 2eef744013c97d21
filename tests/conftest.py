"""What every test shares: strict messages, discovery on this machine only, no leftovers."""

from __future__ import annotations

import os

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
