# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The FDEN law: geometry, characteristic, fractional memory, response at nodes."""

from fden_ros.core.law.apparent_stiffness import (
    ApparentStiffness,
    LogStiffness,
    log_stiffness,
    log_stiffness_at,
)
from fden_ros.core.law.characteristic import (
    MAX_EXPONENT,
    apparent_stiffness_factor,
    elastic_response,
    elastic_responses,
    exponential_scale,
    log_phi,
    log_strain,
    phi,
    strain_of_phi,
)
from fden_ros.core.law.geometry import (
    FlatPunch,
    Geometry,
    GeometryConfig,
    PassThrough,
    Sphere,
    TorsionalRheometer,
)
from fden_ros.core.law.layer import LAYER_TERMS, hayes_factor
from fden_ros.core.law.relaxation import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    RATE_COUNT,
    RATES,
    SHORTEST_STEP,
    SPACING,
    StressMoments,
    creep_weights,
    left_after,
    memory_weights,
    passed,
    relaxation_weights,
)
from fden_ros.core.law.stress_memory import LETTING_GO, StressMemory

__all__ = [
    "HIGHEST_ORDER",
    "LAYER_TERMS",
    "LETTING_GO",
    "LOWEST_ORDER",
    "MAX_EXPONENT",
    "RATES",
    "RATE_COUNT",
    "SHORTEST_STEP",
    "SPACING",
    "ApparentStiffness",
    "FlatPunch",
    "Geometry",
    "GeometryConfig",
    "LogStiffness",
    "PassThrough",
    "Sphere",
    "StressMemory",
    "StressMoments",
    "TorsionalRheometer",
    "apparent_stiffness_factor",
    "creep_weights",
    "elastic_response",
    "elastic_responses",
    "exponential_scale",
    "hayes_factor",
    "left_after",
    "log_phi",
    "log_stiffness",
    "log_stiffness_at",
    "log_strain",
    "memory_weights",
    "passed",
    "phi",
    "relaxation_weights",
    "strain_of_phi",
]
