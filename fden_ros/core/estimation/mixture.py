# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Mixtures of Gaussians: what is published of several hypotheses about one record.

The posterior over the unknowns and a discrete index k of the hypothesis is

.. math::
    p(\theta, k \mid y) \approx \sum_k w_k\, N(\theta; m_k, P_k), \qquad
    w_k \propto p(k)\; p(y \mid k) .

The evidence p(y | k) is that of a Laplace approximation about a maximum, averaged over the scales
of the errors: a nested Laplace approximation (Rue, Martino and Chopin 2009) with a model index.
Between two solutions each has a filter, and the weights follow the likelihoods of what comes: a
static multiple-model estimator (Bar-Shalom, Li and Kirubarajan 2001, section 11.6).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array

#: What is less likely than the best by this logarithm is dropped [1]: one in ten thousand.
NEGLIGIBLE = 9.0
#: Least variance along any axis, over that of the whole [1]: what is held has none.
_FLAT = 1e-9


class Component(NamedTuple):
    """One Gaussian of a mixture."""

    weight: float
    mean: Array
    covariance: Array


def moments(components: Sequence[Component]) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture whose weights add up to 1."""
    if len(components) == 1:
        return components[0].mean, components[0].covariance
    middle = np.sum([c.weight * c.mean for c in components], axis=0)
    spread = np.zeros_like(components[0].covariance)
    for component in components:
        off = component.mean - middle
        spread += component.weight * (component.covariance + np.outer(off, off))
    return middle, spread


def weights_of(log_weights: Sequence[float] | Array) -> Array:
    """Return weights that add up to 1, (n,): 0 where one is negligible beside the largest."""
    logs = np.array(log_weights)
    # The largest itself counts where rounding leaves no room below it.
    weights = np.where(logs >= logs.max() - NEGLIGIBLE, np.exp(logs - logs.max()), 0.0)
    return weights / weights.sum()


def normalized(components: Sequence[Component]) -> list[Component]:
    """Return components with weights that add up to 1."""
    total = sum(one.weight for one in components)
    return [one._replace(weight=one.weight / total) for one in components]


def collapsed(
    components: Sequence[Component], most: int, alike: float, places: Sequence[int]
) -> tuple[Component, ...]:
    r"""Return a mixture of a few Gaussians with the same moments.

    Of all pairs that is merged into one Gaussian of its moments for which the bound

    .. math:: B_{ij} = \tfrac12 [(w_i + w_j) \ln|P_{ij}| - w_i \ln|P_i| - w_j \ln|P_j|]

    of what the Kullback-Leibler divergence from the whole grows by is the lowest (Runnalls 2007).

    Parameters
    ----------
    most : int
        Gaussians that are left at most.
    alike : float
        Pairs whose bound is below this are merged however few there are [1].
    places : sequence of int
        Of the unknowns by which they are compared.
    """
    left = list(components)
    own = np.ix_(places, places)
    unit = moments(left)[1][own].diagonal()
    unit = np.sqrt(np.where(unit > 0.0, unit, 1.0))

    def log_volume(one: Component) -> float:
        scaled = one.covariance[own] / np.outer(unit, unit)
        return float(np.log(np.maximum(np.linalg.eigvalsh(scaled), _FLAT)).sum())

    while len(left) > 1:
        pairs = list(itertools.combinations(left, 2))
        together = [merged(pair) for pair in pairs]
        volumes = {id(one): one.weight * log_volume(one) for one in (*left, *together)}
        bounds = [
            0.5 * (volumes[id(both)] - volumes[id(one)] - volumes[id(other)])
            for (one, other), both in zip(pairs, together, strict=True)
        ]
        least = int(np.argmin(bounds))
        if len(left) <= most and bounds[least] >= alike:
            break
        one, other = pairs[least]
        left = [c for c in left if c is not one and c is not other] + [together[least]]
    return tuple(left)


def merged(components: Sequence[Component]) -> Component:
    """Return the Gaussian that has weight, mean and covariance of some together."""
    weight = sum(one.weight for one in components)
    return Component(weight, *moments(normalized(components)))


def widened(components: Sequence[Component], factor: float) -> tuple[Component, ...]:
    """Return a mixture with the same mean, and a covariance that is `factor` times as large."""
    middle, root = moments(components)[0], math.sqrt(factor)
    return tuple(
        Component(c.weight, middle + root * (c.mean - middle), factor * c.covariance)
        for c in components
    )


def positive(covariance: Array) -> Array:
    """Return the nearest symmetric positive semidefinite matrix, where rounding has left none."""
    nearest: Array = 0.5 * (covariance + covariance.T)
    values, vectors = np.linalg.eigh(nearest)
    if values[0] < 0.0:
        nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
        nearest = 0.5 * (nearest + nearest.T)
    return nearest
