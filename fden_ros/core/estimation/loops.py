# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The inner loops of the posterior, compiled where a compiler was there at the installation.

The law's response to a motion that is linear between points,

.. math::
    f(t) = \int E(t-s)\,d\psi(s), \qquad E(t) = \sum_i w_i e^{-\lambda_i t},

with psi the elastic response in excess of the tissue's free surface. In each step the rate of psi
is a parabola (a cubic through psi at four Gauss-Lobatto places), so each exponential goes on by

.. math::
    q_i \leftarrow e^{-\lambda_i h} q_i + \sum_{k=0}^{2} r_k M_k(\lambda_i h), \qquad
    M_k(y) = \int_{-1}^{1} e^{-y(1-s)/2} P_k(s)\,ds .

The moments M do not depend on the parameters and are computed once. A derivative is the same
recursion on the derivative of psi. `_loops.c` holds these functions; those of
:mod:`fden_ros.core.estimation.loops_in_numpy` are its oracle and stand in for it, some 200 times
slower.
"""

from __future__ import annotations

import ctypes
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops_in_numpy as in_numpy
from fden_ros.core.estimation.loop_arguments import (
    RATES,
    Columns,
    LawState,
    Response,
    ResponseState,
    WalkState,
)


def _library() -> ctypes.CDLL | None:
    """Return the compiled loops, or None where there are none of the present source."""
    source = Path(__file__).with_name("_loops.c")
    for suffix in EXTENSION_SUFFIXES:
        path = source.with_name("_loops" + suffix)
        if not path.exists():
            continue
        # Installed as a whole there is no source; beside an older one arguments may differ.
        if not source.exists() or source.stat().st_mtime <= path.stat().st_mtime:
            library = ctypes.CDLL(str(path))
            library.fden_whiten.restype = ctypes.c_double
            return library
    return None


_COMPILED = _library()


def notice() -> str | None:
    """Return a line for the user where the loops are not compiled, else None."""
    if _COMPILED is not None:
        return None
    return (
        "the estimator runs without its compiled part, which is some two hundred times slower: "
        "with a C compiler (build-essential) install fden_ros again"
    )


def moments(durations: Array, rates: Array) -> Array:
    """Return decay and moments of each step, shape (steps, 4, RATES).

    Parameters
    ----------
    durations : ndarray, shape (steps,)
        [s].
    rates : ndarray, shape (RATES,)
        [1/s].
    """
    if _COMPILED is None:
        return in_numpy.moments(durations, rates)
    durations = np.ascontiguousarray(durations)
    result = np.empty((durations.size, 4, RATES))
    _COMPILED.fden_moments(durations.size, _at(durations), _at(rates), _at(result))
    return result


def respond(
    law: LawState,
    rates: Array,
    steps: tuple[Array, Array],
    compressions: Array,
    surface: Array | None,
    columns: Columns,
    state: ResponseState,
) -> Response:
    """Return the stress at every point with its derivatives.

    Parameters
    ----------
    law : LawState
    rates : ndarray, shape (RATES,)
        [1/s].
    steps : tuple of ndarray, shapes (points,) and (points, 4, RATES)
        Durations of the steps that end at the points [s], and their moments.
    compressions : ndarray, shape (points,)
        [1].
    surface : ndarray or None, shape (points,)
        The tissue's free surface, in the unit of the elastic response; None: at 0.
    columns : Columns
    state : ResponseState
        Is brought to the last point.

    Raises
    ------
    FloatingPointError
        If the stress is beyond floating-point numbers.
    """
    if _COMPILED is None:
        return in_numpy.respond(law, rates, steps, compressions, surface, columns, state)
    durations, by_step = steps
    points, count = compressions.size, columns.count
    stress, elastic, slope = np.empty((3, points))
    jacobian = np.empty((points, count))
    failed = _COMPILED.fden_response(
        points, _at(by_step), _at(durations), _at(rates), _at(compressions), _at(surface),
        _at(law.numbers), law.bend.size, _at(law.bend), _at(law.weights), count,
        _at(columns.kinds), columns.motions.shape[0], _at(columns.motions),
        _at(columns.surfaces), _at(columns.weight_of), _at(columns.weights), _at(state.values),
        int(state.is_begun), _at(stress), _at(jacobian), _at(elastic), _at(slope),
    )  # fmt: skip
    if failed:
        raise FloatingPointError("the response of the law is not finite")
    state.is_begun |= points > 0
    return Response(stress, jacobian, elastic, slope)


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
    if _COMPILED is None:
        return in_numpy.clock(loaded, seconds, floor, state)
    result = np.empty(loaded.size)
    _COMPILED.fden_clock(
        loaded.size, _at(loaded), _at(seconds), ctypes.c_double(floor), _at(state), _at(result)
    )
    return result


def whiten(
    rows: Array, noise: Array, gain: Array, walks: tuple[Array, Array], state: WalkState
) -> float:
    """Whiten rows in place by a Kalman filter; return the logarithm of the determinant.

    Each column of `rows` is a series of measurements of two random walks, of the stress with gain
    1 and of the surface with `gain`; what is left is its innovations over their deviations.

    Parameters
    ----------
    rows : ndarray, shape (blocks, columns)
    noise : ndarray, shape (blocks,)
        Variances of the measurements.
    gain : ndarray, shape (blocks,)
    walks : tuple of two ndarray, shape (blocks,)
        Variances that the walks gain before each block.
    state : WalkState
        Before the first block; brought to the last.
    """
    if _COMPILED is None:
        return in_numpy.whiten(rows, noise, gain, walks, state)
    result: float = _COMPILED.fden_whiten(
        *rows.shape, _at(rows), _at(noise), _at(gain), _at(walks[0]), _at(walks[1]),
        _at(state.covariance), _at(state.means),
    )  # fmt: skip
    return result


def eliminate(systems: Array) -> None:
    """Turn each [A, B] into [U, U^-T B] in place, with A = U^T U by Cholesky.

    Below the diagonal numbers have no meaning.

    Parameters
    ----------
    systems : ndarray, shape (count, n, columns)
        A has shape (n, n) and is symmetric.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix is not positive definite.
    """
    if _COMPILED is None:
        in_numpy.eliminate(systems)
    elif _COMPILED.fden_eliminate(*systems.shape, _at(systems)):
        raise np.linalg.LinAlgError("a matrix is not positive definite")


def _at(array: Array | NDArray[np.int32] | None) -> Any:
    """Return the address of an array's numbers, which lie one behind the other.

    It keeps the array: one that was made for the call alone would else be freed before it.
    """
    if array is None:
        return None
    if not array.flags.c_contiguous or array.dtype.char not in "di":
        raise ValueError("the compiled loops take contiguous arrays of float64 and int32")
    try:
        return ctypes.byref(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        # It is not to be written, or has no numbers.
        address = ctypes.c_void_p(array.__array_interface__["data"][0])
        address.array = array  # type: ignore[attr-defined]
        return address
