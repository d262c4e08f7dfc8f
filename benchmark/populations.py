# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Populations of simulated tissues: contacts through the pipeline, and many more drawn.

Four invented tissues about the paper's liver, each with the spread of its Table II. Some hundred
contacts go through simulator and pipeline; what their data say (the information matrices) is the
precision of the drawn ones: a tissue from its class, a likelihood about it with one of these
matrices. So 20,000 contacts and more take seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from benchmark.trial import last_summaries, through
from fden_ros.core.arrays import Array, Indices
from fden_ros.core.classification.classifier import (
    UNKNOWN,
    Likelihood,
    Tissue,
    TissueLibrary,
    likelihood_of_estimate,
    log_evidence,
    posterior,
)
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.parameters import check, pipeline_config
from fden_ros.tissues.training import Contacts
from simulation.scenario import DisplacementSensor, ForceSensor, Geometry, Scenario, Site
from simulation.scenario import Tissue as SimulatedTissue
from simulation.simulate import simulate
from simulation.trajectory import Approach, Ramp, RampHold

#: The estimator's prior, as wide as these tissues are.
PRIOR = Prior(750.0, 0.9, 8.5, 0.45, 0.17, 0.06)
_PARAMETERS = {
    "alpha.learn": True,
    "prior.linear_stiffness": PRIOR.linear_stiffness,
    "prior.linear_stiffness_log_sd": PRIOR.linear_stiffness_log_sd,
    "prior.nonlinear_stiffness": PRIOR.nonlinear_stiffness,
    "prior.nonlinear_stiffness_log_sd": PRIOR.nonlinear_stiffness_log_sd,
    "prior.alpha": PRIOR.fractional_order,
    "prior.alpha_sd": PRIOR.fractional_order_sd,
    # Poor contacts are to be classified too, by what they are worth.
    "converged.log_sd": 0.15,
}
#: Median of G [Pa s^alpha], of Gn, and alpha with its spread, by name; liver is the paper's.
_CLASSES = {
    "fat": (340.0, 6.6, 0.155, 0.015),
    "liver": (523.9, 8.4, 0.131, 0.011),
    "muscle": (900.0, 10.5, 0.185, 0.018),
    "stiffer liver": (1000.0, 8.8, 0.138, 0.011),
}
#: Spread of ln G and ln Gn over specimens, that of Table II, and their correlation (invented).
_LOG_SPREAD, _CORRELATION = (0.28, 0.186), -0.3
#: Share of the variance that is between places of one specimen.
_WITHIN = 0.2
#: How often a tissue is none of them, and how far it is about their mean: ln G, ln Gn, alpha.
_UNKNOWN_SHARE, _UNKNOWN_SD = 0.1, (1.4, 0.6, 0.12)
_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_RATE_HZ = 200.0
#: Noise of the stress [Pa].
_NOISES = (5.0, 20.0, 60.0)
PRESSES: tuple[Ramp | RampHold, ...] = (
    Ramp(strain_rate=0.25, max_strain=0.25),
    RampHold(strain_rate=0.25, max_strain=0.25, hold_s=0.4),
    RampHold(strain_rate=0.25, max_strain=0.22, hold_s=1.5),
)


def population() -> TissueLibrary:
    """Return the true distributions, the unknown with its true share."""
    tissues = []
    for name, (g, g_n, order, order_sd) in _CLASSES.items():
        sd = np.array([*_LOG_SPREAD, order_sd])
        correlation = np.eye(3)
        correlation[0, 1] = correlation[1, 0] = _CORRELATION
        mean = np.array([math.log(g), math.log(g_n), order])
        share = (1.0 - _UNKNOWN_SHARE) / len(_CLASSES)
        tissues.append(Tissue(name, mean, correlation * np.outer(sd, sd), share))
    means = np.array([tissue.mean for tissue in tissues])
    about = means - means.mean(axis=0)
    spread = np.diag(np.square(_UNKNOWN_SD)) + about.T @ about / len(means)
    unknown = Tissue(UNKNOWN, means.mean(axis=0), spread, _UNKNOWN_SHARE)
    return TissueLibrary("population", tuple(tissues), unknown, "Pa", "flat_punch")


class Pressed(NamedTuple):
    """One contact that went through the pipeline."""

    truth: int  #: class
    value: Array  #: true (ln G, ln Gn, alpha), shape (3,)
    kind: int  #: which of PRESSES
    estimate: Estimate | None
    converged: bool
    label: str  #: at its end; empty: none
    decided: tuple[float, float] | None  #: time since the touch [s] and strain of the label

    @property
    def likelihood(self) -> Likelihood | None:
        """What the data say; None: there is no estimate."""
        if self.estimate is None:
            return None
        return likelihood_of_estimate(self.estimate, PRIOR, False)


