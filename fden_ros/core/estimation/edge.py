# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether an estimate lies at an end of what the estimator can represent: then it is none.

ln Gn stays between its nodes, alpha between the ends of its interpolation and ln G within reach of
its prior. A tissue beyond piles the posterior up at the end, narrow and wrong.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.law.interpolation import LOG_SPACING, LogStiffnessGrid
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER

#: Share of the weight [1] from which on the posterior counts as being at the end.
EDGE_SHARE = 0.1
#: Standard deviations [1], and least distance in ln Gn [1], from the end within which a normal
#: posterior of ln Gn leans on it.
_DEVIATIONS, _LEAST_DISTANCE = 2.0, 0.5 * LOG_SPACING
#: Nodes of ln Gn [1] at an end that are the end, nodes [1] from it where the likelihood is
#: compared, and by how many times [1] it must have grown from there to the end. (Where Gn is not
#: observable the likelihood is flat towards small Gn. A posterior that decays from the end by this
#: much has a standard deviation of at most 0.36.)
_END_NODES, _INNER_NODE, _GROWTH = 2, 4, 3.0
#: Distance of alpha from its ends [1] within which it is there, unless its deviation is smaller.
_ORDER_MARGIN = 0.01
#: Distance of ln G from the end of its reach [1] within which it is there.
_LOG_MARGIN = 1.0


def log_gn_leans_on_end(grid: LogStiffnessGrid, log_gn: float, deviation: float) -> bool:
    """Return whether a normal posterior of ln Gn reaches beyond the nodes."""
    distance = min(log_gn - grid.lowest, grid.highest - log_gn)
    return distance <= max(_DEVIATIONS * deviation, _LEAST_DISTANCE)


def ends_have_weight(weights: Array) -> bool:
    """Return whether there is weight at an end, so that the likelihood may grow towards it."""
    low, high = weights[:_END_NODES].sum(), weights[-_END_NODES:].sum()
    return bool(max(low, high) >= EDGE_SHARE)


def weights_pile_up(weights: Array, log_prior: Array) -> bool:
    """Return whether the likelihood of ln Gn grows towards an end node that has weight.

    Parameters
    ----------
    weights : ndarray, shape (nodes,)
        Of sum 1.
    log_prior : ndarray, shape (nodes,)
        Logarithms of the weights before the data, but for a constant.
    """
    for own, prior in ((weights, log_prior), (weights[::-1], log_prior[::-1])):
        inner = own[_INNER_NODE] * math.exp(prior[0] - prior[_INNER_NODE])
        if own[:_END_NODES].sum() >= EDGE_SHARE and own[0] > _GROWTH * inner:
            return True
    return False


def order_is_at_end(orders: Array | float, deviation: float) -> NDArray[np.bool_]:
    """Return whether orders alpha, shape (...), are at an end of their range, shape (...)."""
    distance = np.minimum(orders - LOWEST_ORDER, HIGHEST_ORDER - orders)
    return np.asarray(distance <= min(deviation, _ORDER_MARGIN))


def log_g_is_at_end(distance: float, reach: float) -> bool:
    """Return whether ln G is as far from its prior as it can be."""
    return abs(distance) >= reach - _LOG_MARGIN
