# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: bags and text tables, read and written without ``ros2 bag``.

Invalid input or output raises :class:`~fden_ros.errors.InputError`: one line with the problem
and its solution.
"""
