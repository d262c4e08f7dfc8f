# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The stiffness that a posterior predicts for a small motion: law, its errors and the origin.

A small step at the compression u is answered, a time tau later, by

.. math::
    k = \frac{\psi'(x)\,x'(u)}{c\,L}\,E(\tau), \qquad \psi = \varphi\,e^{\epsilon(x)}, \quad
    E(\tau) = \sum_r w_r(\alpha)\,e^{\delta_r - \lambda_r \tau}

with c the stress by force, and in series with what the tool yields, :math:`1/k + C`. So it is that
of force and displacement as they are measured: neither the thickness counts, nor whether the tool
yields or the tissue. Its logarithm is close to linear in the unknowns: its moments are taken of
each mode by its derivatives, and mixed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.mixture import Component
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.smooth_errors import KERNEL_HATS, local_splines
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER

#: Modes without a stiffness, as where the tool would yield by less than nothing, may have the rest
#: of this share [1].
_LEAST_SHARE = 0.95


class LogStiffnesses(NamedTuple):
    """ln k of modes, each of shape (modes,)."""

    weights: Array
    values: Array  #: [1], k in N/m
    variances: Array  #: [1]


@dataclass(frozen=True, eq=False)
class SmallMotion:
    """The modes of a posterior, for predictions of a small motion.

    Attributes
    ----------
    model : PressModel
    components : tuple of Component
        Of the whole state.
    by_origin : ndarray, shape (n,)
        By what a state makes the strain origin, as compression [1].
    weight : float
        Of all its modes [1].
    shift : float
        By which its compressions are larger than those that are asked for [1].
    variance_factor : float
        By which contradictions of the data widen the variances [1].
    unseen : float
        Variance of ln k for a relaxation that has not been seen [1].
    solved : tuple of Component
        Those of the newest solution, without what filters have learned since; empty: that counts.
    """

    model: PressModel
    components: tuple[Component, ...]
    by_origin: Array
    weight: float = 1.0
    shift: float = 0.0
    variance_factor: float = 1.0
    unseen: float = 0.0
    solved: tuple[Component, ...] = ()

    def widened(self, factor: float) -> SmallMotion:
        """Return it with more variance."""
        return replace(self, variance_factor=factor * self.variance_factor)

    @property
    def when_solved(self) -> SmallMotion:
        """Return it as the newest solution had it."""
        return replace(self, components=self.solved) if self.solved else self

    def log_stiffnesses(
        self, compression: float, stress: float, time_scale: float
    ) -> LogStiffnesses:
        """Return ln k of its modes.

        Parameters
        ----------
        compression : float
            From the nominal origin [1].
        stress : float
            There [Pa]: it bends the tool.
        time_scale : float
            tau [s].
        """
        model, geometry, bending = self.model, self.model.geometry, self.model.bending
        states = np.array([mode.mean for mode in self.components])
        moves = stress * bending - self.by_origin
        own = np.maximum(compression + self.shift + states @ moves, 0.0)
        gradient, by_compression, values = _of_characteristic(model, states, own)
        gradient += by_compression[:, None] * moves
        relaxed, by_state = _of_relaxation(model, states, time_scale)
        gradient += by_state
        values = values + relaxed
        # Of the tissue's compression in that of both.
        modulus = np.exp(values)
        yields = 1.0 - modulus * (states @ bending)
        values = values - np.log(yields)
        gradient = (gradient + modulus[:, None] * bending) / yields[:, None]
        values -= math.log(geometry.stress_per_force * geometry.length)
        pairs = zip(gradient, self.components, strict=True)
        variances = np.array([own @ mode.covariance @ own for own, mode in pairs])
        weights = self.weight * np.array([mode.weight for mode in self.components])
        variances = self.variance_factor * np.maximum(variances, 0.0) + self.unseen
        return LogStiffnesses(weights, values, variances)


def log_stiffness(
    motions: Sequence[SmallMotion], compression: float, stress: float, time_scale: float
) -> tuple[float, float] | None:
    """Return mean and variance of ln k [ln N/m] of all modes of several posteriors; None: none.

    The variance is at least that of what the newest solutions make of it, where these are stated:
    what filters have learned since, about a curve that bends, moves the mean alone. On the ramp of
    a spring and dashpot one took the standard deviation of ln Gn from 0.7 to 0.02 in two blocks.

    The parameters are those of :meth:`SmallMotion.log_stiffnesses`.
    """
    at = compression, stress, time_scale
    now = _moments(motions, *at)
    if now is None or not any(motion.solved for motion in motions):
        return now
    solved = _moments([motion.when_solved for motion in motions], *at)
    return (now[0], max(now[1], solved[1])) if solved is not None else None


def _moments(
    motions: Sequence[SmallMotion], compression: float, stress: float, time_scale: float
) -> tuple[float, float] | None:
    """Return mean and variance of ln k of all modes as they are; None: there is none."""
    # A mode has none at the surface of a sphere, or where the tool would push.
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


def _of_characteristic(
    model: PressModel, states: Array, compressions: Array
) -> tuple[Array, Array, Array]:
    """Return the derivatives of ln (psi' x') by state and compression, and its values.

    Parameters
    ----------
    model : PressModel
    states : ndarray, shape (modes, n)
    compressions : ndarray, shape (modes,)

    Returns
    -------
    by_state, by_compression, values : ndarray, shape (modes, n), (modes,), (modes,)
    """
    knots = model.characteristic
    strains, per_compression, of_geometry = model.geometry.strains(compressions)
    value, slope, curvature, value_by_log_gn, slope_by_log_gn = model.curve(strains, states)
    gradient = np.zeros_like(states)
    gradient[:, LOG_G] = 1.0
    bend = tilt = turn = np.zeros_like(strains)
    own = slope
    if model.is_bent:
        found = local_splines(strains, model.last_knot, knots.stop - knots.start)
        at = np.arange(strains.size)[:, None], knots.start + found.cell[:, None] + np.arange(3)
        bend, tilt, turn = ((each * states[at]).sum(axis=1) for each in found[1:])
        own = slope + value * tilt
        gradient[at] = found.values + (value / own)[:, None] * found.slopes
    gradient[:, LOG_GN] = (slope_by_log_gn + value_by_log_gn * tilt) / own
    by_strain = tilt + (curvature + slope * tilt + value * turn) / own
    values = np.log(own * per_compression) + bend
    by_compression = by_strain * per_compression + of_geometry
    return gradient, by_compression, values


def _of_relaxation(model: PressModel, states: Array, time: float) -> tuple[Array, Array]:
    """Return ln E at a time, (modes,), and its derivatives by the state, (modes, n)."""
    parts, slopes = model.relaxation_after(states[:, ORDER], time)
    gradient = np.zeros_like(states)
    if model.is_bent:
        hats = KERNEL_HATS[: parts.shape[1]]
        bend = np.exp(states[:, model.kernel] @ hats.T)
        parts, slopes = parts * bend, slopes * bend
        gradient[:, model.kernel] = parts @ hats
    total = parts.sum(axis=1)
    gradient[:, ORDER] = slopes.sum(axis=1)
    return np.log(total), gradient / total[:, None]
