"""Pictures and figures made from runs. No ROS."""
