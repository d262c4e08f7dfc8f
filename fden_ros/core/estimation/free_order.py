# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the data say of alpha where its stated value is left out.

Where a narrow prior of alpha is wrong, or a wrong alpha is given, the prediction is off wherever
the motion bends. That is a smooth error, however large, and no change of the tissue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER

_ORDER = StateIndex.FRACTIONAL_ORDER
#: What soft tissue can be stands in for what is stated.
_WIDE = Prior()


@dataclass(frozen=True)
class FreeOrder:
    """Where alpha goes when the data alone decide, in first order.

    Parameters
    ----------
    shift : float
        From the state's alpha [1].
    variance : float
        Of alpha by then [1].
    direction : ndarray, shape (n,)
        By how much the state moves with alpha: its most likely value given alpha.
    """

    shift: float
    variance: float
    direction: Array

    @classmethod
    def nothing(cls) -> FreeOrder:
        """Return that alpha is as free as it can be."""
        return cls(0.0, 0.0, np.zeros(len(StateIndex)))

    def added_variance(self, jacobian: Array, covariance: Array) -> float:
        """Return by how much a prediction is more uncertain with alpha anywhere up to there.

        Parameters
        ----------
        jacobian : ndarray, shape (n,)
            Of the prediction by the state.
        covariance : ndarray, shape (n,)
            Of the state with alpha. It knows as few of the newest blocks as the prediction does;
            where alpha is given without a deviation, `direction` stands in.
        """
        variance = float(covariance[_ORDER])
        direction = covariance / variance if variance > 0.0 else self.direction
        by_order = float(jacobian @ direction)
        return by_order**2 * (max(self.variance - variance, 0.0) + self.shift**2)


def free_order(quadratic: Array, state: Array, prior: StatePrior) -> FreeOrder:
    """Return where alpha goes when the data alone decide.

    Parameters
    ----------
    quadratic : ndarray, shape (n + 1, n + 1)
        Products of residual, which stands first, and derivatives at the state.
    state : ndarray, shape (n,)
    prior : StatePrior
    """
    if prior.deviations[_ORDER] >= _WIDE.fractional_order_sd:
        return FreeOrder.nothing()
    learned = prior.learned
    others = learned[learned != _ORDER]
    precision = prior.precision(others)
    hessian = quadratic[1 + others[:, None], 1 + others] + precision
    coupling = quadratic[1 + others, 1 + _ORDER]
    try:
        along = -np.linalg.solve(hessian, coupling)
    except np.linalg.LinAlgError:
        return FreeOrder.nothing()
    off = state - prior.mean
    gradient = quadratic[0, 1 + others] + off[others] @ precision
    wide = _WIDE.fractional_order_sd**-2.0
    information = max(float(quadratic[1 + _ORDER, 1 + _ORDER] + coupling @ along), 0.0) + wide
    slope = float(quadratic[0, 1 + _ORDER] + gradient @ along)
    slope += wide * (float(state[_ORDER]) - _WIDE.fractional_order)
    order = float(state[_ORDER])
    wanted = min(max(order - slope / information, LOWEST_ORDER), HIGHEST_ORDER)
    direction = np.zeros(state.size)
    direction[_ORDER], direction[others] = 1.0, along
    return FreeOrder(wanted - order, 1.0 / information, direction)
