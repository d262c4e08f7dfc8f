"""Between ROS messages and the core: projection, decoding, status, markers."""
