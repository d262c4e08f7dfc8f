# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Why a contact has not converged, in numbers, and what is the cheapest remedy: in one line."""

from __future__ import annotations

import math

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Budget, Estimate, EstimatorConfig
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import WITHHELD, ContactSummary, Flag
from fden_ros.offline.remedies import LARGEST_COMPRESSION, WORDS, Case, remedy, uncover
from fden_ros.written import quantity, written

#: Sources named at most.
_NAMED = 4
#: Gn shows where the strain passes 1/Gn; at this many times of it, it surely has.
_BEYOND_BOUNDARY = 1.5
_NAMES = ("G", "Gn")


def shortfall(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what a contact that has not converged lacks, why, and what would help.

    Empty where it has converged, or where a flag or the end of a range says why.
    """
    why, mend = _reason(summary, config), cure(summary, config)
    return f"{why}; {mend}" if why and mend else why


def cure(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what would help a contact that has not converged.

    Empty: nothing is known that would.
    """
    estimate, budget = summary.estimate, summary.budget
    if summary.flags & Flag.TOUCH_NOT_OBSERVED and not summary.is_of_path:
        return "begin 1 s in the air, and touch faster or with a larger face, for G and Gn"
    if estimate is None or not _is_open(summary):
        return ""
    if budget is not None and _is_linear_part_hidden(estimate, budget):
        return uncover(budget, config.geometry, estimate.boundary_stress)
    mend = _by_largest_source(summary, config)
    if not estimate.determines(1):
        gn = estimate.nonlinear_stiffness
        return mend or deeper(summary.max_strain, gn, config.geometry)
    return mend or "press here once more"


def _by_largest_source(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return the remedy for what makes G or Gn most uncertain; empty: none is known."""
    estimate, budget = summary.estimate, summary.budget
    poor = _poor(estimate, config.estimator) if estimate is not None else []
    if estimate is None or budget is None or not poor:
        return ""
    case = Case(
        config,
        budget,
        poor[0],
        _limits(config.estimator)[poor[0]],
        estimate.nonlinear_stiffness,
        summary.max_force,
        summary.max_strain,
    )
    return remedy(case)


def deeper(strain: float, gn: float, geometry: Geometry) -> str:
    """Return how far to press for Gn; a strain that was reached without a bend is too small."""
    compression = geometry.compression(wanted_strain(strain, gn))
    if compression > LARGEST_COMPRESSION:
        return "Gn is not observable at this depth, as it hardly stiffens"
    return f"press to {written(1e3 * geometry.length * compression, 2)} mm for Gn"


def wanted_strain(strain: float, gn: float) -> float:
    """Return the strain at which Gn shows, after one that was reached [1]."""
    return max(_BEYOND_BOUNDARY / gn, _BEYOND_BOUNDARY * strain)


def _is_open(summary: ContactSummary) -> bool:
    estimate = summary.estimate
    is_closed = summary.converged or estimate is None or bool(estimate.at_edge)
    return not (is_closed or summary.flags & WITHHELD)


def _limits(config: EstimatorConfig) -> tuple[float, float]:
    return config.converged_log_g_sd, config.converged_log_gn_sd


def _poor(estimate: Estimate, config: EstimatorConfig) -> list[int]:
    """Return the places of what is not known closely enough: G before Gn."""
    return [k for k, most in enumerate(_limits(config)) if estimate.deviations[k] > most]


def _is_linear_part_hidden(estimate: Estimate, budget: Budget) -> bool:
    """Whether G is open because the stress passes the noise beyond the boundary strain only."""
    return not estimate.knows(0) and estimate.boundary_stress < budget.stress_noise


def _reason(summary: ContactSummary, config: PipelineConfig) -> str:
    estimate, budget = summary.estimate, summary.budget
    if summary.flags & Flag.TOUCH_NOT_OBSERVED and not summary.is_of_path:
        return "the touch was not observed, in the recording or above noise and drift"
    if estimate is None or not _is_open(summary):
        return ""
    if budget is not None and _is_linear_part_hidden(estimate, budget):
        noise = quantity(budget.stress_noise / config.geometry.stress_per_force, "N")
        return f"{noise} of noise hide the linear part, so G is not observable"
    poor = _poor(estimate, config.estimator)
    if not estimate.determines(1):
        known = "G is known, " if estimate.knows(0) else ""
        return (
            f"{known}Gn is not observable: the strain reached {summary.max_strain:.3f} and did "
            f"not surely pass the boundary 1/Gn, about {estimate.boundary_strain:.3f}"
            f"{_sources(budget, poor[0] if poor else 1)}"
        )
    if not poor:
        return "not converged: the newest data fail the innovation test"
    why = ", ".join(f"{_NAMES[k]} is known to {_percent(estimate, k)}" for k in poor) + " only"
    return why + _sources(budget, poor[0])


def _sources(budget: Budget | None, index: int) -> str:
    """Return what the variance of ln G or ln Gn is made of, the largest first."""
    if budget is None:
        return ""
    largest = budget.largest(index)[:_NAMED]
    parts = [f"{WORDS[name]} {100.0 * budget.share(name, index):.0f} %" for name in largest]
    return f" (of the variance: {', '.join(parts)})" if parts else ""


def _percent(estimate: Estimate, index: int) -> str:
    """Return the deviation of G or Gn, as a factor where it is as large as the number."""
    sd = float(estimate.deviations[index])
    if sd < 1.0:
        return f"{100.0 * sd:.0f} %"
    return f"a factor of {written(math.exp(min(sd, 20.0)), 2)}"
