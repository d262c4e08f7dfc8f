# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Which tissue of a library an estimate belongs to, with probabilities that can be trusted.

What the data alone say of :math:`\theta = (\ln G, \ln G_n, \alpha)` is the posterior over the
estimator's prior, a :class:`Likelihood`

.. math:: \ln L(\theta) = s^T (\theta - c) - \tfrac12 (\theta - c)^T \Lambda\, (\theta - c),
   \qquad \Lambda = P^{-1} - C_0^{-1}, \quad s = C_0^{-1} (c - m_0),

with c and P the estimate and its covariance, :math:`m_0` and :math:`C_0` those of the prior.
What the data do not show has no information in :math:`\Lambda` and therefore no weight.

A class spreads as :math:`\theta = \mu + u`, u normal with covariance :math:`\Sigma`, or Student's
t where the class was learned from few specimens, which is a normal with :math:`\Sigma/g` averaged
over a gamma distributed g. With :math:`\Sigma = K K^T` and :math:`K^T \Lambda K = V
\mathrm{diag}(\lambda) V^T` its evidence is

.. math:: \ln E(g) = s^T m - \tfrac12 m^T \Lambda m
   + \tfrac12 \sum_i \left[ \frac{h_i^2}{\lambda_i + g} - \ln(1 + \lambda_i / g) \right],
   \qquad m = \mu - c, \quad h = V^T K^T (s - \Lambda m).

``unknown`` is a further class that spans all soft tissue. ``p_value`` is the share of contacts
with the best fitting tissue that lie as far from its centre as this one, or farther.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, logsumexp, roots_genlaguerre, softmax

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Prior

UNKNOWN = "unknown"

#: Nodes of the average over g; with more degrees of freedom than this a class is normal.
_NODES, _MOST_DEGREES = 24, 300.0
#: The test takes directions in which the data know a specimen better than three times the spread
#: of its class; others would only add noise.
_LEAST_INFORMATION = 0.1
#: The data distinguish two classes where they favour one by odds of 20, in any direction.
_SPEAKING_ODDS = 20.0


@dataclass(frozen=True, eq=False)
class Tissue:
    """One class of a library."""

    name: str
    mean: Array  #: of (ln G, ln Gn, alpha), G in Pa s^alpha, shape (3,)
    #: Spread of the class over specimens, positive definite; with few degrees of freedom, the
    #: scale matrix of Student's t, shape (3, 3).
    covariance: Array
    prior: float = 1.0  #: prior probability up to a common factor, positive
    degrees_of_freedom: float = math.inf  #: how well the spread itself is known; inf: exactly


@dataclass(frozen=True, eq=False)
class TissueLibrary:
    """The tissues to distinguish, and the wide class for all others."""

    name: str
    tissues: tuple[Tissue, ...]
    unknown: Tissue
    units: str = "Pa"  #: unit of the stress behind G: ``Pa``, or ``N`` where it is a force
    geometry: str = ""  #: kind of geometry that the parameters were found with; empty: not stated

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names in the order of the probabilities, ``unknown`` last."""
        return (*(tissue.name for tissue in self.tissues), UNKNOWN)

    @property
    def classes(self) -> tuple[Tissue, ...]:
        """The tissues, then ``unknown``."""
        return (*self.tissues, self.unknown)


class ClassProbabilities(NamedTuple):
    """Probabilities of a library's classes, in its order, ``unknown`` last.

    The label is the most probable class until one is decided, then that; empty: undetermined.
    """

    label: str
    names: tuple[str, ...]
    probabilities: tuple[float, ...]
    p_value: float = 1.0  #: P(as far out | best fitting tissue) [1]
    is_observable: bool = True  #: the data, not the priors, single out the label

    @property
    def words(self) -> str:
        """The label with its probability, or ``undetermined``."""
        if not self.label:
            return "undetermined"
        return f"{self.label} {self.probabilities[self.names.index(self.label)]:.0%}"


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Log likelihood of (ln G, ln Gn, alpha) to second order."""

    centre: Array  #: shape (3,)
    score: Array  #: slope of the logarithm there, shape (3,)
    information: Array  #: less its curvature, positive semidefinite, shape (3, 3)


