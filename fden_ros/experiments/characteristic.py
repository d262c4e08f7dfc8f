# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""From fits of phi in logarithms to the parameters with their deviations.

Beside :func:`fden_ros.core.law.characteristic.log_phi`: the start of a fit, and what it found.
"""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.experiments.regression import Solution
from fden_ros.experiments.result import Parameter, positive

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


def stiffness_parameters(
    solution: Solution, index: int, log_g_gradient: Array | None = None
) -> dict[str, Parameter]:
    """Return g, g_n, g_i and x_b of a solution with ln G, ln Gn at `index` and the next place."""
    log_g, log_g_n = solution.values[index : index + 2]
    unit = np.eye(solution.values.size)
    by_g = unit[index] if log_g_gradient is None else log_g_gradient
    by_g_n = unit[index + 1]
    dof, spread = solution.dof, solution.deviation_of
    return {
        "g": positive(log_g, spread(by_g), dof),
        "g_n": positive(log_g_n, spread(by_g_n), dof),
        "g_i": positive(log_g - log_g_n - 1.0, spread(by_g - by_g_n), dof),
        "x_b": positive(-log_g_n, spread(by_g_n), dof),
    }


def undetermined_nonlinearity(deepest: float, log_g_n: float) -> tuple[str, ...]:
    """Return a warning if no strain lies beyond 1/Gn, where alone Gn shows."""
    if deepest * math.exp(log_g_n) > 1.0 + 1e-9:
        return ()
    return (
        f"no strain is beyond 1/Gn (the largest is {deepest:.3g}): the data do not determine Gn; "
        "go deeper",
    )
