# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The motion of the tissue at one site, remembered so that any Gn and alpha can be tried on it."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np

from fden_ros.control.left_out import Hold, Point, Slope
from fden_ros.core.arrays import Array, own_copy
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.interpolation import LogStiffnessGrid
from fden_ros.core.law.kernel import SHORTEST_STEP, order_interpolation, order_nodes
from fden_ros.core.law.stress_response import StressBasis

#: Range of Gn [1] between whose nodes the response is interpolated.
_LOWEST_GN, _HIGHEST_GN = 0.5, 60.0


class TissueMemory:
    """Strain in contact and free relaxation between contacts, in constant memory.

    Parameters
    ----------
    geometry : Geometry
        As the identifier's.

    Attributes
    ----------
    strain : float
        Present strain [1]; 0 in the air.
    """

    def __init__(self, geometry: Geometry) -> None:
        middle = 0.5 * math.log(_LOWEST_GN * _HIGHEST_GN)
        self._geometry = geometry
        self._grid = LogStiffnessGrid(middle, math.log(_HIGHEST_GN) - middle)
        self._basis = StressBasis(geometry, self._grid.nodes)
        self._integral = FractionalIntegral(order_nodes())
        self._in_order = order_interpolation()
        self._hold = Hold()
        self.strain = 0.0

    @property
    def compression(self) -> float:
        """Compression at the present strain [1]."""
        return self._geometry.compression(self.strain)

    def copy(self) -> TissueMemory:
        """Return the memory as it is now."""
        own = copy.copy(self)
        own._basis, own._integral = own_copy(self._basis), own_copy(self._integral)
        own._hold = self._hold.copy()
        return own

    def press(self, step: float, strain: float, stress: float) -> None:
        """Take a sample in contact, `step` seconds after the last: strain [1] and stress [Pa]."""
        self._integral.add(step, stress)
        self._basis.press(step, self._geometry.compression(strain))
        self.strain = strain
        if self._hold.is_due(step, strain):
            law, free = self._basis.held(np.array([SHORTEST_STEP]))
            self._hold.keep(stress, law[0], free[0])

    def is_free(self, step: float, strain: float, estimate: Estimate) -> bool:
        """Whether the tissue would have to pull at the probe `step` seconds from the present."""
        in_order, _ = self._in_order(estimate.fractional_order)
        free = float(in_order @ self._integral.ahead(step))
        return estimate.is_above_surface(strain, free)

    def rest(self, step: float) -> None:
        """Take `step` seconds in the air."""
        free = self._integral.advance(step, 0.0)
        self._basis.rest((step,), free[None])
        self._hold.end()
        self.strain = 0.0

    def held(self, times: Array, logs: Array, order: float) -> Array:
        """Return the law's stress [Pa] while the probe holds still, shape (n,).

        Parameters
        ----------
        times : ndarray, shape (n,)
            Since the last sample [s], at least 10 us.
        logs : ndarray, shape (2,)
            ln G and ln Gn.
        order : float
            alpha [1].
        """
        law, free = self._basis.held(np.maximum(times, SHORTEST_STEP))
        return self._stress(law, free, logs, order)

    def slope(self, age: float) -> Slope | None:
        """Return how the slope of what the law leaves out follows from the present hold.

        Parameters
        ----------
        age : float
            Of the loading [s].

        Returns
        -------
        Slope or None
            None where there is no hold, or too little of it was seen.
        """
        return self._hold.slope(age)

    def left_out(self, points: Sequence[Point], logs: Array, order: float) -> Array:
        """Return the stress less the law's at points of the present hold [Pa], shape (n,).

        Parameters
        ----------
        points : sequence of Point
        logs : ndarray, shape (2,)
            ln G and ln Gn.
        order : float
            alpha [1].
        """
        law, free = np.stack([p.law for p in points]), np.stack([p.free for p in points])
        stresses = np.array([point.stress for point in points])
        return np.asarray(stresses - self._stress(law, free, logs, order))

    def _stress(self, law: Array, free: Array, logs: Array, order: float) -> Array:
        """Return the stress [Pa] (k,) of responses (k, nodes, orders) and (k, orders)."""
        log_gn = min(max(float(logs[1]), self._grid.lowest), self._grid.highest)
        first, in_gn, _ = self._grid.stencil(log_gn)
        in_order, _ = self._in_order(order)
        used = law[:, first : first + in_gn.size]
        stress: Array = math.exp(logs[0]) * np.einsum("kno,n,o->k", used, in_gn, in_order)
        stress += free @ in_order
        return stress
