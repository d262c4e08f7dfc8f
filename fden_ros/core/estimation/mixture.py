# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Mixtures of Gaussians, in which posteriors are published."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array


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
