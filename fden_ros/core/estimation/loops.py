# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The compiled loops of the posterior.

The law's response to a motion that is linear between points,

.. math::
    f(t) = \int E(t-s)\,d\psi(s), \qquad E(t) = \sum_i w_i e^{-\lambda_i t},

with psi the elastic response in excess of the tissue's free surface. In each step the rate of psi
is a parabola (a cubic through psi at four Gauss-Lobatto places), so each exponential goes on by

.. math::
    q_i \leftarrow e^{-\lambda_i h} q_i + \sum_{k=0}^{2} r_k M_k(\lambda_i h), \qquad
    M_k(y) = \int_{-1}^{1} e^{-y(1-s)/2} P_k(s)\,ds .

The moments M do not depend on the parameters and are computed once. A derivative is the same
recursion on the derivative of psi. Whatever else is done once for each block or place of the grid
of scales stands there too: the error processes, whitening, normal equations and their weighing.
The C sources are in `compiled/`; numpy and scipy are their oracle in the tests.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.law import LAYER_TERMS, RATE_COUNT, RATES

_MEND = "fden_ros is not built for this Python: with a C compiler (build-essential) install it"
try:
    from fden_ros.core.estimation import _loops as _compiled  # type: ignore[attr-defined]
except ImportError as missing:
    raise ImportError(f"{_MEND} again") from missing
# Of what the functions take; raised with every change of it.
if _compiled.VERSION != 5:
    raise ImportError(f"{_MEND} again: its compiled part is of version {_compiled.VERSION}")


class By(enum.IntEnum):
    """What of the law a column of derivatives is by; in `compiled/loops.h` too."""

    NOTHING = 0
    LOG_G = 1
    LOG_GN = 2
    COMPLIANCE = 3
    FIRST_KNOT = 4


@dataclass(frozen=True)
class LawState:
    """The law at one state of the parameters."""

    #: G [Pa s^alpha] and Gn [1].
    linear_stiffness: float
    nonlinear_stiffness: float
    exponent: float  #: strain is compression to this power [1]: 1.5 for a sphere
    is_one_sided: bool  #: nothing pulls at the probe: without compression there is no stress
    compliance: float  #: what the stress takes off the compression [1/Pa]
    weights: Array  #: of the exponentials; then of those slower and of those faster, (RATES + 2,)
    #: Coefficients of the logarithm of the characteristic's error: a quadratic spline, evenly
    #: spaced in ln(1 + strain / (NEAR last_knot)). None, or three and more. Shape (knots,).
    bend: Array
    last_knot: float  #: strain of the last knot [1]
    #: Of the geometry: by what factor a layer strains more than that power.
    series: tuple[float, ...] = (0.0,) * LAYER_TERMS

    @property
    def numbers(self) -> Array:
        """All but the arrays, in the order of the compiled loops."""
        slow, fast = self.weights[RATE_COUNT:].tolist()
        one_sided = float(self.is_one_sided)
        law = self.linear_stiffness, self.nonlinear_stiffness, self.exponent
        return np.array(
            [*law, one_sided, self.compliance, slow, fast, self.last_knot, *self.series]
        )


@dataclass(frozen=True)
class Columns:
    """The derivatives of the response that are asked for."""

    #: One of :class:`By` each, none but NOTHING twice; by the knot m of the characteristic's
    #: error: FIRST_KNOT + m. Shape (columns,).
    kinds: Indices
    #: Derivatives of the compression by the first columns [1]; by the others it has none, (moving,
    #: points).
    motions: Array
    weight_of: Indices  #: row of `weights`; -1: none, (columns,)
    weights: Array  #: derivatives of the weights, (rows, RATES + 2)
    #: Derivatives of the free surface, in the unit of the elastic response, (columns, points).
    surfaces: Array | None = None


_NO_COLUMNS = Columns(
    np.zeros(0, dtype=np.int64),
    np.zeros((0, 0)),
    np.zeros(0, dtype=np.int64),
    np.zeros((0, RATE_COUNT + 2)),
)


