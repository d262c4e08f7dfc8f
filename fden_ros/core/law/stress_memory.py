# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress that a place of the tissue has borne, and what its free surface makes of it."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.law.kernel import order_nodes, order_weights

#: The tissue's relaxation between two contacts is followed in steps, the first of 1 ms [s], each
#: longer by 4 %. (Eight steps a decade would bias Gn by a third of its error's bound.)
_FIRST_REST, _REST_RATIO = 1e-3, 1.04


class StressMemory:
    """Fractional integrals of the stress at one place, in constant memory.

    Parameters
    ----------
    exact_orders : tuple of float
        Orders at which the integrals are not interpolated [1].
    """

    def __init__(self, exact_orders: tuple[float, ...] = ()) -> None:
        self._exact = len(exact_orders)
        self._integral = FractionalIntegral((*exact_orders, *order_nodes()))

    def press(self, step: float, stress: float) -> None:
        """Take a stress [Pa] `step` seconds after the last."""
        self._integral.add(step, stress)

    def release(self, step: float) -> None:
        """Let the stress be 0 by `step` seconds after the last."""
        self._integral.advance(step, 0.0)

    def rest(self, duration: float) -> None:
        """Let the tissue relax free of stress for some time [s]."""
        first = min(_FIRST_REST, 0.5 * duration)
        count = 2
        if first == _FIRST_REST:
            count += math.ceil(math.log(duration / first) / math.log(_REST_RATIO))
        elapsed = np.geomspace(first, duration, count)
        self._integral.relax(tuple(np.diff(elapsed, prepend=0.0).tolist()))

    def begin_block(self) -> None:
        """Let the next means be those of what comes now."""
        self._integral.take_sum()

    def means(self, size: int) -> Array:
        """Return the integrals' means over the `size` samples since the last [Pa s^beta]."""
        return self._integral.take_sum() / size

    def at_order(self, integrals: Array, order: float) -> float:
        """Return one of the integrals, interpolated at an order [1]."""
        return float(order_weights(order) @ integrals[self._exact :])

    def free_response(self, step: float, order: float) -> float:
        """Return phi of the free surface `step` seconds from the last sample [Pa s^alpha]."""
        return float(order_weights(order) @ self._integral.ahead(step)[self._exact :])
