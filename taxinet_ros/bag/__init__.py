"""Run bags: writing, reading, repairing and decoding them, without ROS."""
