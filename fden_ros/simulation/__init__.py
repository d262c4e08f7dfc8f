# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated tissue and a rig over it in time steps, for the live simulator.

Shares no numerics with :mod:`fden_ros.core`. Simulated recordings stand beside the package, in
``simulation/``.
"""
