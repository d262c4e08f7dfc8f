"""Recordings: rosbag2 folders and MCAP files, read and written without ``ros2 bag``."""
