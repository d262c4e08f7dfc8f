# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the inner loops take: the law at one state, its derivatives, and what they go on from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fden_ros.core.arrays import Array

#: Exponentials of the kernel [1].
RATES = 32
#: What of the law a column of derivatives is by.
BY_NOTHING, BY_LOG_G, BY_LOG_GN, BY_COMPLIANCE, BY_KNOT = range(5)


@dataclass(frozen=True)
class LawState:
    """The law at one state of the parameters.

    Attributes
    ----------
    linear_stiffness, nonlinear_stiffness : float
        G [Pa s^alpha] and Gn [1].
    exponent : float
        Strain is compression to this power [1]: 1, or 1.5 for a sphere.
    is_one_sided : bool
        Nothing pulls at the probe: without compression there is no stress.
    compliance : float
        What the stress takes off the compression [1/Pa].
    weights : ndarray, shape (RATES + 2,)
        Of the exponentials; then of those slower and of those faster.
    bend : ndarray, shape (knots,)
        Coefficients of the logarithm of the characteristic's error: a quadratic spline, evenly
        spaced in ln(1 + strain / (last_knot / 10)). None, or three and more.
    last_knot : float
        Strain of the last knot [1].
    """

    linear_stiffness: float
    nonlinear_stiffness: float
    exponent: float
    is_one_sided: bool
    compliance: float
    weights: Array
    bend: Array
    last_knot: float


@dataclass(frozen=True)
class Column:
    """One derivative of the response.

    Attributes
    ----------
    kind : int
        One of the ``BY_...``.
    knot : int
        Of the characteristic's error, where it is by that.
    motion : ndarray or None, shape (points,)
        Derivative of the compression [1].
    surface : ndarray or None, shape (points,)
        Derivative of the free surface, in the unit of the elastic response.
    weights : ndarray or None, shape (RATES + 2,)
        Derivative of the weights.
    """

    kind: int = BY_NOTHING
    knot: int = -1
    motion: Array | None = None
    surface: Array | None = None
    weights: Array | None = None


@dataclass
class ResponseState:
    """What the response and its derivatives go on from; made anew for each evaluation."""

    columns: int
    values: Array = field(init=False)
    is_begun: bool = False

    def __post_init__(self) -> None:
        self.values = np.zeros((self.columns + 1) * (RATES + 3) + 4)


@dataclass
class WalkState:
    """Two random walks: their covariance, and per column their means.

    Attributes
    ----------
    covariance : ndarray, shape (3,)
        Of the stress's walk, of both, of the surface's.
    means : ndarray, shape (2, columns)
    """

    covariance: Array
    means: Array
