# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Why a contact has not converged, in numbers, and what is the cheapest remedy: in one line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.budget import Budget
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law.characteristic import elastic_response, strain_of_phi
from fden_ros.core.law.geometry import FlatPunch, Geometry, Sphere
from fden_ros.core.outputs import WITHHELD, ContactSummary

#: Sources of a budget in words.
WORDS: Mapping[str, str] = {
    "noise": "noise",
    "drift": "drift",
    "friction": "friction",
    "motion": "motion of the surface",
    "compliance": "compliance",
    "delay": "delay",
    "surface": "the place of the surface",
    "law": "errors of the law",
    "thickness": "thickness",
    "prior": "what the prior leaves open",
}
#: What a larger force makes smaller.
_BY_FORCE = ("noise", "drift", "friction")
#: Sources named at most.
_NAMED = 4
#: No soft tissue is pressed farther, as a part of its thickness or of the probe's radius; nobody
#: presses to more than this many times the force, or uses a face that is as many times as large.
LARGEST_COMPRESSION, _MOST_TIMES = 0.7, 30.0
#: Gn shows where the strain passes 1/Gn; at this many times of it, it surely has.
_BEYOND_BOUNDARY = 1.5
#: Where the surface was not seen, ln G has this part of the prior's variance at least.
_HIDDEN = 0.9
_NAMES = ("G", "Gn")


