"""ROS shells: nodes over the pure core."""

import fden_ros.one_thread  # noqa: F401