class Steps(NamedTuple):
    """The steps of a motion, and the blocks that its points make."""

    durations: Array  #: of the steps that end at the points [s], (points,)
    moments: Array  #: of these, (points, 4, RATES)
    #: Points of each block, one or two beside each other: it is their mean, (blocks,).
    first: Indices
    last: Indices

    @classmethod
    def of(cls, durations: Array) -> Steps:
        """Return steps whose points are blocks by themselves."""
        places = np.arange(durations.size)
        return cls(durations, moments(durations), places, places)


@dataclass
class ResponseState:
    """What the response and its derivatives go on from; made anew for each evaluation."""

    columns: int
    values: Array = field(init=False)
    is_begun: bool = False

    def __post_init__(self) -> None:
        self.values = np.zeros((self.columns + 1) * (RATE_COUNT + 3) + 5)


class Evaluation(NamedTuple):
    """The stress of a press at one state, with its derivatives."""

    stress: Array  #: of the blocks [Pa], (blocks,)
    jacobian: Array  #: shape (blocks, columns)
    #: Elastic response at the points [Pa s^alpha], and its derivative by the compression,
    #: (points,).
    elastic: Array
    slope: Array
    state: ResponseState  #: from which the response goes on


@dataclass
class WalkState:
    """Two random walks: their covariance, and per column their means."""

    covariance: Array  #: of the stress's walk, of both, of the surface's, (3,)
    means: Array  #: shape (2, columns)


def moments(durations: Array) -> Array:
    """Return decay and moments of each step, shape (steps, 4, RATES).

    `durations`: [s], (steps,).
    """
    result = np.empty((durations.size, 4, RATE_COUNT))
    _compiled.moments(durations, RATES, result)
    return result


def respond(
    law: LawState,
    steps: Steps,
    compressions: Array,
    surface: Array | None,
    columns: Columns | None,
    state: ResponseState,
) -> Evaluation:
    """Return the stress of every block with its derivatives.

    Parameters
    ----------
    compressions : ndarray, shape (points,)
        [1].
    surface : ndarray or None, shape (points,)
        The tissue's free surface, in the unit of the elastic response; None: at 0.
    state : ResponseState
        Is brought to the last point.

    Raises
    ------
    FloatingPointError
        If the stress is beyond floating-point numbers.
    """
    asked = _NO_COLUMNS if columns is None else columns
    elastic, slope = np.empty((2, compressions.size))
    stress = np.empty(steps.first.size)
    jacobian = np.empty((stress.size, asked.kinds.size))
    is_finite = _compiled.respond(
        law.numbers, law.bend, law.weights, RATES, steps.durations, steps.moments, compressions,
        surface, asked.kinds, asked.motions, asked.surfaces, asked.weight_of, asked.weights,
        steps.first, steps.last, state.values, state.is_begun, stress, jacobian, elastic, slope,
    )  # fmt: skip
    if not is_finite:
        raise FloatingPointError("the response of the law is not finite")
    state.is_begun |= compressions.size > 0
    return Evaluation(stress, jacobian, elastic, slope, state)


def clock(loaded: Array, seconds: Array, floor: float, state: Array) -> Array:
    """Return how far loading and its age go on a logarithmic scale in each block, (blocks,).

    The age is the mean time since the loading was built up.

    Parameters
    ----------
    loaded : ndarray, shape (blocks,)
        Elastic response of each block, positive.
    seconds : ndarray, shape (blocks,)
        Time since the block before [s].
    floor : float
        Age that counts as none [s].
    state : ndarray, shape (2,)
        Elastic response and age before the first block; brought to the last.
    """
    result = np.empty(loaded.size)
    _compiled.clock(loaded, seconds, floor, state, result)
    return result


#: The error processes of a record: :func:`fden_ros.core.estimation.error_model.ErrorModel.errors`.
errors = _compiled.errors


def whiten(rows: Array, errors: Array, roughness: float, motion: float, state: WalkState) -> float:
    """Whiten rows in place by a Kalman filter; return the logarithm of the determinant.

    Each column of `rows` is a series of measurements of two random walks, of the stress with gain
    1 and of the surface with a gain of its own; what is left is its innovations over their
    deviations.

    Parameters
    ----------
    rows : ndarray, shape (blocks, columns)
    errors : ndarray, shape (5, blocks)
        Variances of the measurements; gains of the surface; what the stress's walk gains in
        variance before each block, as it grows with the square of `roughness` and without that;
        and what the surface's gains, as it grows with the square of `motion`.
    state : WalkState
        Before the first block; brought to the last.
    """
    result: float = _compiled.whiten(
        errors, roughness, motion, state.covariance, rows, state.means
    )
    return result


