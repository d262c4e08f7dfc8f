# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Stiffness for a small motion that lasts tau, with its deviation.

A fractional solid has no stiffness without a time scale, and a nonlinear one none without a
strain. The apparent modulus is

.. math:: E = \varphi'(x)\,\frac{\tau^{-\alpha}}{\Gamma(1-\alpha)}, \qquad
   \ln E = \ln G + \max(G_n |x| - 1, 0) - \alpha \ln\tau - \ln\Gamma(1 - \alpha),

and the stiffness dF/dd follows from the geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import digamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.core.law.geometry import Geometry


@dataclass(frozen=True)
class ApparentStiffness:
    """dF/dd for a small motion that lasts `time_scale`."""

    value: float  #: [N/m]
    sd: float  #: [N/m]
    time_scale: float  #: tau [s]


class LogStiffness(NamedTuple):
    """ln E of one place, or of many."""

    value: Array  #: [1], E in Pa
    variance: Array  #: [1]


def log_stiffness_at(
    mean: Array, covariance: Array, geometry: Geometry, compression: float, time_scale: float
) -> tuple[float, float] | None:
    """Return mean and variance of ln dF/dd [ln N/m], to first order; None: there is no stiffness.

    Beyond 1/Gn it is Gn times the stress, and as certain as these, whatever G and origin.

    Parameters
    ----------
    mean : ndarray, shape (3,)
        Of (ln G, ln Gn, alpha).
    covariance : ndarray, shape (4, 4)
        Of these and the strain origin.
    compression : float
        u, from the strain origin [1].
    time_scale : float
        tau [s].
    """
    strain = geometry.strain(compression)
    slope = geometry.strain_slope(compression)
    if slope <= 0.0:
        return None
    # ln E depends on the strain through Gn x.
    by_origin = np.zeros((4, 3))
    by_origin[:3] = np.eye(3)
    by_origin[3, 1] = -slope / strain if strain > 0.0 else 0.0
    own: Array = by_origin.T @ covariance @ by_origin
    log_value, variance = log_stiffness(mean, own, strain, time_scale)
    per_strain = slope / (geometry.stress_per_force * geometry.length)
    return float(log_value) + math.log(per_strain), float(variance)


def log_stiffness(
    mean: Array, covariance: Array, strain: float, time_scale: float
) -> LogStiffness:
    """Return ln E and its variance.

    Parameters
    ----------
    mean : ndarray, shape (..., 3)
        Of (ln G, ln Gn, alpha).
    covariance : ndarray, shape (..., 3, 3)
    strain : float
        x [1].
    time_scale : float
        tau [s].
    """
    order = mean[..., 2]
    reach = np.exp(mean[..., 1]) * abs(strain)
    beyond = np.maximum(reach - 1.0, 0.0)
    value = mean[..., 0] + beyond - order * math.log(time_scale) - gammaln(1.0 - order)
    gradient = np.empty_like(mean)
    gradient[..., 0] = 1.0
    gradient[..., 1] = np.where(reach > 1.0, reach, 0.0)
    gradient[..., 2] = digamma(1.0 - order) - math.log(time_scale)
    variance = np.einsum("...i,...ij,...j->...", gradient, covariance, gradient)
    return LogStiffness(value, np.maximum(variance, 0.0))
