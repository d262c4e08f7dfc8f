# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

r"""The fractional order that a measured hold itself shows, whatever the stress-strain curve.

The law with a free curve: every step of phi on the ramp is a parameter of its own, not negative,

.. math:: f_n = \sum_j w_{nj}(\alpha)\, \Delta\varphi_j, \qquad
    w_{nj} = \frac{(t_n-t_{j-1})^{1-\alpha} - (t_n-t_j)^{1-\alpha}}
                  {\Gamma(2-\alpha)\,(t_j-t_{j-1})}

The forces of the ramp are then met by any order, and the hold alone decides. No estimator, no
prior and no exponential is in it: a truth for the orders that the estimator states.

Where a part of the stress does not relax, as beside a spring, the order of what does is another:
the kernel is then a power law and a constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from fden_ros.core.arrays import Array

#: Orders between which the best one is sought [1].
_LEAST, _MOST = 0.005, 0.9
_TOLERANCE = 1e-3
#: Largest constant beside the power law [s^-alpha], and what is close enough of two unknowns.
_MOST_SPRING, _COARSE = 3.0, 0.01


class HoldOrder(NamedTuple):
    """Order of a ramp and hold by a free stress-strain curve."""

    order: float  #: [1]
    misfit: float  #: root mean square over the largest force [1]
    spring: float = 0.0  #: constant beside the power law [s^-alpha]


def hold_order(times: Array, forces: Array, hold: int) -> HoldOrder:
    """Return the order by which the force of a hold relaxes.

    Parameters
    ----------
    times, forces : ndarray, shape (n,)
        From the touch on [s, N].
    hold : int
        Index of the first sample of the hold, at least 1.
    """

    def misfit(order: float) -> float:
        return float(nnls(_weights(times, hold, order), forces[1:])[1])

    found = _least(misfit, (_LEAST, _MOST), _TOLERANCE)
    return HoldOrder(found.at, found.value / _scale(forces))


def hold_order_beside_spring(times: Array, forces: Array, hold: int) -> HoldOrder:
    """Return the order of the part that relaxes, where another part of the force does not.

    Parameters
    ----------
    times, forces, hold
        As of `hold_order`.
    """
    elastic = _weights(times, hold, 0.0)

    def best_spring(order: float) -> _Least:
        relaxing = _weights(times, hold, order)
        return _least(
            lambda spring: float(nnls(relaxing + spring * elastic, forces[1:])[1]),
            (0.0, _MOST_SPRING),
            _COARSE,
        )

    order = _least(lambda order: best_spring(order).value, (_LEAST, _MOST), _COARSE).at
    spring = best_spring(order)
    return HoldOrder(order, spring.value / _scale(forces), spring.at)


class _Least(NamedTuple):
    at: float
    value: float


def _least(
    function: Callable[[float], float], bounds: tuple[float, float], close: float
) -> _Least:
    found = minimize_scalar(function, bounds=bounds, method="bounded", options={"xatol": close})
    return _Least(float(found.x), float(found.fun))


def _weights(times: Array, hold: int, order: float) -> Array:
    """Return the force after the touch by each step of phi up to the hold, (n - 1, hold)."""
    since = np.maximum(times[1:, None] - times[None, : hold + 1], 0.0) ** (1.0 - order)
    weights: Array = (since[:, :-1] - since[:, 1:]) / np.diff(times[: hold + 1])
    return weights / math.gamma(2.0 - order)


def _scale(forces: Array) -> float:
    return math.sqrt(forces.size) * float(forces.max())
