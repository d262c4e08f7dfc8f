# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the inner loops take: the law at one state, its derivatives, and what they go on from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.law.relaxation import COUNT as RATES

#: Strain about which the splines of the characteristic's error become wider, over that of their
#: last knot [1]; in `_loops.c` too.
NEAR = 0.1
#: What of the law a column of derivatives is by.
BY_NOTHING, BY_LOG_G, BY_LOG_GN, BY_COMPLIANCE, BY_FIRST_KNOT = range(5)


@dataclass(frozen=True)
class LawState:
    """The law at one state of the parameters."""

    #: G [Pa s^alpha] and Gn [1].
    linear_stiffness: float
    nonlinear_stiffness: float
    exponent: float  #: strain is compression to this power [1]: 1, or 1.5 for a sphere
    is_one_sided: bool  #: nothing pulls at the probe: without compression there is no stress
    compliance: float  #: what the stress takes off the compression [1/Pa]
    weights: Array  #: of the exponentials; then of those slower and of those faster, (RATES + 2,)
    #: Coefficients of the logarithm of the characteristic's error: a quadratic spline, evenly
    #: spaced in ln(1 + strain / (NEAR last_knot)). None, or three and more. Shape (knots,).
    bend: Array
    last_knot: float  #: strain of the last knot [1]

    @property
    def numbers(self) -> Array:
        """All but the arrays, for the compiled loops."""
        slow, fast = self.weights[RATES:].tolist()
        one_sided = float(self.is_one_sided)
        law = self.linear_stiffness, self.nonlinear_stiffness, self.exponent
        return np.array([*law, one_sided, self.compliance, slow, fast, self.last_knot])


@dataclass(frozen=True)
class Columns:
    """The derivatives of the response that are asked for."""

    #: One of the ``BY_...`` each; by the knot m of the characteristic's error: ``BY_FIRST_KNOT`` +
    #: m. Shape (columns,).
    kinds: NDArray[np.int32]
    #: Derivatives of the compression by the first columns [1]; by the others it has none, (moving,
    #: points).
    motions: Array
    weight_of: NDArray[np.int32]  #: row of `weights`; -1: none, (columns,)
    weights: Array  #: derivatives of the weights, (rows, RATES + 2)
    #: Derivatives of the free surface, in the unit of the elastic response, (columns, points).
    surfaces: Array | None = None

    @classmethod
    def none(cls, points: int) -> Columns:
        """Return no columns, for so many points."""
        nothing = np.zeros(0, dtype=np.int32)
        return cls(nothing, np.zeros((0, points)), nothing, np.zeros((0, RATES + 2)))

    @property
    def count(self) -> int:
        """Columns."""
        return self.kinds.size


class Response(NamedTuple):
    """The response of the law at the points."""

    stress: Array  #: (points,) [Pa]
    jacobian: Array  #: (points, columns)
    elastic: Array  #: the elastic response, (points,)
    slope: Array  #: its derivative by the compression, (points,)


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
    """Two random walks: their covariance, and per column their means."""

    covariance: Array  #: of the stress's walk, of both, of the surface's, (3,)
    means: Array  #: shape (2, columns)
