# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Identify soft tissue online with the FDEN model: fractional dynamics, exponential stress."""

__version__ = "0.1.0"
