# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What makes an estimate uncertain, and the cheapest remedy for it, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.budget import Budget
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.law.characteristic import elastic_response, strain_of_phi
from fden_ros.core.law.geometry import FlatPunch, Geometry, Sphere

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
#: No soft tissue is pressed farther, as a part of its thickness or of the probe's radius; nobody
#: presses to more than this many times the force, or uses a face that is as many times as large.
LARGEST_COMPRESSION, _MOST_TIMES = 0.7, 30.0


@dataclass(frozen=True)
class Case:
    """A press that does not tell enough, and what is asked of it.

    Attributes
    ----------
    config : PipelineConfig
    budget : Budget
        Of its estimate.
    index : int
        0: G is open, 1: Gn.
    wanted : float
        Standard deviation of its logarithm that would do [1].
    nonlinear_stiffness : float
        Gn [1].
    max_force, max_strain : float
        That the press reached [N, 1].
    """

    config: PipelineConfig
    budget: Budget
    index: int
    wanted: float
    nonlinear_stiffness: float
    max_force: float
    max_strain: float

    @property
    def stated(self) -> Uncertainty:
        """What is stated of the rig."""
        return self.config.estimator.uncertainty

    @property
    def force(self) -> str:
        """The largest force."""
        return quantity(self.max_force, "N")

    @property
    def times(self) -> float:
        """How many times the force would be enough; infinite: no force."""
        wanted = self.wanted**2
        whole = self.budget.variances[self.index]
        by_force = sum(self.budget.parts[name][self.index] for name in _BY_FORCE)
        rest = max(whole - by_force, 0.0)
        return math.sqrt(by_force / (wanted - rest)) if rest < wanted else math.inf

    def or_more(self) -> str:
        """Return how hard to press instead, or nothing where that would not do."""
        times = self.times
        if not 1.0 < times < _MOST_TIMES:
            return ""
        return f", or press to {quantity(times * self.max_force, 'N', up=True)}"


def remedy(case: Case) -> str:
    """Return the cheapest remedy for the largest source of a variance; empty: none is known."""
    largest = case.budget.largest(case.index)
    if not largest:
        return ""
    # What is open of Gn and alpha is so because of the others.
    source = next((name for name in largest if name != "prior"), "prior")
    return _REMEDIES[source](case)


def _of_noise(case: Case) -> str:
    geometry, times = case.config.geometry, case.times
    noise = quantity(case.budget.stress_noise / geometry.stress_per_force, "N")
    if not 1.0 < times < _MOST_TIMES:
        return f"a sensor with less than {noise} of noise, or a longer press"
    ways = [face(geometry, times), _strain(case, times)]
    listed = " or ".join(way for way in ways if way)
    return f"with {noise} of noise it takes {listed or 'a quieter sensor'}"


def _strain(case: Case, times: float) -> str:
    """Return the strain at which the force is so many times as large; empty: too far."""
    geometry, reached = case.config.geometry, case.max_strain
    if reached <= 0.0:
        return ""
    gn = case.nonlinear_stiffness
    wanted = times * elastic_response(reached, 1.0, gn).value
    strain = float(strain_of_phi(np.array([wanted]), 1.0, gn)[0])
    return f"a strain of {strain:.2g}" if strain <= geometry.strain(LARGEST_COMPRESSION) else ""


def _of_friction(case: Case) -> str:
    friction = quantity(case.stated.friction_sd, "N")
    return (
        f"friction of {friction} is assumed and the press had {case.force}: state "
        f"force.friction_sd, use config/bench.yaml on a rigid rig{case.or_more()}"
    )


def _of_drift(case: Case) -> str:
    drift = quantity(case.stated.force_drift_sd, "N")
    return (
        f"drift of {drift} in a second is assumed and the press had {case.force}: state "
        f"force.drift_sd, press faster{case.or_more()}"
    )


def _of_motion(case: Case) -> str:
    motion = quantity(case.stated.surface_motion_sd, "m")
    return (
        f"{motion} of motion of the surface in a second is assumed: state surface.motion_sd, or "
        "press faster"
    )


def _of_compliance(case: Case) -> str:
    compliance = quantity(case.stated.compliance_sd, "m")
    return f"a compliance of {compliance}/N is assumed: state displacement.compliance_sd"


def _of_delay(case: Case) -> str:
    delay = quantity(case.stated.delay_sd, "s")
    return f"a delay of {delay} is assumed: fden configure measures it"


def _of_surface(case: Case) -> str:
    place = quantity(case.budget.surface_sd * case.config.geometry.length, "m")
    return f"the surface was found to {place}: touch it slower"


def _of_law(case: Case) -> str:
    return "the tissue is not quite the law's (model_error.sd): hold for 2 s, and press here again"


def _of_thickness(case: Case) -> str:
    thickness = 100.0 * case.stated.thickness_sd
    return f"a thickness known to {thickness:.2g} % is assumed: state geometry.thickness_sd"


def _of_prior(case: Case) -> str:
    return "hold for 2 s for alpha, or press deeper for Gn"


_REMEDIES: Mapping[str, Callable[[Case], str]] = {
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


def uncover(budget: Budget, geometry: Geometry, boundary_stress: float) -> str:
    """Return what shows the linear part: the stress [Pa] at the boundary above the noise."""
    times = max(budget.stress_noise / boundary_stress, 2.0)
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
