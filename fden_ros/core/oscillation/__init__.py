# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an oscillation of the probe shows: complex moduli, and stiffness along a path."""

from fden_ros.core.oscillation.complex_modulus import (
    LEAST_AMPLITUDE,
    ComplexModulus,
    ComplexModulusMeter,
)
from fden_ros.core.oscillation.local_stiffness import Stiffness
from fden_ros.core.oscillation.palpation import Palpated, PalpationMeter
from fden_ros.core.oscillation.palpation_frequency import PalpationFrequency

__all__ = [
    "LEAST_AMPLITUDE",
    "ComplexModulus",
    "ComplexModulusMeter",
    "Palpated",
    "PalpationFrequency",
    "PalpationMeter",
    "Stiffness",
]
