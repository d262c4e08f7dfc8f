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

r"""The paper's filter of Appendix D, to the letter: a baseline, not a part of the identifier.

An extended Kalman filter with the state :math:`\theta = (G, G_n)` itself, not its logarithm, and
one term of the observation at a time (eqs. D2a to D2c), as Appendix F says with f' in place of f:

.. math::
    y = f',\quad h = G x \quad (x < 1/G_n), \qquad
    y = \log f',\quad h = G_n x + \log\frac{G}{G_n e} \quad (x > 1/G_n).

:math:`\theta_0` comes from straight lines through the three data of least and of largest strain.
The region is decided by the present estimate of Gn. The paper gives neither P nor R: P_0 is the
tissue prior's, R that of the fractional stress in white noise, propagated to the logarithm where
that is observed. alpha, the strain origin and the force's bias are given, and exact: what the
paper takes for granted.
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import Prior

_START = 3


def identify(
    strain: Array, fractional: Array, deviations: Array, prior: Prior
) -> tuple[Array, Array] | None:
    """Return ln G and ln Gn with their covariance, or None where the filter breaks down.

    Parameters
    ----------
    strain, fractional : ndarray, shape (n,)
        x [1] and f' [Pa s^alpha], in time.
    deviations : ndarray, shape (n,)
        Standard deviations of f'.
    prior : Prior
        For the first covariance.
    """
    state = _start(strain, fractional)
    if state is None:
        return None
    kalman = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    kalman.x = state
    kalman.P = np.diag(
        [
            (prior.linear_stiffness_log_sd * prior.linear_stiffness) ** 2,
            (prior.nonlinear_stiffness_log_sd * prior.nonlinear_stiffness) ** 2,
        ]
    )
    for x, value, deviation in zip(strain, fractional, deviations, strict=True):
        g, g_n = kalman.x
        if not (g > 0.0 and g_n > 0.0):
            # h() takes their logarithm: the filter has broken down.
            return None
        if x < 1.0 / g_n:
            _update(kalman, value, g * x, np.array([[x, 0.0]]), deviation**2)
        elif value > 0.0:
            predicted = g_n * x + math.log(g / (g_n * math.e))
            jacobian = np.array([[1.0 / g, x - 1.0 / g_n]])
            _update(kalman, math.log(value), predicted, jacobian, (deviation / value) ** 2)
    g, g_n = kalman.x
    if not (math.isfinite(g) and math.isfinite(g_n) and g > 0.0 and g_n > 0.0):
        return None
    scale = np.diag([1.0 / g, 1.0 / g_n])
    return np.log(kalman.x), scale @ kalman.P @ scale


def _update(
    kalman: ExtendedKalmanFilter, value: float, predicted: float, jacobian: Array, noise: float
) -> None:
    kalman.update(np.array([value]), lambda _: jacobian, lambda _: np.array([predicted]), R=noise)


def _start(strain: Array, fractional: Array) -> Array | None:
    """Return G and Gn from the three data of least, and the three of largest strain."""
    order = np.argsort(strain, kind="stable")
    low, high = order[:_START], order[-_START:]
    if np.any(fractional[high] <= 0.0) or np.ptp(strain[high]) <= 0.0:
        return None
    g = float(strain[low] @ fractional[low] / (strain[low] @ strain[low]))
    g_n = float(np.polyfit(strain[high], np.log(fractional[high]), 1)[0])
    return np.array([g, g_n])
