# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Nonlinearity: creep at several stresses, or their coefficients.

Each creep test gives a pair (fc, xc). At 1 s the exact creep (:mod:`fden_ros.experiments.creep`)
says :math:`\varphi(x_c) = f_c/\Gamma(1+\alpha)`, so the pairs lie on the characteristic phi once
the stress is divided by Gamma(1+alpha). The paper leaves the factor out (eqs. exponentialLinear
to parameter5): its convention gives :math:`G\,\Gamma(1+\alpha)` in place of G, 6 to 7 % less at
alpha 0.13, and the coefficients of log-log lines through curves that are none beyond 1/Gn cost
some percent more. Gn hardly changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import digamma, gamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.core.law import log_phi, log_strain
from fden_ros.errors import InputError
from fden_ros.experiments.columns import csv_files, read_table
from fden_ros.experiments.creep import CreepTest, fit_creep, read_creep_test
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import (
    Solution,
    minimise,
    minimise_logarithms,
    require_positive,
)
from fden_ros.experiments.result import Fit, Parameter, plain, r_squared

#: Stresses of creep, or strains of relaxation, at which there must be tests.
LEAST_LEVELS = 3
#: Gn outside of this is no tissue; the fits stay within.
LOG_RANGE = (math.log(0.3), math.log(100.0))


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of a folder of creep tests, or of a file of stresses and coefficients."""
    if path.is_dir():
        tests = [read_creep_test(p, replace(options, stress=None)) for p in csv_files(path)]
        if len({test.stress for test in tests}) < LEAST_LEVELS:
            raise InputError(
                f"{path} holds creep tests at fewer than 3 stresses; nonlinearity needs 3 or more"
            )
        return fit_creep_series(tests)
    table = read_table(path)
    coefficient = table.positive("strain_coefficient")
    stress = table.positive("stress_pa")
    table.checked_strain(coefficient)
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
    r"""Return G, Gn, Gi and xb from pairs of stress and strain coefficient.

    The stress of a creep test is imposed and the coefficient measured, so the smooth estimator
    fits :math:`\log x_c` over the stress, :math:`x_c = \varphi^{-1}(f_c/\Gamma(1+\alpha))`, by
    least squares: one observation over both branches, where the paper's filter switches. R² is
    that of the stress.

    Parameters
    ----------
    stress : ndarray, shape (n,)
        Constant stresses fc [Pa], positive.
    coefficient : ndarray, shape (n,)
        Strain coefficients xc [s^-alpha], positive: the strain at 1 s.
    fractional_order : float, optional
        alpha [1] of these tests. None takes the paper's convention, without Gamma(1+alpha).
    fractional_order_sd : float
        Its standard deviation.

    Raises
    ------
    InputError
        If there are fewer than 3 pairs of different stress.
    """
    require_positive(stress=stress, strain_coefficient=coefficient)
    order = np.argsort(stress, kind="stable")
    stress, coefficient = stress[order], coefficient[order]
    if np.unique(stress).size < LEAST_LEVELS:
        raise InputError("nonlinearity needs creep tests at 3 different stresses or more")
    factor = 1.0 if fractional_order is None else float(gamma(1.0 + fractional_order))
    static = stress / factor
    solution = fit_pairs(static, coefficient)
    by_order = 0.0 if fractional_order is None else float(digamma(1.0 + fractional_order))
    # ln G carries -ln Gamma(1 + alpha), and with it alpha's own uncertainty.
    solution.covariance[0, 0] += (by_order * fractional_order_sd) ** 2
    parameters = law_parameters(solution, 0)
    if fractional_order is not None:
        parameters["alpha"] = plain(fractional_order, fractional_order_sd)
    log_g, log_g_n = solution.values
    return Fit(
        "nonlinearity",
        parameters,
        r_squared(stress, np.exp(log_phi(coefficient, log_g, log_g_n)) * factor),
        stress.size,
        (*undetermined_stiffening(float(coefficient.max()), log_g_n), *solution.warnings()),
    )


def fit_creep_series(tests: Sequence[CreepTest]) -> Fit:
    r"""Return alpha, G, Gn, Gi and xb from creep curves at several stresses, all at once.

    Exact also where a curve is no power law: least squares of log x over all samples with
    :math:`x = \varphi^{-1}(f_c t^\alpha/\Gamma(1+\alpha))`. Beside it, as
    ``coefficients``, stands what comes of a coefficient for each curve, which is the paper's
    procedure but for the factor Gamma(1+alpha).

    Parameters
    ----------
    tests : sequence of CreepTest
        At 3 different stresses or more.
    """
    stresses = np.array([test.stress for test in tests])
    creeps = [fit_creep(*test) for test in tests]
    coefficients = np.array([creep["x_c"].value for creep in creeps])
    alpha, alpha_sd = creeps[int(np.argmin(stresses))]["alpha"][:2]
    pairs = fit_nonlinearity(stresses, coefficients, alpha, alpha_sd if alpha_sd > 0.0 else 0.0)
    time, strain = (np.concatenate([test[i] for test in tests]) for i in (0, 1))
    stress = np.concatenate([np.full(test.time.size, test.stress) for test in tests])

    def predicted(values: Array) -> Array:
        return _log_creep(time, np.log(stress), values)

    start = np.array([alpha, math.log(pairs["g"].value), math.log(pairs["g_n"].value)])
    low, high = LOG_RANGE
    bounds = np.array([1e-4, -np.inf, low]), np.array([0.999, np.inf, high])
    logs = np.log(strain)
    solution = minimise_logarithms(predicted, logs, start, *bounds)
    return Fit(
        "nonlinearity",
        {"alpha": solution.plain(1.0), **law_parameters(solution, 1)},
        r_squared(logs, predicted(solution.values)),
        time.size,
        (
            *undetermined_stiffening(float(strain.max()), solution.values[2]),
            *solution.warnings(),
        ),
        {"coefficients": pairs.parameters},
    )


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


def _log_creep(time: Array, log_stress: Array | float, values: Array) -> Array:
    """Return ln x of the exact creep at times (n,) for (alpha, ln G, ln Gn)."""
    log_phis = log_stress + values[0] * np.log(time) - gammaln(1.0 + values[0])
    return log_strain(log_phis, values[1], values[2])


def _start(strain: Array, phi_values: Array) -> Array:
    """Return (ln G, ln Gn), shape (2,), roughly: the best of a grid for points of phi (n,)."""
    secants = np.log(phi_values / strain)
    deepest = float(strain.max())
    log_g = np.linspace(secants.min() - 1.0, secants.max(), 40)
    scaled = np.geomspace(1.0, 12.0, 40)
    log_g_n = np.clip(np.log(scaled / deepest), *LOG_RANGE)
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
    """Return a warning if no strain lies beyond 1/Gn, where alone Gn shows."""
    if deepest * math.exp(log_g_n) > 1.0 + 1e-9:
        return ()
    return (
        f"no strain is beyond 1/Gn (the largest is {deepest:.3g}): the data do not determine Gn; "
        "go deeper",
    )
