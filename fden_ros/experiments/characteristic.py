# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From fits of phi in logarithms to the parameters with their deviations.

Beside :func:`fden_ros.core.law.characteristic.log_phi`: the start of a fit, and what it found.
"""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.experiments.regression import Solution
from fden_ros.experiments.result import Parameter

#: Gn outside of this is no tissue; the fits stay within.
LOG_NONLINEAR_RANGE = (math.log(0.3), math.log(100.0))


def start_from_points(strain: Array, phi_values: Array) -> Array:
    """Return (ln G, ln Gn), shape (2,), roughly: the best of a grid for points of phi (n,)."""
    secants = np.log(phi_values / strain)
    deepest = float(strain.max())
    log_g = np.linspace(secants.min() - 1.0, secants.max(), 40)
    scaled = np.geomspace(1.0, 12.0, 40)
    log_g_n = np.clip(np.log(scaled / deepest), *LOG_NONLINEAR_RANGE)
    shapes = np.array([log_phi(strain, 0.0, n) for n in log_g_n]) - np.log(phi_values)
    misfit = np.sum((log_g[:, None, None] + shapes) ** 2, axis=2)
    best_g, best_n = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
    return np.array([log_g[best_g], log_g_n[best_n]])


def stiffness_parameters(solution: Solution, index: int) -> dict[str, Parameter]:
    """Return g, g_n, g_i and x_b of a solution with ln G, ln Gn at `index` and the next place."""
    before = (0.0,) * index
    log_g, log_g_n = solution.values[index : index + 2]
    return {
        "g": solution.positive(*before, 1.0),
        "g_n": solution.positive(*before, 0.0, 1.0),
        "g_i": solution.positive(*before, 1.0, -1.0, log_value=log_g - log_g_n - 1.0),
        "x_b": solution.positive(*before, 0.0, -1.0),
    }


def undetermined_nonlinearity(deepest: float, log_g_n: float) -> tuple[str, ...]:
    """Return a warning if no strain lies beyond 1/Gn, where alone Gn shows."""
    if deepest * math.exp(log_g_n) > 1.0 + 1e-9:
        return ()
    return (
        f"no strain is beyond 1/Gn (the largest is {deepest:.3g}): the data do not determine Gn; "
        "go deeper",
    )
