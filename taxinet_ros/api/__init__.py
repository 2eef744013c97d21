"""Public Python API, without ROS; ``taxinet_ros/__init__.py`` lists its names."""
