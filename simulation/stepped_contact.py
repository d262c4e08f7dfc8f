# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Contacts of a probe whose motion in the tissue is not the planned one, step by step.

The surface moves, the tool yields under the tissue's force, the drive
has play, and each press leaves a dent. The strain of the tissue is

.. math:: x = \mathrm{strain}(u_{tip} - c\\,f - s(t) - p) ,

with the tip behind the play, the compliance c, the surface s and the dent p so far. The force f of
the hereditary law depends on x of the same instant, so each step of
:class:`~fden_ros.simulation.tissue.Tissue` is solved for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fden_ros.simulation import Column, FdenModel, FloatArray, Tissue
from simulation.closed_form import Move
from simulation.disturbance import Disturbances, Phases, with_backlash

if TYPE_CHECKING:
    from simulation.scenario import Geometry

#: Time step [s].
STEP_S = 1e-3
#: A touch shorter than this [s] is no press and leaves no dent.
_SHORTEST_PRESS = 0.1


@dataclass(frozen=True)
class SteppedContact:
    """One stretch of time in which the probe presses, in s, and the largest strain in it."""

    start: float
    stop: float
    largest_strain: float

    def max_strain(self, model: FdenModel) -> float:
        """Return the largest strain of the contact."""
        return self.largest_strain


@dataclass(frozen=True)
class SteppedHistory:
    """The contacts of a disturbed motion with one site of the tissue, in the order of time."""

    #: What :class:`~simulation.contact.ContactHistory` has, too
    contacts: tuple[SteppedContact, ...]
    model: FdenModel  #: The tissue
    #: Of every step, in s, 1 and Pa, shape (n,); the stress is 0 out of contact
    times: FloatArray
    strains: FloatArray
    stresses: FloatArray

    def stress(self, times: ArrayLike) -> FloatArray:
        """Return the stress in Pa at `times`, linear between the steps."""
        stress: FloatArray = np.interp(
            np.asarray(times, dtype=float), self.times, self.stresses, 0.0, 0.0
        )
        return stress


def stepped_contacts_of_moves(
    moves: Sequence[Move],
    model: FdenModel,
    geometry: Geometry,
    disturbances: Disturbances,
    phases: Phases,
    clock: float = 0.0,
) -> SteppedHistory:
    """Follow a disturbed probe over fresh tissue at rest and return the contacts it makes.

    The planned strain of consecutive `moves` is negative above the surface at rest, whose motion
    is at `clock` [s] at time 0. Of the disturbances only those of the motion count.
    """
    start, stop = moves[0].start, moves[-1].stop
    count = max(int(np.ceil((stop - start) / STEP_S - 1e-9)), 1)
    times: FloatArray = start + STEP_S * np.arange(count + 1, dtype=np.float64)
    depths = geometry.depth_of_strain(strain_of_moves(moves, times))
    surface = disturbances.surface(times + clock, phases)
    free = with_backlash(depths, disturbances.backlash_m) - surface
    tissue = Tissue([Column(model)], STEP_S)
    strains, stresses = np.empty_like(times), np.zeros_like(times)
    strains[0] = geometry.strain_of_depth(float(free[0]))
    contacts: list[SteppedContact] = []
    touch, dent = None, 0.0
    for n, depth in enumerate(free[1:].tolist(), start=1):
        strain = _strain_under(tissue, depth - dent, geometry, disturbances.compliance_m_per_n)
        stress = tissue.press(strain)
        strains[n], stresses[n] = strain, stress
        if stress > 0.0 and touch is None:
            touch = n - 1
        if touch is not None and (stress == 0.0 or n == times.size - 1):
            largest = float(strains[touch : n + 1].max())
            contacts.append(SteppedContact(float(times[touch]), float(times[n]), largest))
            if (n - touch) * STEP_S >= _SHORTEST_PRESS:
                dent += disturbances.plastic_set_m
            touch = None
    return SteppedHistory(tuple(contacts), model, times, strains, stresses)


def strain_of_moves(moves: Sequence[Move], times: FloatArray) -> FloatArray:
    """Return the planned strain at ascending `times` (n,), held after the last move."""
    edges = np.searchsorted(times, [move.start for move in moves[1:]])
    strain = np.empty_like(times)
    bounds = [0, *edges.tolist(), times.size]
    for move, first, last in zip(moves, bounds[:-1], bounds[1:], strict=True):
        strain[first:last] = move.strain_at(np.minimum(times[first:last], move.stop))
    return strain


def _strain_under(tissue: Tissue, depth: float, geometry: Geometry, compliance: float) -> float:
    """Return the strain at which the tool, bent by the tissue's force, reaches `depth`."""
    unbent = geometry.strain_of_depth(depth)
    if compliance == 0.0:
        return unbent
    response = tissue.response()
    scale = compliance * geometry.force_per_stress
    if response(unbent) <= 0.0:
        return unbent

    def excess(strain: float) -> float:
        place = float(geometry.depth_of_strain(np.array([strain]))[0])
        return place + scale * response(strain) - depth

    # Without any force the tip would be too high: at the free surface, where the force is 0.
    low = unbent
    while excess(low) > 0.0:
        low -= 0.02
    return float(brentq(excess, low, unbent, xtol=1e-10))
