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

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops_in_numpy as in_numpy
from fden_ros.core.estimation.loop_arguments import (
    RATES,
    Column,
    LawState,
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
    columns: list[Column],
    state: ResponseState,
) -> tuple[Array, Array]:
    """Return the stress at every point, (points,), and its derivatives, (columns, points).

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
    columns : list of Column
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
    points, count = compressions.size, len(columns)
    motion_of, motions = _stacked([c.motion for c in columns])
    surface_of, surfaces = _stacked([c.surface for c in columns])
    weight_of, weights = _stacked([c.weights for c in columns])
    kinds = np.array([c.kind for c in columns], dtype=np.int32)
    knots = np.array([c.knot for c in columns], dtype=np.int32)
    numbers = np.array(
        [
            law.linear_stiffness,
            law.nonlinear_stiffness,
            law.exponent,
            float(law.is_one_sided),
            law.compliance,
            law.weights[RATES],
            law.weights[RATES + 1],
            law.last_knot,
        ]
    )
    compressions = np.ascontiguousarray(compressions)
    durations, by_step = np.ascontiguousarray(durations), np.ascontiguousarray(by_step)
    bend, own = np.ascontiguousarray(law.bend), np.ascontiguousarray(law.weights)
    stress, jacobian = np.empty(points), np.empty((count, points))
    failed = _COMPILED.fden_response(
        points, _at(by_step), _at(durations), _at(rates), _at(compressions), _at(surface),
        _at(numbers), bend.size, _at(bend), _at(own), count, _at(kinds), _at(knots),
        _at(motion_of), _at(motions), _at(surface_of), _at(surfaces), _at(weight_of),
        _at(weights), _at(state.values), int(state.is_begun), _at(stress), _at(jacobian),
    )  # fmt: skip
    if failed:
        raise FloatingPointError("the response of the law is not finite")
    state.is_begun |= points > 0
    return stress, jacobian


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


def _at(array: Array | NDArray[np.int32] | None) -> ctypes.c_void_p | None:
    """Return the address of an array's numbers, which lie one behind the other."""
    if array is None:
        return None
    if not array.flags.c_contiguous or array.dtype not in (np.float64, np.int32):
        raise ValueError("the compiled loops take contiguous arrays of float64 and int32")
    return ctypes.c_void_p(array.__array_interface__["data"][0])


def _stacked(arrays: list[Array | None]) -> tuple[NDArray[np.int32], Array | None]:
    """Return the place of each array among those that are not None, -1: None; and these."""
    given = [array for array in arrays if array is not None]
    places = np.full(len(arrays), -1, dtype=np.int32)
    places[[k for k, array in enumerate(arrays) if array is not None]] = np.arange(len(given))
    return places, np.ascontiguousarray(given) if given else None
