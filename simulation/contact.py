# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Contact that can push but not pull: when the probe leaves the tissue and meets it again.

Under a prescribed motion the bilateral model predicts tension on release. Real contact is lost
instead, at the time c at which the exact stress would turn negative. Let f be the stress up to
there and 0 after. The free surface then follows

.. math:: \phi_s(t) = D^{-\alpha} f = \frac{1}{\Gamma(\alpha)} \int_0^c (t-s)^{\alpha-1} f(s)\,ds ,

and contact is regained at the first time r at which :math:`\phi(x_{probe}) \ge \phi_s`. From there
:math:`\phi(x_{probe}) = \phi_s + \Delta` with :math:`\Delta = 0` before r. Since :math:`D^\alpha
\phi_s` is 0 after c, the stress is :math:`D^\alpha \Delta`; with :math:`\int_r^t (t-s)^{-\alpha}
(s-\sigma)^{\alpha-2} ds = \frac{1}{(1-\alpha)(t-\sigma)}
\left(\frac{t-r}{r-\sigma}\right)^{1-\alpha}` it becomes

.. math:: f(t) = D_r^\alpha \phi(x_{probe}) + \frac{\sin \pi\alpha}{\pi}
          \int_0^c \frac{f(\sigma)}{t-\sigma} \left(\frac{t-r}{r-\sigma}\right)^{1-\alpha} d\sigma
          .

The first term counts only the motion since r and is the closed form of
:mod:`simulation.closed_form`; the second is the whole memory of the earlier contacts, one
integral over the past stress. That stress has algebraic singularities where the velocity jumps, so
each piece is integrated by Gauss-Legendre quadrature in a variable that is graded towards both of
its ends.

A probe that passes into a stiffer tissue at the time p, where it is so deep, presses on
:math:`\phi = G\,(1 + (\rho - 1)\,H(t - p))\,\phi_1(x)`: the stress of the motion since p,
:math:`\rho - 1` times, and that of a step of :math:`(\rho - 1)\,\phi(x_p)` come on top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import gamma

from fden_ros.simulation import FdenModel, FloatArray
from simulation.closed_form import (
    Move,
    Piece,
    pieces_of,
    stress_of_moves,
    unit_legendre,
    weighted_sums,
)

_MEMORY_NODES = 24
_SCAN_POINTS = 64
_TIMES_AT_ONCE = 1024


@dataclass(frozen=True)
class Memory:
    """The stress of past contacts as the rule ``int f(s) g(s) ds = impulses @ g(times)``."""

    times: FloatArray = field(default_factory=lambda: np.empty(0))
    impulses: FloatArray = field(default_factory=lambda: np.empty(0))

    def free_phi(self, times: FloatArray, model: FdenModel) -> FloatArray:
        """Return phi of the free surface at `times` after the last release, in Pa·s^alpha."""
        alpha = model.fractional_order
        past = times[:, None] - self.times
        return weighted_sums(past ** (alpha - 1.0), self.impulses) / gamma(alpha)

    def stress(self, times: FloatArray, touch: float, model: FdenModel) -> FloatArray:
        """Return what earlier contacts add to the stress at `times` in a contact since `touch`."""
        if self.times.size == 0:
            return np.zeros_like(times)
        alpha = model.fractional_order
        weights = self.impulses * (touch - self.times) ** (alpha - 1.0)
        sums = np.empty_like(times)
        for first in range(0, times.size, _TIMES_AT_ONCE):
            some = slice(first, first + _TIMES_AT_ONCE)
            sums[some] = weighted_sums(1.0 / (times[some, None] - self.times), weights)
        return np.sin(np.pi * alpha) / np.pi * (times - touch) ** (1.0 - alpha) * sums


@dataclass(frozen=True)
class Stiffening:
    """Another tissue below some depth."""

    strain: float  #: Where it begins
    ratio: float  #: Of G to its value above

    def stress(self, moves: Sequence[Move], times: FloatArray, model: FdenModel) -> FloatArray:
        """Return its part of the stress at `times` of a contact's motion."""
        added = np.zeros_like(times)
        met = min((t for move in moves for t in move.crossings(self.strain)), default=np.inf)
        later = times > met
        if later.any():
            since = times[later] - met
            step = model.phi(self.strain) * since**-model.fractional_order
            added[later] = step / gamma(1.0 - model.fractional_order)
            added[later] += stress_of_moves(_after(moves, met), times[later], model)
        return (self.ratio - 1.0) * added


@dataclass(frozen=True)
class Contact:
    """One stretch of time in which the probe presses."""

    #: Times of touch and release in s
    start: float
    stop: float
    moves: tuple[Move, ...]  #: The probe's motion in between
    memory: Memory  #: The stress of the contacts before this one
    stiffening: Stiffening | None = None  #: Below the surface, if any

    def stress(self, times: FloatArray, model: FdenModel) -> FloatArray:
        """Return the stress in Pa at `times` within the contact."""
        stress = stress_of_moves(self.moves, times, model)
        stress += self.memory.stress(times, self.start, model)
        if self.stiffening is not None:
            stress += self.stiffening.stress(self.moves, times, model)
        return stress

    def max_strain(self, model: FdenModel) -> float:
        """Return the largest strain of the contact."""
        pieces = [piece for move in self.moves for piece in pieces_of(move, model)]
        return max(
            float(piece.move.strain_at(time))
            for piece in pieces
            for time in (piece.start, piece.stop)
        )


