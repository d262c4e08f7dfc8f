# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Liver with a disc that is stiffer through its whole thickness: what planned presses are to find.

A square whose corner is the origin; SI units.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fden_ros.simulation.model import FloatArray

#: The square, G beside the disc, and by which factor it is larger there.
SIDE, LINEAR_STIFFNESS, FACTOR = 0.06, 400.0, 2.5
_CENTRE, _RADIUS = (0.018, 0.040), 0.009
#: Sites along a side; a probe meets the nearest one.
_SITES = 21


def is_stiffer(places: FloatArray) -> FloatArray:
    """Return 1 at those of the places (n, 2) that lie in the disc, otherwise 0, (n,)."""
    return np.asarray(np.linalg.norm(places - _CENTRE, axis=1) < _RADIUS, dtype=float)


def parameters() -> dict[str, Any]:
    """Return the parameters of the node ``tissue_simulator`` for its sites."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, SIDE, _SITES)] * 2))
    factors = FACTOR ** is_stiffer(np.column_stack([x, y]))
    return {
        "sites.x": x.tolist(),
        "sites.y": y.tolist(),
        "sites.linear_stiffness": (LINEAR_STIFFNESS * factors).tolist(),
        "sites.nonlinear_stiffness": [8.4],
        "sites.fractional_order": [0.131],
        "sites.inclusion_stiffness": [0.0],
    }
