# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: bags and text tables, read and written without ``ros2 bag``.

What cannot be read or written raises :class:`~fden_ros.errors.InputError`: one line that says what
is wrong and what would be right.
"""
