"""The ROS 2 nodes: thin shells that move messages between the graph and the core."""
