# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Exact stress of FDEN tissue under a prescribed motion: the truth of tests and synthetic bags.

The model (Kobayashi et al., eqs. 1 and 2 in their symmetric form) is ``f = D^alpha phi(x)`` with

- ``phi(x) = G x`` for ``|x| <= 1/Gn``,
- ``phi(x) = sgn(x) (G/Gn) exp(Gn |x| - 1)`` beyond.

From rest the (Caputo) derivative is ``f(t) = 1/Gamma(c) * int_0^t (t - s)^(c-1) phi'(s) ds`` with
``c = 1 - alpha``. A motion is cut into pieces on which ``phi'(s) = dphi/dx * dx/ds`` is an entire
function of time: at every change of velocity and wherever the strain crosses 0 or ``+-1/Gn``. Then
every piece ``[a, b]`` is integrated to rounding error:

- ``t <= b``: Gauss-Jacobi quadrature with the weight ``(t - s)^(c-1)`` over ``[a, t]``;
- just past ``b``: the same over ``[a, t]`` less that over ``[b, t]``, both with the rate continued
  beyond ``b``;
- farther on, where that difference would cancel: Gauss-Legendre quadrature over ``[a, b]``;
- at a constant rate: the elementary integral, in a form that does not cancel.

Nothing here is shared with :mod:`fden_ros.core`, which approximates the same operator by a
recursion.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gamma, roots_jacobi, roots_legendre

from fden_ros.errors import InputError
from fden_ros.simulation import FdenModel, FloatArray

_JACOBI_NODES = 24
# Gauss-Legendre takes over at 0.15 of the piece's length past its end: the kernel's singularity
# then lies on a Bernstein ellipse of 2.1, so 28 nodes leave 1e-18; one length past the end the
# ellipse is 5.8 and 16 nodes do.
_NEAR = 0.15
_FAR = 1.0
_NEAR_NODES = 28
_FAR_NODES = 16


@dataclass(frozen=True)
class LinearMove:
    """Strain that changes at a constant rate, between given strains at given times."""

    start: float
    stop: float
    start_strain: float
    stop_strain: float

    @property
    def rate(self) -> float:
        """Rate of strain in 1/s."""
        return (self.stop_strain - self.start_strain) / (self.stop - self.start)

    def strain_at(self, times: ArrayLike) -> FloatArray:
        """Return the strain at `times`."""
        return self.start_strain + self.rate * (np.asarray(times, dtype=float) - self.start)

    def strain_rate_at(self, times: ArrayLike) -> FloatArray:
        """Return the rate of strain at `times` in 1/s."""
        return np.full(np.shape(times), self.rate)

    def crossings(self, strain: float) -> list[float]:
        """Return the time at which the move passes `strain`, if it does."""
        low, high = sorted((self.start_strain, self.stop_strain))
        if not low < strain < high:
            return []
        return [self.start + (strain - self.start_strain) / self.rate]

    def turning_points(self) -> list[float]:
        """Return nothing: a linear move is one piece."""
        return []

    def between(self, start: float, stop: float) -> LinearMove:
        """Return the same motion on another stretch of time."""
        first, last = (float(self.strain_at(time)) for time in (start, stop))
        return LinearMove(start, stop, first, last)


