# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From blocks of samples to parameters with their covariance: one weighted sum over a grid.

Other rooms use the names below. Those that compute are imported when one is first asked for: who
reads an estimate needs no solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fden_ros.core.estimation.claims import (
    claims_of,
    converged,
    determined,
    widened,
)
from fden_ros.core.estimation.estimate import (
    KEYS,
    PUBLISHED,
    Budget,
    Component,
    Estimate,
    LawError,
    ParameterSet,
    StateIndex,
    moments,
)
from fden_ros.core.estimation.estimator_config import (
    NOTHING_UNKNOWN,
    EstimatorConfig,
    EstimatorKind,
    Prior,
    Uncertainty,
)
from fden_ros.core.estimation.face import Estimator, Innovation, Setting, Touch

if TYPE_CHECKING:
    from fden_ros.core.estimation.discrepancy import kernel_change
    from fden_ros.core.estimation.estimator import GridEstimator
    from fden_ros.core.estimation.record import MOST_BLOCKS
    from fden_ros.core.estimation.small_motion import log_stiffness, stress_ahead

__all__ = [
    "KEYS",
    "MOST_BLOCKS",
    "NOTHING_UNKNOWN",
    "PUBLISHED",
    "Budget",
    "Component",
    "Estimate",
    "Estimator",
    "EstimatorConfig",
    "EstimatorKind",
    "GridEstimator",
    "Innovation",
    "LawError",
    "ParameterSet",
    "Prior",
    "Setting",
    "StateIndex",
    "Touch",
    "Uncertainty",
    "claims_of",
    "converged",
    "determined",
    "kernel_change",
    "log_stiffness",
    "moments",
    "stress_ahead",
    "widened",
]

_LATER = {
    "GridEstimator": "estimator",
    "MOST_BLOCKS": "record",
    "kernel_change": "discrepancy",
    "log_stiffness": "small_motion",
    "stress_ahead": "small_motion",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _LATER:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import importlib

        return getattr(importlib.import_module(f"{__name__}.{_LATER[name]}"), name)
