"""ROS shells: nodes over the pure core."""
