# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What makes an estimate uncertain, and the cheapest remedy for it, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Budget
from fden_ros.core.law import FlatPunch, Geometry, Sphere, elastic_response, strain_of_phi
from fden_ros.written import quantity

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
#: What is assumed of each source, or seen of it, and what would make it smaller.
_REMEDIES: Mapping[str, str] = {
    "drift": "drift of {drift} in a second is assumed and the press had {force}: state "
    "force.drift_sd, press faster{harder}",
    "friction": "friction of {friction} is assumed and the press had {force}: state "
    "force.friction_sd, use config/bench.yaml on a rigid rig{harder}",
    "motion": "{motion} of motion of the surface in a second is assumed: state "
    "surface.motion_sd, or press faster",
    "compliance": "a compliance of {compliance}/N is assumed: state displacement.compliance_sd",
    "delay": "a delay of {delay} is assumed: fden configure measures it",
    "surface": "the surface was found to {place}: touch it slower",
    "law": "the tissue is not quite the law's (model_discrepancy.sd): hold for 2 s, and press "
    "here again",
    "thickness": "a thickness known to {thickness:.2g} % is assumed: state geometry.thickness_sd",
    "prior": "hold for 2 s for alpha, or press deeper for Gn",
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
    def times(self) -> float:
        """How many times the force would be enough; 0: no force that anybody presses with."""
        wanted, parts = self.wanted**2, self.budget.parts
        by_force = sum(parts[name][self.index] for name in _BY_FORCE)
        rest = max(self.budget.variances[self.index] - by_force, 0.0)
        times = math.sqrt(by_force / (wanted - rest)) if rest < wanted else 0.0
        return times if 1.0 < times < _MOST_TIMES else 0.0


def remedy(case: Case) -> str:
    """Return the cheapest remedy for the largest source of a variance; empty: none is known."""
    largest = case.budget.largest(case.index)
    if not largest:
        return ""
    # What is open of Gn and alpha is so because of the others.
    source = next((name for name in largest if name != "prior"), "prior")
    if source == "noise":
        return _of_noise(case)
    stated, more = case.config.estimator.uncertainty, case.times * case.max_force
    return _REMEDIES[source].format(
        drift=quantity(stated.force_drift_sd, "N"),
        friction=quantity(stated.friction_sd, "N"),
        motion=quantity(stated.surface_motion_sd, "m"),
        compliance=quantity(stated.compliance_sd, "m"),
        delay=quantity(stated.delay_sd, "s"),
        place=quantity(case.budget.surface_sd * case.config.geometry.length, "m"),
        thickness=100.0 * stated.thickness_sd,
        force=quantity(case.max_force, "N"),
        harder=f", or press to {quantity(more, 'N', up=True)}" if more else "",
    )


def _of_noise(case: Case) -> str:
    geometry, times = case.config.geometry, case.times
    noise = quantity(case.budget.stress_noise / geometry.stress_per_force, "N")
    if not times:
        return f"a sensor with less than {noise} of noise, or a longer press"
    ways = [_face(geometry, times), _strain(case)]
    listed = " or ".join(way for way in ways if way)
    return f"with {noise} of noise it takes {listed or 'a quieter sensor'}"


def _strain(case: Case) -> str:
    """Return the strain at which the force would be enough; empty: too far."""
    geometry, gn = case.config.geometry, case.nonlinear_stiffness
    if case.max_strain <= 0.0:
        return ""
    wanted = case.times * elastic_response(case.max_strain, 1.0, gn).value
    strain = float(strain_of_phi(np.array([wanted]), 1.0, gn)[0])
    return f"a strain of {strain:.2g}" if strain <= geometry.strain(LARGEST_COMPRESSION) else ""


def uncover(budget: Budget, geometry: Geometry, boundary_stress: float) -> str:
    """Return what shows the linear part: the stress [Pa] at the boundary above the noise."""
    times = max(budget.stress_noise / boundary_stress, 2.0)
    larger = _face(geometry, times) if times < _MOST_TIMES else ""
    return f"it takes {larger or 'a quieter sensor'}, or a place of the surface that is given"


def _face(geometry: Geometry, times: float) -> str:
    """Return a probe that meets so many times the force at the same strain; empty: not known."""
    root = math.sqrt(times)
    if isinstance(geometry, FlatPunch):
        diameter = 2.0 * math.sqrt(geometry.area / math.pi) * root
        return f"a face of {quantity(diameter, 'm', up=True)}"
    if isinstance(geometry, Sphere):
        return f"a sphere of {quantity(geometry.radius * root, 'm', up=True)} radius"
    return ""