def equations(
    rows: Array, errors: Array, roughness: float, motion: float, state: WalkState
) -> tuple[Array, float]:
    """Whiten rows as :func:`whiten`; return their products R^T R, and the same logarithm."""
    products = np.empty((rows.shape[1], rows.shape[1]))
    found: float = _compiled.equations(
        errors, roughness, motion, state.covariance, rows, state.means, products
    )
    return products, found


class Followed(NamedTuple):
    """Blocks of stress that are linear about a state, (blocks,) and (blocks, n)."""

    observed: Array  #: [Pa]
    predicted: Array  #: at the state [Pa]
    about: Array  #: the state, (n,)
    free: Array  #: 0 of what is known, else 1, (n,)
    jacobian: Array


def follow(
    blocks: Followed,
    errors: Array,
    roughness: float,
    motion: float,
    mean: Array,
    covariance: Array,
) -> tuple[float, float, float, float]:
    """Bring mean and covariance, of the unknowns and two walks, through blocks, in place.

    An extended Kalman filter: see :mod:`fden_ros.core.estimation.filter`. Each block has 1 as its
    derivative by the stress's walk, and the gain by the surface's; `errors` says what they gain.

    Parameters
    ----------
    errors, roughness, motion
        As :func:`whiten` takes them.
    mean : ndarray, shape (n + 2,)
        x.
    covariance : ndarray, shape (n + 2, n + 2)
        P.

    Returns
    -------
    prediction, innovation, variance : float
        h, y and S of the last block.
    log_likelihood : float
        Of all.

    Raises
    ------
    FloatingPointError
        If a prediction is not finite.
    """
    found = np.empty(4)
    if not _compiled.follow(errors, roughness, motion, *blocks, mean, covariance, found):
        raise FloatingPointError("the prediction of the stress is not finite")
    prediction, innovation, variance, log_likelihood = found.tolist()
    return prediction, innovation, variance, log_likelihood


class Scaled(NamedTuple):
    r"""Normal equations whose prior depends on two scales.

    :math:`A = N + B + K a + C b`, with K in the rows from `kernel` on and C in those from
    `characteristic` on; and the gradient :math:`g = t + (B + K a + C b)\,m`.
    """

    towards: Array  #: t, (n,)
    normal: Array  #: N, (n, n)
    base: Array  #: B, (n, n)
    off: Array  #: m, the prior's mean from where it is linear, (n,)
    kernel: int
    characteristic: int
    held: int  #: unknowns that stay, a bit a place
    kernel_prior: Array | None  #: K
    characteristic_prior: Array | None  #: C


def weigh(scaled: Scaled, places: Array) -> Array:
    r"""Return :math:`(g^T A^{-1} g - m^T (B + K a + C b)\,m - \ln|A|) / 2` at places, (places,).

    Parameters
    ----------
    places : ndarray, shape (places, 2)
        Scales a and b; places of the same a stand together.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix A is not positive definite.
    """
    gains = np.empty(len(places))
    _check(_compiled.weigh(*scaled, places, gains))
    return gains


def mix(scaled: Scaled, places: Array, weights: Array, mean: Array, second: Array) -> None:
    r"""Add to the moments of a mixture of :math:`N(A^{-1} g, A^{-1})` at places.

    Parameters
    ----------
    scaled, places
        As :func:`weigh` takes them.
    weights : ndarray, shape (places,)
    mean, second : ndarray, shape (n,), (n, n)
        First and second moments.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix A is not positive definite.
    """
    _check(_compiled.mix(*scaled, places, weights, mean, second))


def solve(matrix: Array, side: Array) -> Array:
    """Return A^-1 b, (n,), of a symmetric matrix (n, n).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    result = np.empty_like(side)
    _check(_compiled.solve(side, matrix, result))
    return result


def _check(is_positive: bool) -> None:
    if not is_positive:
        raise np.linalg.LinAlgError("a matrix is not positive definite")
