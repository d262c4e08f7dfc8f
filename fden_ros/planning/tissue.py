# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of a tissue before a press: a mixture of Gaussians, and draws from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Component, Estimate, Prior, moments
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER

#: Root of x^5 = x + 1: its powers fill four dimensions evenly (Roberts 2018, the R sequence).
_ROOT = 1.1673039782614187


@dataclass(frozen=True)
class TissueBelief:
    """What is known of (ln G, ln Gn, alpha).

    Attributes
    ----------
    members : tuple of Component
        Weights [1], means (3,) and covariances (3, 3).
    """

    members: tuple[Component, ...]

    @classmethod
    def stated(cls, prior: Prior) -> TissueBelief:
        """Return what is known before any press."""
        return cls((Component(1.0, prior.mean, np.diag(prior.deviations**2)),))

    @classmethod
    def found(cls, estimate: Estimate) -> TissueBelief:
        """Return what an estimate says: its modes."""
        return cls(estimate.components or (Component(1.0, estimate.mean, estimate.covariance),))

    @classmethod
    def of(cls, modes: Sequence[Mapping[str, Any]]) -> TissueBelief:
        """Return what results state: weight, mean and covariance of each mode."""
        return cls(
            tuple(
                Component(m["weight"], *map(np.array, (m["mean"], m["covariance"]))) for m in modes
            )
        )

    @property
    def mean(self) -> Array:
        """Of all members, (3,)."""
        return moments(self.members)[0]

    @property
    def covariance(self) -> Array:
        """Of all members, (3, 3)."""
        return moments(self.members)[1]

    def draws(self, count: int) -> Array:
        """Return tissues that stand evenly for what is known, (count, 3); the first is typical."""
        places = 0.5 + np.outer(np.arange(count), _ROOT ** -np.arange(1.0, 5.0))
        uniform = np.clip(places % 1.0, 1e-3, 1.0 - 1e-3)
        ends = np.cumsum([m.weight for m in self.members])
        chosen = np.searchsorted(ends / ends[-1], uniform[:, 0])
        normal = ndtri(uniform[:, 1:])
        found = np.empty((count, 3))
        for k, member in enumerate(self.members):
            values, axes = np.linalg.eigh(member.covariance)
            root = axes * np.sqrt(np.maximum(values, 0.0))
            found[chosen == k] = member.mean + normal[chosen == k] @ root.T
        found[:, 2] = np.clip(found[:, 2], 5.0 * LOWEST_ORDER, 0.9 * HIGHEST_ORDER)
        return found
