# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Nonlinearity: stresses and strain coefficients of creep tests, or other pairs of phi.

At 1 s the exact creep (:mod:`fden_ros.experiments.steps`) gives
:math:`\varphi(x_c) = f_c/\Gamma(1+\alpha)`, so the pairs lie on the characteristic phi once the
stress is divided by Gamma(1+alpha). The paper leaves the factor out (eqs. exponentialLinear to
parameter5): its convention gives :math:`G\,\Gamma(1+\alpha)` in place of G, 6 to 7 % less at
alpha 0.13. Gn hardly changes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import digamma, gamma

from fden_ros.core.arrays import Array
from fden_ros.core.law import log_phi, log_strain
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import Solution, minimise, require_positive
from fden_ros.experiments.result import Fit, Parameter, plain, r_squared

#: Stresses of creep, or strains of relaxation, at which there must be tests.
LEAST_LEVELS = 3
#: Gn outside of this is no tissue; the fits stay within.
LOG_RANGE = (math.log(0.3), math.log(100.0))


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of a file of stresses and coefficients."""
    table = read_table(path)
    coefficient, stress = table.positive("strain_coefficient"), table.positive("stress_pa")
    table.require_rows(LEAST_LEVELS, "a nonlinearity fit")
    fit = fit_nonlinearity(stress, coefficient, options.alpha, options.alpha_sd)
    if options.alpha is not None:
        return fit
    hint = (
        "without --alpha the paper's convention f_c = phi(x_c) is used: if x_c are the strains of "
        "creep tests at 1 s, this G is G Gamma(1+alpha), some 7 % less than G"
    )
    return replace(fit, warnings=(*fit.warnings, hint))


def fit_nonlinearity(
    stress: Array,
    coefficient: Array,
    fractional_order: float | None = None,
    fractional_order_sd: float = 0.0,
) -> Fit:
    r"""Return G, Gn, Gi and xb from stresses [Pa] and strain coefficients [s^-alpha], (n,) each.

    Least squares fit :math:`\log x_c` over the stress, which is imposed: one observation over both
    branches, where the paper's filter switches. R² is that of the stress. Without a fractional
    order [1] it takes the paper's convention, without Gamma(1+alpha).
    """
    require_positive(stress=stress, strain_coefficient=coefficient)
    order = np.argsort(stress, kind="stable")
    stress, coefficient = stress[order], coefficient[order]
    if np.unique(stress).size < LEAST_LEVELS:
        raise InputError("nonlinearity needs creep tests at 3 different stresses or more")
    alpha = fractional_order or 0.0
    factor = float(gamma(1.0 + alpha))
    solution = fit_pairs(stress / factor, coefficient)
    # ln G carries -ln Gamma(1 + alpha), and with it alpha's own uncertainty.
    solution.covariance[0, 0] += (digamma(1.0 + alpha) * fractional_order_sd) ** 2
    parameters = law_parameters(solution, 0)
    if fractional_order is not None:
        parameters["alpha"] = plain(alpha, fractional_order_sd)
    fitted = r_squared(stress, np.exp(log_phi(coefficient, *solution.values)) * factor)
    shallow = undetermined_stiffening(float(coefficient.max()), solution.values[1])
    warnings = (*shallow, *solution.warnings())
    return Fit("nonlinearity", parameters, fitted, stress.size, warnings)


def fit_pairs(static: Array, coefficient: Array) -> Solution:
    """Return ln G and ln Gn by least squares of ln x, for values of phi [Pa] and strains (n,)."""
    logs, start = np.log(coefficient), _start(coefficient, static)
    low, high = LOG_RANGE
    bounds = (np.array([-np.inf, low]), np.array([np.inf, high]))
    return minimise(
        lambda values: log_strain(np.log(static), *values) - logs,
        np.clip(start, bounds[0] + 1e-3, bounds[1] - 1e-3),
        bounds,
    )


def _start(strain: Array, phi_values: Array) -> Array:
    """Return (ln G, ln Gn), shape (2,), roughly: the best of a grid for points of phi (n,)."""
    secants = np.log(phi_values / strain)
    log_g = np.linspace(secants.min() - 1.0, secants.max(), 40)
    log_g_n = np.clip(np.log(np.geomspace(1.0, 12.0, 40) / strain.max()), *LOG_RANGE)
    shapes = np.array([log_phi(strain, 0.0, n) for n in log_g_n]) - np.log(phi_values)
    misfit = np.sum((log_g[:, None, None] + shapes) ** 2, axis=2)
    best_g, best_n = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
    return np.array([log_g[best_g], log_g_n[best_n]])


def law_parameters(solution: Solution, index: int) -> dict[str, Parameter]:
    """Return g, g_n, g_i and x_b of a solution with ln G, ln Gn at `index` and the next place."""
    before = (0.0,) * index
    log_g, log_g_n = solution.values[index : index + 2]
    return {
        "g": solution.positive(*before, 1.0),
        "g_n": solution.positive(*before, 0.0, 1.0),
        "g_i": solution.positive(*before, 1.0, -1.0, log_value=log_g - log_g_n - 1.0),
        "x_b": solution.positive(*before, 0.0, -1.0),
    }


def undetermined_stiffening(deepest: float, log_g_n: float) -> tuple[str, ...]:
    """Return a warning if no strain exceeds 1/Gn, because only larger strains show Gn."""
    if deepest * math.exp(log_g_n) > 1.0 + 1e-9:
        return ()
    return (
        f"no strain is beyond 1/Gn (the largest is {deepest:.3g}): the data do not determine Gn; "
        "go deeper",
    )