@dataclass(frozen=True)
class SineMove:
    """Strain ``mean + amplitude * sin(2 pi frequency (t - origin))`` from `start` to `stop`."""

    start: float
    stop: float
    mean: float
    amplitude: float
    frequency: float
    origin: float

    def strain_at(self, times: ArrayLike) -> FloatArray:
        """Return the strain at `times`."""
        phase = 2.0 * np.pi * self.frequency * (np.asarray(times, dtype=float) - self.origin)
        return self.mean + self.amplitude * np.sin(phase)

    def strain_rate_at(self, times: ArrayLike) -> FloatArray:
        """Return the rate of strain at `times` in 1/s."""
        angular = 2.0 * np.pi * self.frequency
        phase = angular * (np.asarray(times, dtype=float) - self.origin)
        return self.amplitude * angular * np.cos(phase)

    def crossings(self, strain: float) -> list[float]:
        """Return the times at which the sine passes `strain`."""
        sine = (strain - self.mean) / self.amplitude
        if abs(sine) >= 1.0:
            return []
        angle = float(np.arcsin(sine))
        return self._times_of_phases(angle, np.pi - angle)

    def turning_points(self) -> list[float]:
        """Return the times of the extremes."""
        return self._times_of_phases(0.5 * np.pi, 1.5 * np.pi)

    def between(self, start: float, stop: float) -> SineMove:
        """Return the same motion on another stretch of time."""
        return replace(self, start=start, stop=stop)

    def _times_of_phases(self, *phases: float) -> list[float]:
        first, last = ((time - self.origin) * self.frequency for time in (self.start, self.stop))
        cycles = np.arange(np.floor(first) - 1.0, np.ceil(last) + 1.0)
        turns = np.concatenate([cycles + phase / (2.0 * np.pi) for phase in phases])
        inside = turns[(turns > first) & (turns < last)]
        return [float(self.origin + turn / self.frequency) for turn in inside]


#: Strain over one stretch of time, given by one analytic formula.
Move = LinearMove | SineMove


@dataclass(frozen=True)
class Piece:
    """Part of a move on which one branch of phi holds, so that ``phi'(t)`` is analytic."""

    move: Move
    start: float
    stop: float
    branch: int

    def phi_rate(self, times: FloatArray, model: FdenModel) -> FloatArray:
        """Return dphi/dt in Pa·s^(alpha-1) at `times`, continued analytically beyond the piece."""
        slope = model.slope_on_branch(self.move.strain_at(times), self.branch)
        return slope * self.move.strain_rate_at(times)


def pieces_of(move: Move, model: FdenModel) -> Iterator[Piece]:
    """Yield the analytic pieces of a move, in the order of time."""
    levels = (-model.boundary_strain, 0.0, model.boundary_strain)
    inner = sorted(
        [*(t for level in levels for t in move.crossings(level)), *move.turning_points()]
    )
    edges = [move.start, *inner, move.stop]
    for start, stop in itertools.pairwise(edges):
        if stop > start:
            middle = float(move.strain_at(0.5 * (start + stop)))
            yield Piece(move, start, stop, model.branch(middle))


