# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""For controllers: what may be relied on, what will happen, and a force controller that uses it.

Free of ROS, like :mod:`fden_ros.core`.
"""
