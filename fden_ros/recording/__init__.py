# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: rosbag2 folders and MCAP files, read and written without ``ros2 bag``."""
