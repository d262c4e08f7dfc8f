# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress history of a place of the tissue, and the free surface that follows from it."""

from __future__ import annotations

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.relaxation import RATE_COUNT, RATES, memory_weights, passed

#: The stress falls to 0 within 1 ms [s] where its end was not observed.
LETTING_GO = 1e-3


class StressMemory:
    """Exponential moments of the stress at one place, in constant memory.

    Examples
    --------
    The integral of order 1/2 of f(t) = t is t^1.5 / Gamma(2.5), whatever the steps:

    >>> memory = StressMemory()
    >>> for step, stress in ((0.1, 0.1), (0.5, 0.6), (0.4, 1.0)):
    ...     memory.press(step, stress)
    ...     mean = memory.means(1)
    >>> round(float(memory_weights(0.5) @ mean), 4)
    0.7522
    """

    def __init__(self) -> None:
        self._moments: Array = np.zeros(RATE_COUNT)
        self._stress = 0.0
        self._waiting: list[tuple[float, float]] = []
        self._sum: Array = np.zeros(RATE_COUNT + 1)

    def press(self, step: float, stress: float) -> None:
        """Add a stress [Pa] `step` seconds after the last."""
        self._waiting.append((step, stress))

    def rest(self, duration: float) -> None:
        """Let the tissue relax free of stress for some time [s]."""
        self._catch_up()
        first = min(LETTING_GO, 0.5 * duration)
        decay, gain = passed(first, self._stress, 0.0)
        self._moments = np.exp(-RATES * (duration - first)) * (decay * self._moments + gain)
        self._stress = 0.0

    def begin_block(self) -> None:
        """Begin new means with the next sample."""
        self.means(1)

    def means(self, size: int) -> Array:
        """Return the means over the `size` samples since the last.

        Returns
        -------
        ndarray, shape (RATE_COUNT + 1,)
            Moments [Pa s] and stress [Pa], as :func:`memory_weights` weighs them.
        """
        self._catch_up()
        total, self._sum = self._sum, np.zeros(RATE_COUNT + 1)
        return total / size

    def free_response(self, step: float, order: float) -> float:
        """Return phi of the free surface `step` seconds from the last sample [Pa s^alpha]."""
        self._catch_up()
        decay, gain = passed(step, self._stress, 0.0)
        return float(memory_weights(order)[:RATE_COUNT] @ (decay * self._moments + gain))

    def _catch_up(self) -> None:
        """Add the samples that wait: together their decays cost a third of what each would."""
        if not self._waiting:
            return
        steps, stresses = np.array(self._waiting).T
        self._waiting.clear()
        before = np.append(self._stress, stresses[:-1])
        moments, total = self._moments, self._sum[:RATE_COUNT]
        for decay, gain in zip(
            *passed(steps[:, None], before[:, None], stresses[:, None]), strict=True
        ):
            moments = decay * moments + gain
            total += moments
        self._moments, self._stress = moments, float(stresses[-1])
        self._sum[RATE_COUNT] += stresses.sum()
