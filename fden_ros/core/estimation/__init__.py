# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From blocks of stress and compression to parameters with their covariance.

Other rooms use the names below. Those that solve are imported when one is first asked for: who
reads an estimate needs no solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.claims import (
    EDGE,
    Claims,
    Evidence,
    Reservations,
    claims_of,
    converged,
    determined,
    reserved,
)
from fden_ros.core.estimation.estimate import (
    KEYS,
    PUBLISHED,
    Budget,
    Estimate,
    LawError,
    ParameterSet,
    StateIndex,
)
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import (
    NOTHING_UNKNOWN,
    EstimatorConfig,
    EstimatorKind,
    Prior,
    Uncertainty,
)
from fden_ros.core.estimation.mixture import Component, moments
from fden_ros.core.estimation.parts import ended
from fden_ros.core.estimation.small_motion import log_stiffness
from fden_ros.core.estimation.smooth_errors import kernel_change
from fden_ros.core.estimation.whiteness import NO_CHANCE

if TYPE_CHECKING:
    from fden_ros.core.estimation.posterior_estimator import PosteriorEstimator

__all__ = [
    "EDGE",
    "KEYS",
    "NOTHING_UNKNOWN",
    "NO_CHANCE",
    "PUBLISHED",
    "Block",
    "Budget",
    "Claims",
    "Component",
    "Estimate",
    "Estimator",
    "EstimatorConfig",
    "EstimatorKind",
    "Evidence",
    "Innovation",
    "LawError",
    "ParameterSet",
    "Points",
    "PosteriorEstimator",
    "Prior",
    "Reservations",
    "StateIndex",
    "Uncertainty",
    "claims_of",
    "converged",
    "determined",
    "ended",
    "kernel_change",
    "log_stiffness",
    "moments",
    "reserved",
]

_LATER = {
    "PosteriorEstimator": "posterior_estimator",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _LATER:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import importlib

        return getattr(importlib.import_module(f"{__name__}.{_LATER[name]}"), name)
