"""Names of the topics of a run as its bag has them, for those who read without ROS.

``nodes/interface.py`` is the graph's table; a test holds the two against each other.
"""

from __future__ import annotations

SCENARIO = 'scenario'
NODE_STATUS = 'node_status'
CLOCK = 'clock'
IMAGE = 'camera/image_raw'
CAMERA_INFO = 'camera/camera_info'
ODOMETRY = 'ground_truth/odom'
TRUTH = 'ground_truth/tracking_error'
ESTIMATE = 'perception/tracking_error'
COMMAND = 'taxi_command'
ROBUSTNESS = 'monitor/robustness'
VERDICT = 'monitor/verdict'
RUN_STATUS = 'run_status'
TF, TF_STATIC = 'tf', 'tf_static'

MAP_FRAME = 'map'
BASE_FRAME = 'base_link'
CAMERA_FRAME = 'camera_optical'

ONCE = frozenset({SCENARIO, NODE_STATUS, TF_STATIC, VERDICT, RUN_STATUS})
"""Topics that do not speak in every control step; all others of a run do."""


def is_topic(name: str, relative: str) -> bool:
    """Whether ``name`` is the topic ``relative``, whatever namespace it was recorded in."""
    return name == relative or name.endswith('/' + relative)


def is_of_frames(name: str) -> bool:
    """Whether a topic is of transforms, which follow from odometry, and on which anybody speaks."""
    return is_topic(name, TF) or is_topic(name, TF_STATIC)
