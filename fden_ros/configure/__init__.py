# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a recording says of a probe nobody has configured: findings, and a parameter file of them.

One module per idea; each finding states its value, its deviation, the seconds it rests on, and
what to do where the recording cannot tell.
"""
