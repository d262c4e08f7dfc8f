# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Synthetic tissue and scenarios, the truth for tests and demonstrations.

Shares no numerics with :mod:`fden_ros.core`.
"""
