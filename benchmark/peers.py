# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Estimators of others, to compare with FDEN: contact models by least squares.

Each learns from samples of time [s], displacement into the tissue [m] and force [N], and predicts
the force of a further motion. Kelvin-Voigt, :math:`F = K x + B \dot x`, is linear. Hunt-Crossley,

.. math:: F = k x^n + \lambda x^n \dot x,

is linear in the logarithm, :math:`\ln F \approx \ln k + (\lambda/k) \dot x + n \ln x` (A. Haddadi,
K. Hashtrudi-Zaad, IEEE Trans. Robot. 28 (2012) 813). Both forget with a time constant of 1 s: it
makes them better.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array

#: Hunt-Crossley holds in contact: shallower samples are left out [m].
_LEAST_DEPTH = 1e-5
#: Bound of the exponential in a prediction.
_LARGEST_LOG = 50.0
_FORGETTING_TIME = 1.0
#: Samples that are used at most [1], the size of a step in parts of the depth [1], and times in
#: the step of 0.1 s [s].
_MOST_SAMPLES, _STEP, _AT_STEP = 500, 1e-4, np.array([0.01, 0.05, 0.1])


class Samples(NamedTuple):
    """What was measured; arrays of shape (n,)."""

    times: Array  #: [s]
    depths: Array  #: [m]
    forces: Array  #: [N]

    @property
    def velocities(self) -> Array:
        """Backward difference quotients [m/s], the first one as the second."""
        rates: Array = np.diff(self.depths) / np.diff(self.times)
        return np.append(rates[:1], rates)


#: From what is seen, and times and depths of what is to come, to its force [N].
Peer = Callable[[Samples, Samples], Array]


def kelvin_voigt(seen: Samples, ahead: Samples) -> Array:
    """Predict F = K x + B dx/dt."""
    design = np.column_stack([seen.depths, seen.velocities])
    stiffness, damping = _weighted(design, seen.forces, seen.times)
    result: Array = stiffness * ahead.depths + damping * ahead.velocities
    return result


def hunt_crossley(seen: Samples, ahead: Samples) -> Array:
    """Predict Hunt-Crossley, linear in the logarithm."""
    used = (seen.depths >= _LEAST_DEPTH) & (seen.forces > 0.0)
    depths, velocities = seen.depths[used], seen.velocities[used]
    design = np.column_stack([np.ones_like(depths), velocities, np.log(depths)])
    coefficients = _weighted(design, np.log(seen.forces[used]), seen.times[used])
    log_stiffness, damping, exponent = coefficients
    depth = np.log(np.maximum(ahead.depths, _LEAST_DEPTH))
    static = np.exp(np.clip(log_stiffness + exponent * depth, -_LARGEST_LOG, _LARGEST_LOG))
    result: Array = static * (1.0 + damping * ahead.velocities)
    return result


def _weighted(design: Array, values: Array, times: Array) -> Array:
    """Return the coefficients of least squares that forget."""
    root = np.exp(0.5 * (times - times[-1]) / _FORGETTING_TIME)
    return np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0])


def small_step(peer: Peer, seen: Samples) -> float:
    """Return the N/m that a small step from the last sample would meet."""
    # Some take the square of the samples.
    every = slice(None, None, -(-seen.times.size // _MOST_SAMPLES))
    seen = Samples(*(values[::-1][every][::-1] for values in seen))
    times, depth = seen.times[-1] + _AT_STEP, float(seen.depths[-1])
    step = _STEP * depth
    low, high = (
        peer(seen, Samples(times, np.full(times.size, at), np.zeros(times.size)))[-1]
        for at in (depth, depth + step)
    )
    return float(high - low) / step


PEERS: dict[str, Peer] = {
    "Kelvin-Voigt": kelvin_voigt,
    "Hunt-Crossley": hunt_crossley,
}
