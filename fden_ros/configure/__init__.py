# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What recordings show of a probe nobody has configured, and a parameter file of it."""
