# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The constitutive law of FDEN: fractional dynamics, exponential nonlinearity.

.. math::
    D^\alpha \varphi(x) = f, \qquad
    \varphi(x) = \begin{cases} G x & |x| \le 1/G_n \\
    \operatorname{sgn}(x)\,(G/G_n)\,e^{G_n |x| - 1} & |x| > 1/G_n \end{cases}

(paper, eqs. 1 and 2 with the symmetric form of eq. partial7). The two branches join with equal
value and slope at the boundary strain :math:`x_b = 1/G_n`: one smooth observation, no switching.

Beyond the exponent :data:`MAX_EXPONENT` every function here continues phi along its tangent. The
scalar functions serve the filters sample by sample; those on arrays may differ from them in the
last bits, because numpy's exponential function differs from that of the C library.
"""

from __future__ import annotations

import math
import sys
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from fden_ros.core.arrays import Array

Number = TypeVar("Number", float, Array)

#: Exponent Gn |x| - 1 beyond which phi is continued by its tangent: e^60 is no tissue, and an
#: overflow would poison the filter.
MAX_EXPONENT = 60.0


class ElasticResponse(NamedTuple, Generic[Number]):
    """phi and its slope, at one strain or at many."""

    value: Number  #: phi(x) [Pa s^alpha]
    by_strain: Number  #: dphi/dx [Pa s^alpha]


def elastic_response(
    strain: float, linear_stiffness: float, nonlinear_stiffness: float
) -> ElasticResponse[float]:
    """Return phi(x) and its slope at one strain.

    Parameters
    ----------
    strain : float
        x [1], of either sign.
    linear_stiffness : float
        G [Pa s^alpha], positive.
    nonlinear_stiffness : float
        Gn [1], positive.
    """
    excess = nonlinear_stiffness * abs(strain) - 1.0
    if excess <= 0.0:
        return ElasticResponse(linear_stiffness * strain, linear_stiffness)
    capped = min(excess, MAX_EXPONENT)
    slope = linear_stiffness * math.exp(capped)
    value = math.copysign(slope / nonlinear_stiffness * (1.0 + excess - capped), strain)
    return ElasticResponse(value, slope)


def phi(
    strain: Array, linear_stiffness: float | Array, nonlinear_stiffness: float | Array
) -> Array:
    """Return phi(x) [Pa s^alpha] at many strains of either sign.

    Parameters
    ----------
    strain : ndarray, shape (...)
        x [1].
    linear_stiffness, nonlinear_stiffness : float or ndarray, shape (...)
        G [Pa s^alpha] and Gn [1], positive; the shapes must be broadcast to one.
    """
    excess = nonlinear_stiffness * np.abs(strain) - 1.0
    # e^(Gn x - 1) beyond 1/Gn and Gn x below it, both in one.
    result: Array = np.minimum(np.maximum(excess, 0.0), MAX_EXPONENT)
    np.exp(result, out=result)
    result += np.minimum(excess, 0.0)
    if (excess > MAX_EXPONENT).any():
        result += math.exp(MAX_EXPONENT) * np.maximum(excess - MAX_EXPONENT, 0.0)
    result *= linear_stiffness / nonlinear_stiffness
    return np.copysign(result, strain) if (strain < 0.0).any() else result


def elastic_responses(
    strain: Array, linear_stiffness: float, nonlinear_stiffness: float
) -> ElasticResponse[Array]:
    """Return phi(x) and its slope at many strains, each of the strains' shape."""
    value = phi(strain, linear_stiffness, nonlinear_stiffness)
    excess = np.maximum(nonlinear_stiffness * np.abs(strain) - 1.0, 0.0)
    slope = linear_stiffness * np.exp(np.minimum(excess, MAX_EXPONENT))
    return ElasticResponse(value, slope)


def strain_of_phi(values: Array, linear_stiffness: float, nonlinear_stiffness: float) -> Array:
    """Return the strains x [1] at which phi takes given values: the inverse of :func:`phi`."""
    scaled = values * (nonlinear_stiffness / linear_stiffness)
    inside = np.clip(scaled, -1.0, 1.0)
    beyond = np.maximum(np.abs(scaled), 1.0)
    on_tangent = np.maximum(beyond * math.exp(-MAX_EXPONENT) - 1.0, 0.0)
    exponent = np.minimum(np.log(beyond), MAX_EXPONENT) + on_tangent
    result: Array = inside * (1.0 + exponent) / nonlinear_stiffness
    return result


def log_phi(strain: Array, log_linear_stiffness: float, log_nonlinear_stiffness: float) -> Array:
    """Return ln phi at positive strains (n,), for fits over decades of stress.

    ln G + ln x up to 1/Gn and ln G + Gn x - 1 - ln Gn beyond (paper, eqs. parameter4 and
    parameter5).
    """
    scaled = math.exp(log_nonlinear_stiffness) * strain
    inside = np.log(np.minimum(scaled, 1.0))
    excess = np.maximum(scaled - 1.0, 0.0)
    beyond = np.minimum(excess, MAX_EXPONENT)
    result: Array = log_linear_stiffness - log_nonlinear_stiffness + inside + beyond
    return result + np.log1p(excess - beyond)


def log_strain(
    log_values: Array, log_linear_stiffness: float, log_nonlinear_stiffness: float
) -> Array:
    """Return ln x at which ln phi takes given values: the inverse of :func:`log_phi`."""
    excess = log_values - log_linear_stiffness + log_nonlinear_stiffness
    beyond = np.maximum(excess, 0.0)
    # A step of a fit that would overflow is rejected.
    largest = math.log(sys.float_info.max)
    on_tangent = np.expm1(np.clip(beyond - MAX_EXPONENT, 0.0, largest))
    exponent = np.minimum(beyond, MAX_EXPONENT) + on_tangent
    result: Array = np.minimum(excess, 0.0) + np.log1p(exponent) - log_nonlinear_stiffness
    return result


def exponential_scale(linear_stiffness: float, nonlinear_stiffness: float) -> float:
    """Return Gi = G / (Gn e) [Pa s^alpha] (paper, eq. parameter1)."""
    return linear_stiffness / (nonlinear_stiffness * math.e)


def apparent_stiffness_factor(fractional_order: float, time_scale: float) -> float:
    """Return tau^-alpha / Gamma(1 - alpha) [s^-alpha], the relaxation after tau per unit of G.

    Times dphi/dx this is the stress per strain that a small step meets after `time_scale` seconds
    (paper, eq. E1 with its factor corrected).
    """
    return float(time_scale**-fractional_order / math.gamma(1.0 - fractional_order))
