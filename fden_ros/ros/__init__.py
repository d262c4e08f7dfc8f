# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Between ROS messages and the core: projection, decoding, status, the map."""