@dataclass(frozen=True)
class ContactHistory:
    """The contacts of a motion with one site of the tissue, in the order of time."""

    contacts: tuple[Contact, ...]
    model: FdenModel

    def stress(self, times: ArrayLike) -> FloatArray:
        """Return the stress in Pa at `times` (any shape): never negative, 0 out of contact."""
        instants = np.asarray(times, dtype=float)
        stress = np.zeros_like(instants)
        for contact in self.contacts:
            inside = (instants > contact.start) & (instants < contact.stop)
            stress[inside] = contact.stress(instants[inside], self.model)
        return np.maximum(stress, 0.0)


def contacts_of_moves(
    moves: Sequence[Move], model: FdenModel, stiffening: Stiffening | None = None
) -> ContactHistory:
    """Follow a probe over fresh tissue at rest and return the contacts it makes.

    The strain of consecutive `moves` is negative above the undisturbed surface; every contact is
    assumed to begin above the `stiffening`.
    """
    contacts: list[Contact] = []
    memory = Memory()
    rest = list(moves)
    while (touch := _first_touch(rest, memory, model)) is not None:
        contact = _contact_from(_after(rest, touch), memory, model, stiffening)
        contacts.append(contact)
        memory = _extended(memory, contact, model)
        rest = _after(rest, contact.stop)
    return ContactHistory(tuple(contacts), model)


def _first_touch(moves: Sequence[Move], memory: Memory, model: FdenModel) -> float | None:
    """Return when the probe first meets the free surface, or None if it does not."""
    for move in moves:

        def overlap(times: FloatArray, move: Move = move) -> FloatArray:
            return model.phi(move.strain_at(times)) - memory.free_phi(times, model)

        for piece in pieces_of(move, model):
            times = _scan(piece)
            met = overlap(times) > 0.0
            if not met.any():
                continue
            index = int(np.argmax(met))
            low = piece.start if index == 0 else float(times[index - 1])
            return _root(overlap, low, float(times[index]), fallback_low=memory.times.size == 0)
    return None


def _contact_from(
    moves: Sequence[Move], memory: Memory, model: FdenModel, stiffening: Stiffening | None
) -> Contact:
    """Return the contact that begins with the first of `moves`, up to its release."""
    touch = moves[0].start
    for count, move in enumerate(moves, start=1):
        known = Contact(touch, move.stop, tuple(moves[:count]), memory, stiffening)

        def stress(times: FloatArray, known: Contact = known) -> FloatArray:
            return known.stress(times, model)

        for piece in pieces_of(move, model):
            times = _scan(piece)
            pulled = stress(times) < 0.0
            if not pulled.any():
                continue
            index = int(np.argmax(pulled))
            low = piece.start if index == 0 else float(times[index - 1])
            release = _root(stress, low, float(times[index]), fallback_low=False)
            last = move.between(move.start, release)
            return Contact(touch, release, (*moves[: count - 1], last), memory, stiffening)
    return Contact(touch, moves[-1].stop, tuple(moves), memory, stiffening)


def _scan(piece: Piece) -> FloatArray:
    """Return times over a piece, without its start but denser near it: contact may return soon."""
    part = np.arange(1, _SCAN_POINTS + 1) / _SCAN_POINTS
    return piece.start + (piece.stop - piece.start) * part**2


def _root(
    function: Callable[[FloatArray], FloatArray], low: float, high: float, *, fallback_low: bool
) -> float:
    """Return the sign change of `function`; an end of the interval if rounding hides it."""

    def at(time: float) -> float:
        return float(function(np.array([time]))[0])

    if at(low) * at(high) < 0.0:
        return float(brentq(at, low, high, xtol=1e-13))
    return low if fallback_low else high


def _after(moves: Sequence[Move], time: float) -> list[Move]:
    """Return the part of the motion after `time`."""
    later = [move for move in moves if move.stop > time]
    return [move if move.start >= time else move.between(time, move.stop) for move in later]


def _extended(memory: Memory, contact: Contact, model: FdenModel) -> Memory:
    """Return the memory with one more contact in it."""
    nodes, weights = unit_legendre(_MEMORY_NODES)
    graded = nodes**4 * (35.0 - 84.0 * nodes + 70.0 * nodes**2 - 20.0 * nodes**3)
    density = weights * 140.0 * (nodes * (1.0 - nodes)) ** 3
    pieces = [piece for move in contact.moves for piece in pieces_of(move, model)]
    lengths = np.array([piece.stop - piece.start for piece in pieces])
    starts = np.array([piece.start for piece in pieces])
    times = (starts[:, None] + lengths[:, None] * graded).ravel()
    impulses = (lengths[:, None] * density).ravel() * contact.stress(times, model)
    return Memory(
        np.concatenate([memory.times, times]), np.concatenate([memory.impulses, impulses])
    )
