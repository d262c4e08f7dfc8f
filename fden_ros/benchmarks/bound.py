r"""The Bayesian Cramér-Rao bound of a simulated contact.

No estimator that knows the prior :math:`\theta \sim N(\theta_0, P_0)` and sees the stress in white
noise :math:`\sigma` has a smaller mean squared error than

.. math:: \left(\frac{1}{\sigma^2} \sum_k J_k J_k^T + P_0^{-1}\right)^{-1},
          \qquad J_k = \partial f(t_k; \theta) / \partial\theta

(Van Trees, Detection, Estimation, and Modulation Theory I, 1968, sec. 2.4; the information at the
true parameters, for each contact its own). :math:`\theta` is (ln G, ln Gn, alpha, origin, bias):
what an estimator does not know counts as unknown here too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fden_ros.simulation.closed_form import FdenModel, LinearMove, Move, SineMove
from fden_ros.simulation.contact import contacts_of_moves

Array = NDArray[np.float64]

#: Parameters, in this order everywhere.
PARAMETERS = ("log_g", "log_gn", "alpha", "origin", "bias")
_STEPS = (1e-4, 1e-4, 1e-4, 1e-5)
_TIMES = 800


@dataclass(frozen=True)
class PriorDeviations:
    """What is known beforehand, as standard deviations; 0: known exactly, inf: not at all.

    Parameters
    ----------
    log_g, log_gn, alpha, origin
        Of ln G, ln Gn, alpha and the strain origin [1].
    bias
        Of the stress [Pa].
    """

    log_g: float
    log_gn: float
    alpha: float
    origin: float
    bias: float


def information(response: Callable[[Array], Array], parameters: Array, steps: Array) -> Array:
    """Return the sum of J J^T, shape (n, n), of a response with unit noise.

    Parameters
    ----------
    response : callable
        From parameters, shape (n,), to what is observed without noise, shape (samples,).
    parameters : ndarray, shape (n,)
        The truth.
    steps : ndarray, shape (n,)
        Half the distance of the central differences.
    """
    jacobian = np.array(
        [
            (response(parameters + offset) - response(parameters - offset)) / (2.0 * step)
            for step, offset in zip(steps, np.diag(steps), strict=True)
        ]
    )
    result: Array = jacobian @ jacobian.T
    return result


def bounds(information_matrix: Array, prior: Array) -> Array:
    """Return the least standard deviations, shape (n,); 0 where the prior knows exactly.

    Parameters
    ----------
    information_matrix : ndarray, shape (n, n)
        Of the data.
    prior : ndarray, shape (n,)
        Standard deviations beforehand; 0: known, inf: nothing is known.
    """
    unknown = np.flatnonzero(prior > 0.0)
    total = information_matrix[np.ix_(unknown, unknown)] + np.diag(prior[unknown] ** -2.0)
    result = np.zeros(prior.size)
    # Scaled, because a bias in Pa and an origin differ by orders of magnitude.
    scale = total.diagonal() ** -0.5
    inverse = np.linalg.inv(total * np.outer(scale, scale))
    result[unknown] = scale * np.sqrt(inverse.diagonal())
    return result


def contact_bounds(
    moves: Sequence[Move],
    model: FdenModel,
    stamps: Array,
    noise_pa: float,
    prior: PriorDeviations,
) -> Array:
    """Return the least standard deviations of :data:`PARAMETERS` after all contacts of a motion.

    Parameters
    ----------
    moves : sequence of Move
        The probe's motion, in strain from the true origin.
    model : FdenModel
        The true tissue.
    stamps : ndarray, shape (n,)
        When the stress was sampled [s].
    noise_pa : float
        Standard deviation of a sample [Pa].
    prior : PriorDeviations

    Returns
    -------
    ndarray, shape (5,)
    """
    contacts = contacts_of_moves(moves, model).contacts
    inside = np.zeros(stamps.shape, dtype=bool)
    for contact in contacts:
        inside |= (stamps > contact.start) & (stamps < contact.stop)
    times = stamps[inside]
    # The stress is smooth: every so many samples stand for their neighbours.
    stride = max(1, times.size // _TIMES)
    times = times[stride // 2 :: stride]
    weight = math.sqrt(inside.sum() / max(times.size, 1)) / noise_pa

    def response(parameters: Array) -> Array:
        log_g, log_gn, alpha, origin, bias = parameters
        tissue = FdenModel(math.exp(log_g), math.exp(log_gn), float(alpha))
        stress = contacts_of_moves(_shifted(moves, float(origin)), tissue).stress(times)
        return weight * (stress + bias)

    truth = np.array(
        [
            math.log(model.linear_stiffness),
            math.log(model.nonlinear_stiffness),
            model.fractional_order,
            0.0,
            0.0,
        ]
    )
    deviations = np.array([getattr(prior, name) for name in PARAMETERS])
    return bounds(information(response, truth, np.array([*_STEPS, 1.0])), deviations)


def _shifted(moves: Sequence[Move], origin: float) -> list[Move]:
    """Return the motion in strain from another origin."""
    shifted: list[Move] = []
    for move in moves:
        if isinstance(move, LinearMove):
            shifted.append(
                replace(
                    move,
                    start_strain=move.start_strain - origin,
                    stop_strain=move.stop_strain - origin,
                )
            )
        elif isinstance(move, SineMove):
            shifted.append(replace(move, mean=move.mean - origin))
    return shifted
