"""What every test shares: strict messages, discovery on this machine only, no leftovers."""

from __future__ import annotations

import os

from hypothesis import settings

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

# How long an example takes is the machine's affair; pytest's timeout ends what hangs.
settings.register_profile('untimed', deadline=None)
settings.load_profile('untimed')