def shortfall(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what a contact that has not converged lacks, why, and what would help.

    Empty where it has converged, or where a flag or the end of a range says why.
    """
    why, remedy = _reason(summary, config), cure(summary, config)
    return f"{why}; {remedy}" if why and remedy else why


def cure(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return the cheapest remedy for a contact that has not converged; empty: none is known."""
    estimate, budget = summary.estimate, summary.budget
    if estimate is None or not _is_open(summary):
        return ""
    if budget is not None and _is_hidden(estimate, budget, config.estimator):
        return _uncover(estimate, budget, config.geometry)
    if not estimate.determines(1):
        return deeper(summary.max_strain, estimate.nonlinear_stiffness, config.geometry)
    poor = _poor(estimate, config.estimator)
    largest = budget.largest(poor[0]) if budget is not None and poor else ()
    if budget is None or not largest:
        return "press here once more"
    # What is open of Gn and alpha is so because of the others.
    source = next((name for name in largest if name != "prior"), "prior")
    return _REMEDIES[source](_Case(summary, estimate, budget, config, poor[0]))


def deeper(strain: float, gn: float, geometry: Geometry) -> str:
    """Return how far to press for Gn; a strain that was reached without a bend is too small."""
    compression = geometry.compression(wanted_strain(strain, gn))
    if compression > LARGEST_COMPRESSION:
        return "it hardly stiffens this far, so Gn is not seen"
    return f"press to {1e3 * geometry.length * compression:.2g} mm for Gn"


def wanted_strain(strain: float, gn: float) -> float:
    """Return the strain at which Gn shows, after one that was reached [1]."""
    return max(_BEYOND_BOUNDARY / gn, _BEYOND_BOUNDARY * strain)


def _is_open(summary: ContactSummary) -> bool:
    estimate = summary.estimate
    is_closed = summary.converged or estimate is None or bool(estimate.at_edge)
    return not (is_closed or summary.flags & WITHHELD)


def _limits(config: EstimatorConfig) -> tuple[float, float]:
    return config.converged_linear_log_sd, config.converged_log_sd


def _poor(estimate: Estimate, config: EstimatorConfig) -> list[int]:
    """Return the places of what is not known closely enough: G before Gn."""
    return [k for k, most in enumerate(_limits(config)) if estimate.deviations[k] > most]


def _is_hidden(estimate: Estimate, budget: Budget, config: EstimatorConfig) -> bool:
    """Whether G is open because no surface was seen, though the force is known."""
    added = float(estimate.covariance[0, 0]) - budget.variances[0]
    return added > _HIDDEN * config.prior.linear_stiffness_log_sd**2


def _reason(summary: ContactSummary, config: PipelineConfig) -> str:
    estimate, budget = summary.estimate, summary.budget
    if estimate is None or not _is_open(summary):
        return ""
    if budget is not None and _is_hidden(estimate, budget, config.estimator):
        noise = quantity(budget.stress_noise / config.geometry.stress_per_force, "N")
        return f"{noise} of noise hide the linear part, so that G is not seen"
    if not estimate.determines(1):
        known = "G is known, " if estimate.knows(0) else ""
        return (
            f"{known}Gn is not observable: the strain reached {summary.max_strain:.3f} and did "
            f"not surely pass the boundary 1/Gn, about {estimate.boundary_strain:.3f}"
        )
    poor = _poor(estimate, config.estimator)
    if not poor:
        return "the press is not explained yet"
    why = ", ".join(f"{_NAMES[k]} is known to {_percent(estimate, k)}" for k in poor) + " only"
    if budget is None:
        return why
    parts = [
        f"{WORDS[name]} {100.0 * budget.share(name, poor[0]):.0f} %"
        for name in budget.largest(poor[0])[:_NAMED]
    ]
    return f"{why} (of the variance: {', '.join(parts)})" if parts else why


def _percent(estimate: Estimate, index: int) -> str:
    """Return the deviation of G or Gn, as a factor where it is as large as the number."""
    sd = float(estimate.deviations[index])
    if sd < 1.0:
        return f"{100.0 * sd:.0f} %"
    return f"a factor of {math.exp(min(sd, 20.0)):.2g}"


# Remedies


class _Case:
    """A contact that has not converged, and what is asked of it."""

    def __init__(
        self,
        summary: ContactSummary,
        estimate: Estimate,
        budget: Budget,
        config: PipelineConfig,
        index: int,
    ) -> None:
        self.summary, self.estimate, self.budget = summary, estimate, budget
        self.config, self.index = config, index
        self.stated = config.estimator.uncertainty

    @property
    def force(self) -> str:
        """The largest force."""
        return quantity(self.summary.max_force, "N")

    @property
    def times(self) -> float:
        """How many times the force would be enough; infinite: no force."""
        wanted = _limits(self.config.estimator)[self.index] ** 2
        whole = self.budget.variances[self.index]
        by_force = sum(self.budget.parts[name][self.index] for name in _BY_FORCE)
        rest = max(whole - by_force, 0.0)
        return math.sqrt(by_force / (wanted - rest)) if rest < wanted else math.inf

    def or_more(self) -> str:
        """Return how hard to press instead, or nothing where that would not do."""
        times = self.times
        if not 1.0 < times < _MOST_TIMES:
            return ""
        return f", or press to {quantity(times * self.summary.max_force, 'N', up=True)}"


def _of_noise(case: _Case) -> str:
    geometry, times = case.config.geometry, case.times
    noise = quantity(case.budget.stress_noise / geometry.stress_per_force, "N")
    if not 1.0 < times < _MOST_TIMES:
        return f"a sensor with less than {noise} of noise, or a longer press"
    ways = [face(geometry, times), _strain(case, times)]
    listed = " or ".join(way for way in ways if way)
    return f"with {noise} of noise it takes {listed or 'a quieter sensor'}"


def _strain(case: _Case, times: float) -> str:
    """Return the strain at which the force is so many times as large; empty: too far."""
    estimate, geometry = case.estimate, case.config.geometry

    reached = case.summary.max_strain
    if reached <= 0.0:
        return ""
    gn = estimate.nonlinear_stiffness
    wanted = times * elastic_response(reached, 1.0, gn).value
    strain = float(strain_of_phi(np.array([wanted]), 1.0, gn)[0])
    return f"a strain of {strain:.2g}" if strain <= geometry.strain(LARGEST_COMPRESSION) else ""


def _of_friction(case: _Case) -> str:
    friction = quantity(case.stated.friction_sd, "N")
    return (
        f"friction of {friction} is assumed and the press had {case.force}: state "
        f"force.friction_sd, use config/bench.yaml on a rigid rig{case.or_more()}"
    )


def _of_drift(case: _Case) -> str:
    drift = quantity(case.stated.force_drift_sd, "N")
    return (
        f"drift of {drift} in a second is assumed and the press had {case.force}: state "
        f"force.drift_sd, press faster{case.or_more()}"
    )


def _of_motion(case: _Case) -> str:
    motion = quantity(case.stated.surface_motion_sd, "m")
    return (
        f"{motion} of motion of the surface in a second is assumed: state surface.motion_sd, or "
        "press faster"
    )


def _of_compliance(case: _Case) -> str:
    compliance = quantity(case.stated.compliance_sd, "m")
    return f"a compliance of {compliance}/N is assumed: state displacement.compliance_sd"


def _of_delay(case: _Case) -> str:
    delay = quantity(case.stated.delay_sd, "s")
    return f"a delay of {delay} is assumed: fden configure measures it"


def _of_surface(case: _Case) -> str:
    place = quantity(case.budget.surface_sd * case.config.geometry.length, "m")
    return f"the surface was found to {place}: touch it slower"


def _of_law(case: _Case) -> str:
    return "the tissue is not quite the law's (model_error.sd): hold for 2 s, and press here again"


def _of_thickness(case: _Case) -> str:
    thickness = 100.0 * case.stated.thickness_sd
    return f"a thickness known to {thickness:.2g} % is assumed: state geometry.thickness_sd"


def _of_prior(case: _Case) -> str:
    return "hold for 2 s for alpha, or press deeper for Gn"


_REMEDIES: Mapping[str, Callable[[_Case], str]] = {
    "noise": _of_noise,
    "drift": _of_drift,
    "friction": _of_friction,
    "motion": _of_motion,
    "compliance": _of_compliance,
    "delay": _of_delay,
    "surface": _of_surface,
    "law": _of_law,
    "thickness": _of_thickness,
    "prior": _of_prior,
}


def _uncover(estimate: Estimate, budget: Budget, geometry: Geometry) -> str:
    """Return what shows the linear part: the stress at the boundary above the noise."""
    linear = estimate.linear_stiffness / estimate.nonlinear_stiffness
    times = max(budget.stress_noise / linear, 2.0)
    larger = face(geometry, times) if times < _MOST_TIMES else ""
    return f"it takes {larger or 'a quieter sensor'}, or a place of the surface that is given"


def face(geometry: Geometry, times: float) -> str:
    """Return a probe that meets so many times the force at the same strain; empty: not known."""
    root = math.sqrt(times)
    if isinstance(geometry, FlatPunch):
        diameter = 2.0 * math.sqrt(geometry.area / math.pi) * root
        return f"a face of {quantity(diameter, 'm', up=True)}"
    if isinstance(geometry, Sphere):
        return f"a sphere of {quantity(geometry.radius * root, 'm', up=True)} radius"
    return ""


def quantity(value: float, unit: str, *, up: bool = False) -> str:
    """Return a quantity with two digits, in thousandths of its unit where it is small."""
    size, prefix = (value, "") if abs(value) >= 0.5 else (1e3 * value, "m")
    if size <= 0.0:
        return f"0 {prefix}{unit}"
    step = 10.0 ** (math.floor(math.log10(size)) - 1)
    rounded = step * (math.ceil(size / step - 1e-9) if up else round(size / step))
    return f"{rounded:.{max(0, -math.floor(math.log10(step)))}f} {prefix}{unit}"
