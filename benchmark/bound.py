# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The Bayesian Cramér-Rao bound of a simulated contact.

No estimator that knows the prior :math:`\theta \sim N(\theta_0, P_0)` and sees the stress in white
noise :math:`\sigma` has a smaller mean squared error than

.. math:: \left(\frac{1}{\sigma^2} \sum_k J_k J_k^T + P_0^{-1}\right)^{-1},
          \qquad J_k = \partial f(t_k; \theta) / \partial\theta

(Van Trees, Detection, Estimation, and Modulation Theory I, 1968, sec. 2.4; the information at the
true parameters, for each contact its own). :math:`\theta` is (ln G, ln Gn, alpha, origin, bias):
unknowns of an estimator are unknown here too.

The derivative by the origin is singular at the touch, as :math:`(t - t_0)^{-\alpha}`, and a single
sample close to it would weigh more than its information. So that derivative is a difference over
the origin's own standard deviation to either side, found by iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.simulation import FdenModel
from simulation.closed_form import LinearMove
from simulation.contact import contacts_of_moves

#: Of (ln G, ln Gn, alpha, origin, bias), the order everywhere.
_ORIGIN = 3
_STEP = 1e-4
#: Start of the iteration for the origin's step, and its length.
_FIRST_ORIGIN_STEP, _ITERATIONS = 5e-4, 2
_TIMES = 800


def slope(response: Callable[[Array], Array], parameters: Array, index: int, step: float) -> Array:
    """Return the central difference of a response by one parameter, shape (samples,)."""
    offset = np.zeros_like(parameters)
    offset[index] = step
    result: Array = (response(parameters + offset) - response(parameters - offset)) / (2.0 * step)
    return result


def bounds(information: Array, prior: Array) -> Array:
    """Return the least standard deviations, shape (n,).

    `information` of the data, shape (n, n), is the sum of J J^T over the variance of the noise;
    `prior`, shape (n,), has the standard deviations before; 0: known, inf: nothing is known.
    """
    unknown = np.flatnonzero(prior > 0.0)
    total = information[np.ix_(unknown, unknown)] + np.diag(prior[unknown] ** -2.0)
    result = np.zeros(prior.size)
    # Scaled, because a bias in Pa and an origin differ by orders of magnitude.
    scale = total.diagonal() ** -0.5
    inverse = np.linalg.inv(total * np.outer(scale, scale))
    result[unknown] = scale * np.sqrt(inverse.diagonal())
    return result


def contact_bounds(
    moves: Sequence[LinearMove], model: FdenModel, stamps: Array, noise_pa: float, prior: Array
) -> Array:
    """Return the least standard deviations after all contacts of a motion, shape (5,).

    Parameters
    ----------
    moves : sequence of LinearMove
        The probe's motion, in strain from the true origin.
    model : FdenModel
        The true tissue.
    stamps : ndarray, shape (n,)
        When the stress was sampled [s].
    noise_pa : float
        Standard deviation of a sample [Pa].
    prior : ndarray, shape (5,)
        Deviations of (ln G, ln Gn, alpha, origin [1], bias [Pa]); 0: known, inf: unknown.
    """
    inside = np.zeros(stamps.shape, dtype=bool)
    for contact in contacts_of_moves(moves, model).contacts:
        inside |= (stamps > contact.start) & (stamps < contact.stop)
    times = stamps[inside]
    # The stress is smooth: samples at even distances stand for their neighbours.
    stride = max(1, times.size // _TIMES)
    times = times[stride // 2 :: stride]
    weight = math.sqrt(inside.sum() / max(times.size, 1)) / noise_pa

    def response(parameters: Array) -> Array:
        log_gn, alpha, origin = parameters
        tissue = FdenModel(model.linear_stiffness, math.exp(log_gn), float(alpha))
        return weight * contacts_of_moves(_shifted(moves, float(origin)), tissue).stress(times)

    truth = np.array([math.log(model.nonlinear_stiffness), model.fractional_order, 0.0])
    rows = np.array(
        [
            response(truth),  # by ln G
            slope(response, truth, 0, _STEP),
            slope(response, truth, 1, _STEP),
            np.zeros_like(times),
            np.full_like(times, weight),  # by the bias
        ]
    )
    if prior[_ORIGIN] == 0.0:
        return bounds(rows @ rows.T, prior)
    step = _FIRST_ORIGIN_STEP
    for _ in range(_ITERATIONS):
        rows[_ORIGIN] = slope(response, truth, 2, step)
        found = bounds(rows @ rows.T, prior)
        step = float(found[_ORIGIN])
    return found


def _shifted(moves: Sequence[LinearMove], origin: float) -> list[LinearMove]:
    """Return the linear motion in strain from another origin."""
    return [
        replace(m, start_strain=m.start_strain - origin, stop_strain=m.stop_strain - origin)
        for m in moves
    ]