def motion_of(moves: Sequence[Move], times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return strain and its rate at ascending `times` (n,) from the first move on."""
    edges = [0, *np.searchsorted(times, [move.start for move in moves[1:]]), times.size]
    strain, rate = np.empty_like(times), np.empty_like(times)
    for move, first, last in zip(moves, edges, edges[1:], strict=False):
        at = np.minimum(times[first:last], move.stop)
        strain[first:last], rate[first:last] = move.strain_at(at), move.strain_rate_at(at)
    rate[times >= moves[-1].stop] = 0.0
    return strain, rate


def stress_of_moves(moves: Sequence[Move], times: ArrayLike, model: FdenModel) -> FloatArray:
    """Return the stress [Pa] that a motion from rest has caused by `times` [s], of their shape.

    The strain of consecutive `moves` is continuous, and rests after the last. Only the motion
    counts: a first move that starts away from strain 0 is taken as the strain at rest.
    """
    instants = np.asarray(times, dtype=float)
    flat = instants.ravel()
    order = np.argsort(flat, kind="stable")
    ascending = flat[order]
    total = np.zeros_like(ascending)
    for piece in (piece for move in moves for piece in pieces_of(move, model)):
        _add_piece(total, ascending, piece, model)
    stress = np.empty_like(total)
    stress[order] = total / gamma(1.0 - model.fractional_order)
    return stress.reshape(instants.shape)


def stress_of_piecewise_linear_strain(
    knot_times: ArrayLike, knot_strains: ArrayLike, times: ArrayLike, model: FdenModel
) -> FloatArray:
    """Return the exact stress [Pa] at `times` [s] under a piecewise linear strain, from rest.

    Knots have increasing times [s] and strains, shape (n,), the first 0; after the last the strain
    is held.
    """
    return stress_of_moves(moves_of_knots(knot_times, knot_strains), times, model)


def moves_of_knots(knot_times: ArrayLike, knot_strains: ArrayLike) -> list[LinearMove]:
    """Return the linear moves between knots of time (s) and strain, both of shape (n,)."""
    instants, strains = (np.asarray(k, dtype=float) for k in (knot_times, knot_strains))
    if not np.all(np.diff(instants) > 0.0):
        raise InputError("knot times must be finite and strictly increasing")
    knots = list(zip(instants.tolist(), strains.tolist(), strict=True))
    return [LinearMove(t0, t1, x0, x1) for (t0, x0), (t1, x1) in itertools.pairwise(knots)]


def _add_piece(total: FloatArray, ascending: FloatArray, piece: Piece, model: FdenModel) -> None:
    """Add ``int (t - s)^-alpha phi'(s) ds`` over one piece to `total`, at `ascending` times."""
    first = int(np.searchsorted(ascending, piece.start, side="right"))
    times = ascending[first:]
    if times.size == 0:
        return
    if isinstance(piece.move, LinearMove) and (piece.branch == 0 or piece.move.rate == 0.0):
        total[first:] += (
            model.linear_stiffness * piece.move.rate * _constant_rate(times, piece, model)
        )
        return

    def phi_rate(s: FloatArray) -> FloatArray:
        return piece.phi_rate(s, model)

    alpha = model.fractional_order
    length = piece.stop - piece.start
    ends = piece.stop + length * np.array([0.0, _NEAR, _FAR])
    inside, near, far = np.searchsorted(times, ends, side="right")
    part = np.empty_like(times)
    part[:near] = _up_to_now(times[:near], piece.start, phi_rate, alpha)
    part[inside:near] -= _up_to_now(times[inside:near], piece.stop, phi_rate, alpha)
    part[near:far] = _past(times[near:far], piece, phi_rate, alpha, _NEAR_NODES)
    part[far:] = _past(times[far:], piece, phi_rate, alpha, _FAR_NODES)
    total[first:] += part


def _constant_rate(times: FloatArray, piece: Piece, model: FdenModel) -> FloatArray:
    """Return ``int (t - s)^-alpha ds`` over the part of the piece before each time."""
    power = 1.0 - model.fractional_order
    since_start = times - piece.start
    since_stop = times - piece.stop
    result = since_start**power / power
    past = since_stop > 0.0
    after = since_stop[past]
    growth = power * np.log1p((piece.stop - piece.start) / after)
    result[past] = after**power * np.expm1(growth) / power
    return result


def _up_to_now(
    times: FloatArray, start: float, phi_rate: Callable[[FloatArray], FloatArray], alpha: float
) -> FloatArray:
    """Return ``int_start^t (t - s)^-alpha phi'(s) ds`` for each time after `start`."""
    nodes, weights = _jacobi(alpha)
    elapsed = times - start
    values = phi_rate(times[:, None] - elapsed[:, None] * nodes)
    return elapsed ** (1.0 - alpha) * weighted_sums(values, weights)


def _past(
    times: FloatArray,
    piece: Piece,
    phi_rate: Callable[[FloatArray], FloatArray],
    alpha: float,
    count: int,
) -> FloatArray:
    """Return ``int (t - s)^-alpha phi'(s) ds`` over a piece that lies well before each time."""
    unit_nodes, unit_weights = unit_legendre(count)
    length = piece.stop - piece.start
    nodes = piece.start + length * unit_nodes
    kernel = (times[:, None] - nodes) ** -alpha
    return weighted_sums(kernel, length * unit_weights * phi_rate(nodes))


def weighted_sums(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the sum of each row of `values` (n, m) under `weights` (m,)."""
    # Not a BLAS product: its rounding depends on the number of threads, and bags must not.
    return np.einsum("ij,j->i", values, weights)


@lru_cache(maxsize=256)
def _jacobi(alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of ``int_0^1 u^-alpha g(u) du``."""
    nodes, weights = roots_jacobi(_JACOBI_NODES, 0.0, -alpha)
    return 0.5 * (1.0 + nodes), weights * 0.5 ** (1.0 - alpha)


@lru_cache(maxsize=16)
def unit_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature on [0, 1]."""
    nodes, weights = roots_legendre(count)
    return 0.5 * (1.0 + nodes), 0.5 * weights
