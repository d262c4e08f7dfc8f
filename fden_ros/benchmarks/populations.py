# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Populations of simulated tissues: contacts through the pipeline, and many more drawn.

Four invented tissues about the paper's liver, each with the spread of its Table II. Some hundred
contacts go through simulator and pipeline; what their data say (the information matrices) is the
precision of the drawn ones: a tissue from its class, a likelihood about it with one of these
matrices. So 20,000 contacts and more take seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from fden_ros.benchmarks.simulated import _feed
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
from fden_ros.core.outputs import Classification, ContactSummary, Output
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Press,
    RampHold,
    Scenario,
    Site,
)
from fden_ros.simulation.scenario import Ramp as RampPress
from fden_ros.simulation.scenario import Tissue as SimulatedTissue
from fden_ros.simulation.simulate import START_NS, simulate
from fden_ros.simulation.trajectory import Approach
from fden_ros.tissues.training import _UNKNOWN_SPREAD, Contacts

#: The estimator's prior, as wide as these tissues are.
PRIOR = Prior(750.0, 0.9, 8.5, 0.45, 0.17, 0.06)
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
_UNKNOWN_SHARE = 0.1
_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_RATE_HZ = 200.0
_CONVERGED_LOG_SD = 0.15
#: Noise of the stress [Pa].
_NOISES = (5.0, 20.0, 60.0)
_PRESSES: tuple[Press, ...] = (
    RampPress(strain_rate=0.25, max_strain=0.25),
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
        tissues.append(
            Tissue(
                name,
                np.array([math.log(g), math.log(g_n), order]),
                correlation * np.outer(sd, sd),
                (1.0 - _UNKNOWN_SHARE) / len(_CLASSES),
            )
        )
    means = np.array([tissue.mean for tissue in tissues])
    about = means - means.mean(axis=0)
    unknown = Tissue(
        UNKNOWN,
        means.mean(axis=0),
        _UNKNOWN_SPREAD + about.T @ about / len(means),
        _UNKNOWN_SHARE,
    )
    return TissueLibrary("population", tuple(tissues), unknown, "Pa", "flat_punch")


class Pressed(NamedTuple):
    """One contact that went through the pipeline."""

    truth: int  #: class
    value: Array  #: true (ln G, ln Gn, alpha), shape (3,)
    kind: int  #: which press
    estimate: Estimate | None
    converged: bool
    summary: ContactSummary | None
    track: list[tuple[float, str, tuple[float, ...]]]  #: time since the touch, label, p


def press(
    library: TissueLibrary, value: Array, truth: int, seed: int, kind: int | None = None
) -> Pressed:
    """Press a tissue once; the pipeline classifies with `library` as it goes."""
    kind = seed % len(_PRESSES) if kind is None else kind
    noise = _NOISES[seed // len(_PRESSES) % len(_NOISES)]
    recording = simulate(_scenario(value, _PRESSES[kind], noise), seed)
    outputs = identify(recording, library)
    summaries = [output for output in outputs if isinstance(output, ContactSummary)]
    summary = summaries[-1] if summaries else None
    touch = START_NS if summary is None else summary.start_ns
    track = [
        ((o.stamp_ns - touch) * 1e-9, o.classes.label, o.classes.probabilities)
        for o in outputs
        if isinstance(o, Classification) and o.classes is not None
    ]
    return Pressed(
        truth,
        value,
        kind,
        summary.estimate if summary is not None else None,
        summary is not None and summary.converged,
        summary,
        track,
    )


def _scenario(value: Array, motion: Press, noise: float) -> Scenario:
    tissue = SimulatedTissue(math.exp(value[0]), math.exp(value[1]), max(float(value[2]), 0.03))
    return Scenario(
        name="population",
        geometry=_GEOMETRY,
        approach=Approach(
            distance_m=0.002,
            speed_m_per_s=0.02,
            slow_distance_m=0.001,
            retract_speed_m_per_s=0.04,
            start_pause_s=1.0,
        ),
        sites=(Site(tissue, (motion,)),),
        force=ForceSensor(rate_hz=_RATE_HZ, noise_stress_pa=noise),
        displacement=DisplacementSensor(rate_hz=_RATE_HZ),
    )


def identify(recording: object, library: TissueLibrary | None) -> list[Output]:
    """Return all that the pipeline puts out for a recording, with wide priors."""
    from dataclasses import replace

    parameters = dict(recording.truth["identifier_parameters"])  # type: ignore[attr-defined]
    parameters |= {
        "alpha.learn": True,
        "prior.linear_stiffness": PRIOR.linear_stiffness,
        "prior.linear_stiffness_log_sd": PRIOR.linear_stiffness_log_sd,
        "prior.nonlinear_stiffness": PRIOR.nonlinear_stiffness,
        "prior.nonlinear_stiffness_log_sd": PRIOR.nonlinear_stiffness_log_sd,
        "prior.alpha": PRIOR.fractional_order,
        "prior.alpha_sd": PRIOR.fractional_order_sd,
        # Poor contacts are to be classified too, by what they are worth.
        "converged.log_sd": _CONVERGED_LOG_SD,
    }
    config = replace(pipeline_config(check(parameters)), library=library)
    outputs: list[Output] = []
    pipeline = Pipeline(config, outputs.append)
    _feed(pipeline, recording)  # type: ignore[arg-type]
    pipeline.finish()
    return outputs


def press_many(library: TissueLibrary, count: int, advance: Callable[[], None]) -> list[Pressed]:
    """Press `count` tissues of the known classes in turn."""
    generator = np.random.default_rng(8)
    pressed = []
    for seed in range(count):
        truth = seed % len(library.tissues)
        tissue = library.tissues[truth]
        value = generator.multivariate_normal(tissue.mean, tissue.covariance)
        # Every class is met with every press and every noise.
        pressed.append(press(library, value, truth, seed // len(library.tissues)))
        advance()
    return pressed


def informations(pressed: Sequence[Pressed], kinds: Sequence[int] | None = None) -> Array:
    """Return what the data of converged contacts say, shape (m, 3, 3)."""
    return np.array(
        [
            likelihood_of_estimate(one.estimate, PRIOR, False).information
            for one in pressed
            if one.estimate is not None and one.converged and (kinds is None or one.kind in kinds)
        ]
    )


# Contacts drawn


@dataclass(frozen=True, eq=False)
class Drawn:
    """Contacts drawn from a population."""

    truth: Indices  #: class, shape (n,)
    value: Array  #: shape (n, 3)
    likelihood: Likelihood


def draw_likelihood(
    value: Array, information: Array, generator: np.random.Generator
) -> Likelihood:
    """Return likelihoods about true values: the score there is normal with the information."""
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
    chosen = precision[generator.integers(len(precision), size=count)]
    return Drawn(truth, value, draw_likelihood(value, chosen, generator))


def training_contacts(
    library: TissueLibrary,
    precision: Array,
    specimens: int,
    per_specimen: int,
    generator: np.random.Generator,
) -> Contacts:
    """Draw labelled contacts, several with each specimen."""
    tissues: list[str] = []
    names: list[str] = []
    values = []
    for tissue in library.tissues:
        between = generator.multivariate_normal(
            tissue.mean, (1.0 - _WITHIN) * tissue.covariance, specimens
        )
        for number, middle in enumerate(between):
            values.append(
                generator.multivariate_normal(middle, _WITHIN * tissue.covariance, per_specimen)
            )
            tissues += [tissue.name] * per_specimen
            names += [f"{number}"] * per_specimen
    value = np.concatenate(values)
    chosen = precision[generator.integers(len(precision), size=len(value))]
    return Contacts(tuple(tissues), tuple(names), draw_likelihood(value, chosen, generator))


def published(likelihood: Likelihood) -> Array:
    """Return what the pipeline would publish: the posterior's mean, shape (n, 3)."""
    centre = np.array(
        [
            math.log(PRIOR.linear_stiffness),
            math.log(PRIOR.nonlinear_stiffness),
            PRIOR.fractional_order,
        ]
    )
    scale = np.array(
        [
            PRIOR.linear_stiffness_log_sd,
            PRIOR.nonlinear_stiffness_log_sd,
            PRIOR.fractional_order_sd,
        ]
    )
    before = np.diag(scale**-2.0)
    off = centre - likelihood.centre
    step = np.linalg.solve(
        likelihood.information + before, (likelihood.score + off @ before)[..., None]
    )
    result: Array = likelihood.centre + step[..., 0]
    return result


def stacked(pressed: Sequence[Pressed]) -> tuple[Indices, Array, Likelihood]:
    """Return truth, true values and likelihoods of the contacts that converged."""
    used = [one for one in pressed if one.converged and one.estimate is not None]
    parts = [likelihood_of_estimate(one.estimate, PRIOR, False) for one in used]  # type: ignore[arg-type]
    return (
        np.array([one.truth for one in used], dtype=np.intp),
        np.array([one.value for one in used]),
        Likelihood(
            np.array([one.estimate.mean for one in used if one.estimate is not None]),
            np.array([part.score for part in parts]),
            np.array([part.information for part in parts]),
        ),
    )


# The bound


def bayes_error(
    library: TissueLibrary, precision: Array, points: int, replicates: int
) -> tuple[float, float]:
    """Return the least error that any classifier of the known tissues can have, and its own.

    The integral of 1 - max_c p(c | data) over tissues, data and matrices, class by class, by
    scrambled Sobol' sequences of `points` (a power of 2); the error is that of the replicates'
    mean.
    """
    known = TissueLibrary(library.name, library.tissues, library.unknown)
    priors = np.array([tissue.prior for tissue in known.tissues])
    priors /= priors.sum()
    factors = np.linalg.eigh(precision)
    results = []
    for replicate in range(replicates):
        total = 0.0
        for index, tissue in enumerate(known.tissues):
            sampler = qmc.Sobol(7, seed=1000 * replicate + index)
            uniform = np.clip(sampler.random(points), 1e-12, 1.0 - 1e-12)
            normal = ndtri(uniform[:, :6])
            which = (uniform[:, 6] * len(precision)).astype(np.intp)
            value = tissue.mean + normal[:, :3] @ np.linalg.cholesky(tissue.covariance).T
            noise = np.sqrt(np.maximum(factors[0][which], 0.0)) * normal[:, 3:]
            score = np.einsum("nij,nj->ni", factors[1][which], noise)
            likelihood = Likelihood(value, score, precision[which])
            probabilities = closed_set(known, likelihood)
            total += priors[index] * float(np.mean(1.0 - probabilities.max(axis=1)))
        results.append(total)
    own = float(np.std(results, ddof=1) / math.sqrt(replicates)) if replicates > 1 else math.nan
    return float(np.mean(results)), own


def closed_set(library: TissueLibrary, likelihood: Likelihood) -> Array:
    """Return the probabilities of the known tissues, given that it is one, shape (n, k)."""
    evidence, _ = log_evidence(library, likelihood)
    probabilities = posterior(library, evidence)[..., :-1]
    result: Array = probabilities / probabilities.sum(axis=-1, keepdims=True)
    return result


def calibration_error(
    probabilities: Array, truth: Indices, bins: int = 15
) -> tuple[float, Array, Array, Array]:
    """Return the expected calibration error of the most probable class, and the diagram.

    Returns
    -------
    error : float
        Mean over contacts of |share right - probability said| in bins of equal width (C. Guo et
        al., ICML 2017).
    said, right, count : ndarray, shape (bins,)
    """
    best = probabilities.max(axis=1)
    right = probabilities.argmax(axis=1) == truth
    index = np.minimum((best * bins).astype(int), bins - 1)
    count = np.bincount(index, minlength=bins).astype(float)
    with np.errstate(invalid="ignore"):
        said = np.bincount(index, weights=best, minlength=bins) / count
        share = np.bincount(index, weights=right, minlength=bins) / count
    gaps = np.where(count > 0, np.abs(said - share), 0.0)
    return float(gaps @ count / count.sum()), said, share, count


def classwise_error(probabilities: Array, truth: Indices, bins: int = 15) -> float:
    """Return the calibration error of every class's probability, averaged over the classes."""
    errors = []
    for index in range(probabilities.shape[1]):
        said, hit = probabilities[:, index], truth == index
        where = np.minimum((said * bins).astype(int), bins - 1)
        gap = np.bincount(where, weights=said - hit, minlength=bins)
        errors.append(float(np.abs(gap).sum()) / len(truth))
    return float(np.mean(errors))


def log_loss(probabilities: Array, truth: Indices) -> float:
    """Return the mean of -ln p of the true class among those known; unknown is the last column."""
    known = probabilities[:, :-1]
    own = known[np.arange(len(truth)), truth] / known.sum(axis=1)
    return float(-np.mean(np.log(np.maximum(own, 1e-12))))
