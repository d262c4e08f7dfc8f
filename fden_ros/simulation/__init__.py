# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated tissue and a rig over it in time steps, for the live simulator.

Shares no numerics with :mod:`fden_ros.core`. Simulated recordings are outside the package, in
``simulation/``.
"""

from fden_ros.simulation.model import FdenModel, FloatArray
from fden_ros.simulation.rig import Command, Rig, RigConfig
from fden_ros.simulation.tissue import Column, Inclusion, Relaxation, Tissue

__all__ = [
    "Column",
    "Command",
    "FdenModel",
    "FloatArray",
    "Inclusion",
    "Relaxation",
    "Rig",
    "RigConfig",
    "Tissue",
]
