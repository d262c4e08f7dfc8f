r"""The constitutive law of FDEN: fractional dynamics, exponential nonlinearity.

.. math::
    D^\alpha \varphi(x) = f, \qquad
    \varphi(x) = \begin{cases} G x & |x| \le 1/G_n \\
    \operatorname{sgn}(x)\,(G/G_n)\,e^{G_n |x| - 1} & |x| > 1/G_n \end{cases}

(paper, eqs. 1 and 2 with the symmetric form of eq. partial7). The two branches join with equal
value and slope at the boundary strain :math:`x_b = 1/G_n`. With :math:`u = \ln G_n`,
:math:`\partial\varphi/\partial\ln G = \varphi` and
:math:`\partial\varphi/\partial u = \varphi\,(G_n|x| - 1)` beyond the boundary strain, 0 within:
one smooth observation, no switching.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class ElasticResponse(NamedTuple):
    """phi and its partial derivatives at one strain."""

    value: float  #: phi(x) [Pa s^alpha]; also its derivative by ln G
    by_log_nonlinear_stiffness: float  #: dphi/d(ln Gn) [Pa s^alpha]
    by_strain: float  #: dphi/dx [Pa s^alpha]


#: Beyond this exponent phi is continued by its tangent: e^60 is no tissue, and an overflow would
#: poison the filter.
_MAX_EXPONENT = 60.0


def elastic_response(
    strain: float, linear_stiffness: float, nonlinear_stiffness: float
) -> ElasticResponse:
    """Return phi(x) and its derivatives.

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
        return ElasticResponse(linear_stiffness * strain, 0.0, linear_stiffness)
    capped = min(excess, _MAX_EXPONENT)
    slope = linear_stiffness * math.exp(capped)
    value = math.copysign(slope / nonlinear_stiffness * (1.0 + excess - capped), strain)
    return ElasticResponse(value, value * excess, slope)


def exponential_scale(linear_stiffness: float, nonlinear_stiffness: float) -> float:
    """Return Gi = G / (Gn e) [Pa s^alpha] (paper, eq. parameter1)."""
    return linear_stiffness / (nonlinear_stiffness * math.e)


def apparent_stiffness_factor(fractional_order: float, time_scale: float) -> float:
    """Return tau^-alpha / Gamma(1 - alpha) [s^-alpha], the relaxation after tau per unit of G.

    A fractional solid has no single stiffness. Times dphi/dx this is the stress per strain that a
    small step meets after `time_scale` seconds (paper, eq. E1 with its factor corrected).
    """
    return float(time_scale**-fractional_order / math.gamma(1.0 - fractional_order))
