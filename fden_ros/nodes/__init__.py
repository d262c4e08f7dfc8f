# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""ROS shells: nodes over the pure core."""

import fden_ros.one_thread  # noqa: F401
