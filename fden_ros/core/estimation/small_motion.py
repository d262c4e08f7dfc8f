# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The stiffness that a posterior predicts for a small motion, in newtons per metre.

A small step at the indentation u is answered, a time tau later, by

.. math::
    k = \frac{\psi'(x)\,x'(u)}{c\,L}\,E(\tau), \qquad \psi = \varphi\,e^{\epsilon(x)}, \quad
    E(\tau) = \sum_r w_r(\alpha)\,e^{\delta_r - \lambda_r \tau}

with c the stress by force, in series with what the tool yields. It relates force and displacement
as they are measured, so the thickness does not matter. Its logarithm is close to linear in what
is not known at each node: moments are taken at each, and mixed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.discrepancy import KERNEL, KERNEL_HATS, RIG, spline_parts
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.law import left_after

#: Step of the indentation for derivatives [1].
_STEP = 1e-4
#: Nodes without a stiffness, as at the surface of a sphere, may have the rest of this share [1].
_LEAST_SHARE = 0.95
#: The slope of psi is at least this part of phi's [1].
_LEAST_SLOPE = 0.1


class LogStiffnesses(NamedTuple):
    """ln k of the nodes, (M,) each."""

    weights: Array
    values: Array  #: [1], k in N/m
    variances: Array  #: [1]


@dataclass(frozen=True, eq=False)
class SmallMotion:
    """A posterior, for predictions of a small motion.

    Attributes
    ----------
    now : float
        The time of the newest sample [s].
    weight : float
        Of all its nodes [1].
    shift : float
        By which its indentations are larger than those that are asked for [1].
    variance_factor : float
        By which contradictions of the data widen the variances [1].
    unseen : float
        Variance of ln k for a relaxation that has not been seen [1].
    """

    posterior: Posterior
    now: float = 0.0
    weight: float = 1.0
    shift: float = 0.0
    variance_factor: float = 1.0
    unseen: float = 0.0

    def widened(self, factor: float) -> SmallMotion:
        """Return it with more variance."""
        return replace(self, variance_factor=factor * self.variance_factor)

    def log_stiffnesses(
        self, compression: float, stress: float, time_scale: float
    ) -> LogStiffnesses:
        """Return ln k of its nodes.

        Parameters
        ----------
        compression : float
            From the nominal contact point [1].
        stress : float
            There [Pa]: it bends the tool.
        time_scale : float
            tau [s].
        """
        posterior, law = self.posterior, self.posterior.grid.law
        state, spot = posterior.states, posterior.spot
        compliance, own = self._compliance, law.of_spot
        yielding = sum(sd * state[k] for k, sd in compliance)
        u = compression + self.shift - spot.contact_point - stress * yielding
        values, row = self._of_curve(np.append(u, u + _STEP) if compliance or own else u, state)
        values, ahead = values[: u.size], values[u.size :]
        for k, sd in compliance:
            row[k] -= stress * sd * (ahead - values) / _STEP
        if own is not None:
            row += spot.by_state[0] - spot.by_state[1] * (ahead - values) / _STEP
        rates = np.exp(KERNEL_HATS @ np.clip(state[KERNEL], -8.0, 8.0))
        rates *= posterior.grid.relaxations[:, posterior.top]
        rates *= left_after(time_scale)[:, None]
        total = rates.sum(axis=0)
        row[KERNEL] = KERNEL_HATS.T @ (rates / total)
        values = values + np.log(total) + spot.log_g
        # Of the tissue's indentation in that of both.
        values = values - np.log(np.maximum(1.0 + np.exp(values) * yielding, 1e-3))
        values -= math.log(law.geometry.stress_per_force * law.geometry.length)
        return LogStiffnesses(self.weight * posterior.weights, values, self._variances(row))

    def stresses(self, times: Array, indentations: Array) -> tuple[Array, Array]:
        """Return mean and variance of the stress along a plan [Pa, Pa^2], (n,) each.

        Parameters
        ----------
        times : ndarray, shape (n,)
            From now on [s].
        indentations : ndarray, shape (n,)
            From the nominal contact point [1].
        """
        mean, variance = self.posterior.state.ahead(self.now + times, indentations + self.shift)
        return mean, self.variance_factor * variance

    @property
    def _compliance(self) -> list[tuple[int, float]]:
        """The place in a state of what yields, and its standard deviation by the stress [1/Pa]."""
        slots = enumerate(self.posterior.grid.law.slots, RIG)
        return [(k, one.sd) for k, (one, _) in slots if one.name == "compliance"]

    def _of_curve(self, u: Array, state: Array) -> tuple[Array, Array]:
        """Return ln (psi' x') for G = 1 at indentations, and its derivatives by state.

        The indentations are one of each node, (M,), or more such rows behind; the derivatives,
        (k, M), are those of the first row.
        """
        law, nodes = self.posterior.grid.law, self.posterior.nodes
        log_gn = np.resize(nodes[:, law.kernels], u.size)
        strain, by_u = law.strain(np.maximum(u, 1e-6))
        at, basis, tilt = spline_parts(strain, law.last_knot)
        node = np.arange(u.size) % len(nodes)
        bend = np.minimum(np.maximum(state[at, node], -8.0), 8.0)
        value, slope = law.shape(strain, log_gn), law.slope(strain, log_gn)
        whole = np.maximum(slope + (tilt * bend).sum(axis=0) * value, _LEAST_SLOPE * slope)
        row, m = np.zeros_like(state), len(nodes)
        row[at[:, :m], node[:m]] = (basis + value / whole * tilt)[:, :m]
        return np.log(whole * by_u) + (basis * bend).sum(axis=0), row

    def _variances(self, row: Array) -> Array:
        """Return the variances of ln k whose derivatives by the state are given, (k, M)."""
        posterior = self.posterior
        left = np.einsum("km,km->m", row, posterior.left @ row)
        by_g = 1.0 - np.einsum("km,km->m", row, posterior.by_response)
        found = np.maximum(left, 0.0) + by_g**2 * posterior.stiffness.variance
        return np.asarray(self.variance_factor * found + self.unseen)


def stress_ahead(
    motions: Sequence[SmallMotion], times: Array, indentations: Array
) -> tuple[Array, Array]:
    """Return mean and variance of the stress along a plan [Pa, Pa^2] by several posteriors.

    The parameters are those of :meth:`SmallMotion.stresses`.
    """
    found = [motion.stresses(times, indentations) for motion in motions]
    weights = np.array([motion.weight for motion in motions])
    means, variances = np.array(found).transpose(1, 0, 2)
    mean = weights @ means
    return mean, weights @ (variances + (means - mean) ** 2)


def log_stiffness(
    motions: Sequence[SmallMotion], compression: float, stress: float, time_scale: float
) -> tuple[float, float] | None:
    """Return mean and variance of ln k [ln N/m] of all nodes of several posteriors; None: none.

    The parameters are those of :meth:`SmallMotion.log_stiffnesses`.
    """
    with np.errstate(all="ignore"):
        found = [motion.log_stiffnesses(compression, stress, time_scale) for motion in motions]
    weights, values, variances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    has_one = np.isfinite(values) & np.isfinite(variances)
    weights, values, variances = weights[has_one], values[has_one], variances[has_one]
    total = float(weights.sum())
    if total < _LEAST_SHARE:
        return None
    mean = float(weights @ values) / total
    return mean, float(weights @ (variances + (values - mean) ** 2)) / total
