# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Findings of recordings about an unconfigured probe, and a parameter file of them."""