def likelihood_of(
    mean: Array, covariance: Array, prior: Prior, *, order_counts: bool = True
) -> Likelihood:
    """Return what the data say, from a posterior (3,), (3, 3) and the prior of the estimator.

    `order_counts`: alpha was not given, so that it is evidence.
    """
    used = 3 if order_counts else 2
    scale = prior.deviations[:used]
    scales = np.outer(scale, scale)
    variances, axes = np.linalg.eigh(covariance[:used, :used] / scales)
    # Smaller ones, in units of the prior's, are rounding, and may be negative. A covariance that
    # was widened for a mismatch may exceed the prior's: no information.
    known = np.maximum(1.0 / np.maximum(variances, np.finfo(float).eps) - 1.0, 0.0)
    slope = np.where(known > 0.0, axes.T @ ((mean - prior.mean)[:used] / scale), 0.0)
    score, information = np.zeros(3), np.zeros((3, 3))
    score[:used] = axes @ slope / scale
    information[:used, :used] = (axes * known) @ axes.T / scales
    return Likelihood(mean, score, information)


def classify(library: TissueLibrary, likelihood: Likelihood) -> ClassProbabilities:
    """Return the probability of every class given what the data of one place say."""
    evidence, fits = log_evidence(library, likelihood)
    probabilities, names = posterior(library, evidence), library.class_names
    best = int(np.argmax(probabilities))
    is_observable = _is_observable(library, likelihood, evidence, best)
    return ClassProbabilities(
        names[best], names, tuple(probabilities.tolist()), float(fits.max()), is_observable
    )


def log_evidence(library: TissueLibrary, likelihood: Likelihood) -> tuple[Array, Array]:
    """Return the log evidence of every class (k + 1,) and how well each tissue fits (k,).

    The evidence is up to a constant that the classes share, ``unknown`` last; the fit is
    P(as far out | tissue).
    """
    evidence, fits = np.array([_of_class(one, likelihood) for one in library.classes]).T
    return evidence, fits[:-1]


def posterior(library: TissueLibrary, evidence: Array) -> Array:
    """Return the probabilities of all classes from their log evidence, shape (k + 1,)."""
    result: Array = softmax(evidence + np.log([one.prior for one in library.classes]))
    return result


def _of_class(tissue: Tissue, likelihood: Likelihood) -> tuple[float, float]:
    factor = np.linalg.cholesky(tissue.covariance)
    off = tissue.mean - likelihood.centre
    pulled = likelihood.information @ off
    known, axes = np.linalg.eigh(factor.T @ likelihood.information @ factor)
    known = np.maximum(known, 0.0)
    slope = axes.T @ factor.T @ (likelihood.score - pulled)
    nodes, weights = _mixture(tissue.degrees_of_freedom)
    squares, logs = slope**2 / (known + nodes[:, None]), np.log1p(known / nodes[:, None])
    total = logsumexp(0.5 * np.sum(squares - logs, axis=1), b=weights)
    evidence = float(off @ (likelihood.score - 0.5 * pulled) + total)
    used = known > _LEAST_INFORMATION
    return evidence, _p_value(known[used], slope[used], nodes, weights)


def _p_value(known: Array, slope: Array, nodes: Array, weights: Array) -> float:
    if not known.size:
        return 1.0
    square = np.sum(slope**2 / (known * (known + 1.0)))
    # The mean share of the class in the variance of a direction: it alone has the heavy tails.
    scale = 1.0 + np.mean(known / (known + 1.0)) * (1.0 / nodes - 1.0)
    return float(chdtrc(known.size, square / scale) @ weights)


@functools.lru_cache(maxsize=256)
def _mixture(degrees: float) -> tuple[Array, Array]:
    """Return g and its weights: gamma of mean 1 and shape degrees/2."""
    if degrees > _MOST_DEGREES:
        return np.ones(1), np.ones(1)
    shape = 0.5 * degrees
    roots, weights = roots_genlaguerre(_NODES, shape - 1.0)
    return roots / shape, weights / weights.sum()


def _is_observable(
    library: TissueLibrary, likelihood: Likelihood, evidence: Array, best: int
) -> bool:
    """Whether the data are informative in the directions that separate the best tissue."""
    tissues = library.tissues
    if best == len(tissues):
        return True
    own = tissues[best]
    for index, other in enumerate(tissues):
        if index == best or evidence[best] - evidence[index] > math.log(_SPEAKING_ODDS):
            continue
        spread = 0.5 * (own.covariance + other.covariance)
        direction = np.linalg.solve(spread, own.mean - other.mean)
        left = np.linalg.solve(np.eye(3) + spread @ likelihood.information, spread)
        # It is observable where the data leave less than half of its deviation.
        if 4.0 * (direction @ left @ direction) > direction @ spread @ direction:
            return False
    return True
