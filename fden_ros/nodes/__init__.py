# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""ROS shells: nodes over the pure core."""

from fden_ros.one_thread import start_no_threads

start_no_threads()
