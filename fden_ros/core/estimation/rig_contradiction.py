# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the data contradict what is stated of the rig: its compliance, delay and friction."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.state_prior import StatePrior

#: What is stated of the rig is contradicted beyond this many deviations [1]: 1 % of contacts do by
#: chance, for each of three quantities.
_CONTRADICTION = 2.5
#: Added to a variance that may be 0, before it divides [1].
_TINY_VARIANCE = 1e-12
#: The data say nothing of a quantity whose variance they lower by less than this share [1].
_LEAST_LEARNED = 0.02

_RIG = np.array([StateIndex.COMPLIANCE, StateIndex.DELAY, StateIndex.FRICTION])


class StatedRig:
    """Compares what is stated of the rig with a posterior.

    Parameters
    ----------
    prior : StatePrior
        As stated; widened where it is contradicted.
    """

    def __init__(self, prior: StatePrior) -> None:
        self._prior = prior
        self._stated = prior.deviations[_RIG] ** 2

    def widen(self, state: Array, covariance: Array) -> bool:
        """Widen what is stated of the rig where the data contradict it; return whether they do.

        The posterior's mean scatters about the prior's by the prior's variance less its own. The
        quantity that is farthest beyond has the variance of the largest evidence from here on: the
        square of what the data alone would say, less the variance of that (empirical Bayes).
        """
        prior = self._prior
        variance = prior.deviations[_RIG] ** 2
        learned = variance - covariance[_RIG, _RIG]
        moved = (state - prior.mean)[_RIG]
        is_told = learned > _LEAST_LEARNED * variance
        beyond = np.divide(moved**2, learned, out=np.zeros_like(moved), where=is_told)
        k = int(np.argmax(beyond))
        if beyond[k] <= _CONTRADICTION**2:
            return False
        share = learned[k] / variance[k]
        prior.deviations[_RIG[k]] = math.sqrt(
            (moved[k] / share) ** 2 - variance[k] / share + variance[k]
        )
        return True

    def log_widening(self) -> float:
        """Return the logarithm of how much wider the prior is than what is stated [1]."""
        stated = np.sqrt(self._stated)
        is_open = stated > 0.0
        widened = self._prior.deviations[_RIG][is_open] / stated[is_open]
        return float(np.sum(np.log(widened)))

    def deviations(self, state: Array, covariance: Array) -> float:
        """Return how far the rig is from what is stated, in deviations [1]: the farthest of three.

        By what the data alone would say, and the variances of both.
        """
        prior = self._prior
        variance = prior.deviations[_RIG] ** 2
        share = 1.0 - covariance[_RIG, _RIG] / np.maximum(variance, _TINY_VARIANCE)
        told = share > _LEAST_LEARNED
        alone = np.divide((state - prior.mean)[_RIG], share, out=np.zeros(_RIG.size), where=told)
        own = np.divide(variance, share, out=np.ones(_RIG.size), where=told) - variance
        both = self._stated + np.maximum(own, 0.0) + _TINY_VARIANCE
        return float(np.max(np.abs(alone) / np.sqrt(both)))
