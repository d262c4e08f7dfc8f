# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A square of tissue with stiffer discs: what the planner's presses are to find."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.simulation.model import FloatArray


@dataclass(frozen=True)
class Phantom:
    """Liver with discs that are stiffer through its whole thickness; SI units.

    Parameters
    ----------
    side
        Of the square, whose corner is the origin, in m.
    discs
        (x, y, radius, factor by which G is larger) of each.
    sites
        Along a side; a probe meets the nearest one.
    linear_stiffness
        G beside the discs in Pa·s^alpha.
    """

    side: float = 0.06
    discs: tuple[tuple[float, float, float, float], ...] = ((0.018, 0.040, 0.009, 2.5),)
    sites: int = 21
    linear_stiffness: float = 400.0

    def is_stiffer(self, places: FloatArray) -> FloatArray:
        """Return 1 at those of the places (n, 2) that lie in a disc, otherwise 0, (n,)."""
        return np.asarray(self._factors(places) > 1.0, dtype=float)

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of the node ``tissue_simulator`` for its sites."""
        axis = np.linspace(0.0, self.side, self.sites)
        places = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        return {
            "sites.x": places[:, 0].tolist(),
            "sites.y": places[:, 1].tolist(),
            "sites.linear_stiffness": (self.linear_stiffness * self._factors(places)).tolist(),
            "sites.nonlinear_stiffness": [8.4],
            "sites.fractional_order": [0.131],
            "sites.inclusion_stiffness": [0.0],
        }

    def _factors(self, places: FloatArray) -> FloatArray:
        factors = np.ones(len(places))
        for x, y, radius, factor in self.discs:
            inside = np.linalg.norm(places - [x, y], axis=1) < radius
            factors = np.where(inside, np.maximum(factors, factor), factors)
        return factors
