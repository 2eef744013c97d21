"""Benchmarks: subjects measured side by side on one machine, in one run. No ROS."""