def press(value: Array, truth: int, seed: int, kind: int | None = None) -> Pressed:
    """Press a tissue once; the pipeline classifies with the true library."""
    kind = seed % len(PRESSES) if kind is None else kind
    noise = _NOISES[seed // len(PRESSES) % len(_NOISES)]
    tissue = SimulatedTissue(math.exp(value[0]), math.exp(value[1]), max(float(value[2]), 0.03))
    scenario = Scenario(
        name="population",
        geometry=_GEOMETRY,
        approach=Approach(
            distance_m=0.002,
            speed_m_per_s=0.02,
            slow_distance_m=0.001,
            retract_speed_m_per_s=0.04,
            start_pause_s=1.0,
        ),
        sites=(Site(tissue, (PRESSES[kind],)),),
        force=ForceSensor(rate_hz=_RATE_HZ, noise_stress_pa=noise),
        displacement=DisplacementSensor(rate_hz=_RATE_HZ),
    )
    recording = simulate(scenario, seed)
    own = dict(recording.truth["identifier_parameters"]) | _PARAMETERS
    _, outputs = through(recording, replace(pipeline_config(check(own)), library=population()))
    summaries = list(last_summaries(outputs).values())
    if not summaries:
        return Pressed(truth, value, kind, None, False, "", None)
    one = summaries[-1]
    decided = (one.decided.time, one.decided.strain) if one.decided is not None else None
    label = one.classes.label if one.classes is not None else ""
    return Pressed(truth, value, kind, one.estimate, one.converged, label, decided)


def values_of(count: int) -> list[tuple[Array, int, int]]:
    """Return true values, class and seed of `count` contacts, the known classes in turn."""
    library, generator = population(), np.random.default_rng(8)
    known = len(library.tissues)
    drawn = []
    for number in range(count):
        tissue = library.tissues[number % known]
        value = generator.multivariate_normal(tissue.mean, tissue.covariance)
        # Every class is met with every press and every noise.
        drawn.append((value, number % known, number // known))
    return drawn


def informations(pressed: Sequence[Pressed], kinds: Sequence[int] = (0, 1, 2)) -> Array:
    """Return what the data of converged contacts say, shape (m, 3, 3)."""
    found = [one.likelihood for one in pressed if one.converged and one.kind in kinds]
    return np.array([likelihood.information for likelihood in found if likelihood is not None])


# Contacts drawn


@dataclass(frozen=True, eq=False)
class Drawn:
    """Contacts drawn from a population."""

    truth: Indices  #: class, shape (n,)
    value: Array  #: shape (n, 3)
    likelihood: Likelihood


def draw_likelihood(value: Array, precision: Array, generator: np.random.Generator) -> Likelihood:
    """Return likelihoods about true values (n, 3), each with one of the matrices (m, 3, 3).

    The score at the truth is normal with the information.
    """
    information = precision[generator.integers(len(precision), size=len(value))]
    known, axes = np.linalg.eigh(information)
    noise = np.sqrt(np.maximum(known, 0.0)) * generator.standard_normal(value.shape)
    return Likelihood(value, np.einsum("nij,nj->ni", axes, noise), information)


def draw(
    library: TissueLibrary,
    precision: Array,
    count: int,
    generator: np.random.Generator,
    with_unknown: bool = True,
) -> Drawn:
    """Draw contacts, the classes by their priors."""
    classes = library.classes if with_unknown else library.tissues
    priors = np.array([one.prior for one in classes])
    truth = generator.choice(len(classes), size=count, p=priors / priors.sum())
    value = np.empty((count, 3))
    for index, one in enumerate(classes):
        own = truth == index
        value[own] = generator.multivariate_normal(one.mean, one.covariance, int(own.sum()))
    return Drawn(truth, value, draw_likelihood(value, precision, generator))


def training_contacts(
    precision: Array, specimens: int, each: int, generator: np.random.Generator
) -> Contacts:
    """Draw labelled contacts of the known tissues, several with each specimen."""
    tissues: list[str] = []
    names: list[str] = []
    values = []
    for tissue in population().tissues:
        between = (1.0 - _WITHIN) * tissue.covariance
        for number, middle in enumerate(
            generator.multivariate_normal(tissue.mean, between, specimens)
        ):
            within = _WITHIN * tissue.covariance
            values.append(generator.multivariate_normal(middle, within, each))
            tissues += [tissue.name] * each
            names += [f"{number}"] * each
    likelihood = draw_likelihood(np.concatenate(values), precision, generator)
    return Contacts(tuple(tissues), tuple(names), likelihood)


# Scores of probabilities


def closed_set(library: TissueLibrary, likelihood: Likelihood) -> Array:
    """Return the probabilities of the known tissues, given that it is one, shape (n, k).

    With the true library, the mean of 1 - max_c p(c | data) is Bayes' error: the least that any
    classifier can have.
    """
    evidence, _ = log_evidence(library, likelihood)
    probabilities = posterior(library, evidence)[..., :-1]
    result: Array = probabilities / probabilities.sum(axis=-1, keepdims=True)
    return result


def calibration_error(probabilities: Array, truth: Indices, bins: int = 15) -> float:
    """Return the expected calibration error of the most probable class.

    Mean over contacts of |share right - probability said| in bins of equal width (C. Guo et al.,
    ICML 2017).
    """
    best = probabilities.max(axis=1)
    right = probabilities.argmax(axis=1) == truth
    index = np.minimum((best * bins).astype(int), bins - 1)
    gaps = np.bincount(index, weights=best - right, minlength=bins)
    return float(np.abs(gaps).sum()) / len(truth)
