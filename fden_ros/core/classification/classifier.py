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

``unknown`` is one more class, as wide as soft tissue is. ``p_value`` is the share of contacts with
the best fitting tissue that lie as far from its centre as this one, or farther.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, gammaln, roots_genlaguerre

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Prior

UNKNOWN = "unknown"

#: Nodes of the average over g; with more degrees of freedom than this a class is normal.
_NODES, _MOST_DEGREES = 24, 300.0
#: The test takes directions in which the data know a specimen better than three times the spread
#: of its class; others would only add noise.
_LEAST_INFORMATION = 0.1
#: A direction that decides is observable where the data leave less than this of its variance.
_OBSERVABLE_SHARE = 0.25
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

    The label is the most probable class, ``unknown`` where the open-set test says so, or empty
    where nothing has been decided.
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
    """Log likelihood of (ln G, ln Gn, alpha) to second order; leading axes are many of them."""

    centre: Array  #: shape (..., 3)
    score: Array  #: slope of the logarithm there, shape (..., 3)
    information: Array  #: less its curvature, positive semidefinite, shape (..., 3, 3)


def likelihood_of(
    mean: Array, covariance: Array, prior: Prior | None = None, *, order_counts: bool = True
) -> Likelihood:
    """Return what the data say, from posteriors (..., 3) with covariances (..., 3, 3).

    `prior` is that of the estimator; without it the posteriors are taken for measurements.
    `order_counts`: alpha was not given, so that it is evidence.
    """
    used = 3 if order_counts and (prior is None or prior.fractional_order_sd > 0.0) else 2
    own = np.sqrt(np.einsum("...ii->...i", covariance)) if prior is None else prior.deviations
    # An alpha that was known exactly has no scale of its own.
    scale = np.broadcast_to(np.where(own > 0.0, own, 1.0), mean.shape)[..., :used]
    scaled = covariance[..., :used, :used] / (scale[..., :, None] * scale[..., None, :])
    variances, axes = np.linalg.eigh(scaled)
    # Smaller ones, in units of the prior's, are rounding, and may be negative.
    variances = np.maximum(variances, np.finfo(float).eps)
    if prior is None:
        known, slope = 1.0 / variances, np.zeros_like(variances)
    else:
        known = np.maximum(1.0 / variances - 1.0, 0.0)
        off = (mean - prior.mean)[..., :used] / scale
        # A covariance that was widened for a mismatch may exceed the prior's: no information.
        slope = np.where(known > 0.0, _times(np.swapaxes(axes, -1, -2), off), 0.0)
    information = np.zeros((*mean.shape, 3))
    information[..., :used, :used] = np.einsum("...ij,...j,...kj->...ik", axes, known, axes) / (
        scale[..., :, None] * scale[..., None, :]
    )
    score = np.zeros(mean.shape)
    score[..., :used] = _times(axes, slope) / scale
    return Likelihood(mean, score, information)


def classify(
    library: TissueLibrary, likelihood: Likelihood, significance: float = 0.0
) -> ClassProbabilities:
    """Return the probability of every class given what the data of one place say.

    The label is ``unknown`` where the p-value is below the `significance`.
    """
    evidence, fits = log_evidence(library, likelihood)
    probabilities = posterior(library, evidence)
    names = library.class_names
    best = int(np.argmax(probabilities))
    p_value = float(np.max(fits))
    return ClassProbabilities(
        names[best] if p_value >= significance else UNKNOWN,
        names,
        tuple(float(p) for p in probabilities),
        p_value,
        _is_observable(library, likelihood, evidence, best),
    )


def log_evidence(library: TissueLibrary, likelihood: Likelihood) -> tuple[Array, Array]:
    """Return the log evidence of every class (..., k + 1) and how well each tissue fits (..., k).

    The evidence is up to a constant that the classes share, ``unknown`` last; the fit is
    P(as far out | tissue). The `likelihood` has leading axes (...).
    """
    pairs = [_of_class(one, likelihood) for one in library.classes]
    evidence = np.stack([pair[0] for pair in pairs], axis=-1)
    return evidence, np.stack([pair[1] for pair in pairs[:-1]], axis=-1)


def posterior(library: TissueLibrary, evidence: Array) -> Array:
    """Return the probabilities of all classes from their log evidence, shape (..., k + 1)."""
    logs = evidence + np.log([one.prior for one in library.classes])
    result: Array = np.exp(logs - logs.max(axis=-1, keepdims=True))
    result /= result.sum(axis=-1, keepdims=True)
    return result


def _of_class(tissue: Tissue, likelihood: Likelihood) -> tuple[Array, Array]:
    factor = np.linalg.cholesky(tissue.covariance)
    off = tissue.mean - likelihood.centre
    pulled = _times(likelihood.information, off)
    known, axes = np.linalg.eigh(factor.T @ likelihood.information @ factor)
    known = np.maximum(known, 0.0)
    slope = _times(np.swapaxes(axes, -1, -2), (likelihood.score - pulled) @ factor)
    nodes, weights = _mixture(tissue.degrees_of_freedom)
    by_node = 0.5 * np.sum(
        slope[..., None] ** 2 / (known[..., None] + nodes) - np.log1p(known[..., None] / nodes),
        axis=-2,
    )
    largest = by_node.max(axis=-1, keepdims=True)
    total = np.log(np.exp(by_node - largest) @ weights) + largest[..., 0]
    evidence = np.sum(off * (likelihood.score - 0.5 * pulled), axis=-1) + total
    return evidence, _p_value(known, slope, nodes, weights)


def _p_value(known: Array, slope: Array, nodes: Array, weights: Array) -> Array:
    used = known > _LEAST_INFORMATION
    count = used.sum(axis=-1)
    safe = np.where(used, known, 1.0)
    squares = np.where(used, slope**2 / (safe * (safe + 1.0)), 0.0).sum(axis=-1)
    # The mean share of the class in the variance of a direction: it alone has the heavy tails.
    share = np.where(used, safe / (safe + 1.0), 0.0).sum(axis=-1) / np.maximum(count, 1)
    scale = 1.0 + share[..., None] * (1.0 / nodes - 1.0)
    tails = chdtrc(np.maximum(count, 1)[..., None], squares[..., None] / scale)
    result: Array = np.where(count > 0, tails @ weights, 1.0)
    return result


@functools.lru_cache(maxsize=256)
def _mixture(degrees: float) -> tuple[Array, Array]:
    """Return g and its weights: gamma of mean 1 and shape degrees/2."""
    if degrees > _MOST_DEGREES:
        return np.ones(1), np.ones(1)
    shape = 0.5 * degrees
    roots, weights = roots_genlaguerre(_NODES, shape - 1.0)
    weights = weights * math.exp(-float(gammaln(shape)))
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
        before = direction @ spread @ direction
        left = np.linalg.solve(np.eye(3) + spread @ likelihood.information, spread)
        if before > 0.0 and direction @ left @ direction > _OBSERVABLE_SHARE * before:
            return False
    return True


def _times(matrices: Array, vectors: Array) -> Array:
    result: Array = np.einsum("...ij,...j->...i", matrices, vectors)
    return result
