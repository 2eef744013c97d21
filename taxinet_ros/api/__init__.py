"""What ``import taxinet_ros`` offers, without ROS; the names are listed in the package itself."""
