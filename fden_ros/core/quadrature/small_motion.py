# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The stiffness that a posterior predicts for a small motion, in newtons per metre.

A small step at the indentation u is answered, a time tau later, by

.. math::
    k = \frac{\psi'(x)\,x'(u)}{c\,L}\,E(\tau), \qquad \psi = \varphi\,e^{\epsilon(x)}, \quad
    E(\tau) = \sum_r w_r(\alpha)\,e^{\delta_r - \lambda_r \tau}

with c the stress by force, in series with what the tool yields. It is of force and displacement as
they are measured, so the thickness does not count. Its logarithm is close to linear in what is
not known at each node: moments are taken at each, and mixed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law import left_after
from fden_ros.core.quadrature.discrepancy import CURVE, KERNEL, KERNEL_HATS, RIG, splines
from fden_ros.core.quadrature.posterior import Posterior

#: Step of the indentation for derivatives [1].
_STEP = 1e-4
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
        state = posterior.states
        yielding = self._yielding(1.0)
        bends = -stress * yielding
        u = compression + self.shift - posterior.nodes[:, -1] + bends @ state
        values, row = self._of_curve(u, state)
        if bends.any():
            ahead, _ = self._of_curve(u + _STEP, state)
            row += bends[:, None] * (ahead - values) / _STEP
        nodes = posterior.nodes
        rates = law.weights(nodes) * np.exp(KERNEL_HATS @ np.clip(state[KERNEL], -8.0, 8.0))
        rates *= left_after(time_scale)[:, None]
        total = rates.sum(axis=0)
        row[KERNEL] = KERNEL_HATS.T @ (rates / total)
        values = values + np.log(total) + posterior.stiffness.log_g
        # Of the tissue's indentation in that of both.
        tool = np.exp(values) * (yielding @ state)
        values = values - np.log(np.maximum(1.0 + tool, 1e-3))
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

    def _yielding(self, stress: float) -> Array:
        """Return what the unknowns take from the indentation at a stress [Pa], (k,) [1]."""
        law = self.posterior.grid.law
        found = np.zeros(law.size)
        for k, (one, _) in enumerate(law.slots, RIG):
            if one.name == "compliance":
                found[k] = stress * one.sd
        return found

    def _of_curve(self, u: Array, state: Array) -> tuple[Array, Array]:
        """Return ln (psi' x') for G = 1 at indentations (M,), and its derivatives by state."""
        law, log_gn = (
            self.posterior.grid.law,
            self.posterior.nodes[:, self.posterior.grid.law.kernels],
        )
        strain, by_u = law.strain(np.maximum(u, 1e-6))
        near = np.concatenate([strain, strain + _STEP])
        basis, ahead = splines(near, law.last_knot).reshape(2, strain.size, -1)
        tilt = (ahead - basis) / _STEP
        bend = np.clip(state[CURVE], -8.0, 8.0)
        value, slope = law.shape(strain, log_gn), law.slope(strain, log_gn)
        own = np.einsum("mk,km->m", tilt, bend) * value
        whole = np.maximum(slope + own, _LEAST_SLOPE * slope)
        row = np.zeros_like(state)
        row[CURVE] = (basis + (value / whole)[:, None] * tilt).T
        return np.log(whole * by_u) + np.einsum("mk,km->m", basis, bend), row

    def _variances(self, row: Array) -> Array:
        """Return the variances of ln k whose derivatives by the state are given, (k, M)."""
        posterior = self.posterior
        grid = posterior.grid
        known = posterior.known @ row
        left = np.einsum("km,km->m", row, grid.prior @ row) - np.einsum("nm,nm->m", known, known)
        by_g = 1.0 - np.einsum("nm,nm->m", known, posterior.responses)
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
