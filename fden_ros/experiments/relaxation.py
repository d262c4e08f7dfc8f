# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Relaxation: a constant strain from time 0, the stress over time.

The model :math:`D^\alpha\varphi(x) = f` with a step of the strain to :math:`x_c` gives

.. math:: f = \frac{\varphi(x_c)}{\Gamma(1-\alpha)}\, t^{-\alpha} = f_c\, t^{-\alpha} ,

a straight line in the log-log plane at every strain, also beyond :math:`1/G_n`: strain and time
separate, which they do not in creep. The paper (eqs. AppE1a to AppE2) has
:math:`f_c = G\,\Gamma(1+\alpha) x_c` in the linear range, the factor of creep; the fractional
derivative of a step has :math:`1/\Gamma(1-\alpha)`, 2 % less at alpha 0.13.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import digamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.core.law import log_phi
from fden_ros.errors import InputError
from fden_ros.experiments.columns import Table, csv_files, read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.nonlinearity import (
    LEAST_LEVELS,
    LOG_RANGE,
    fit_pairs,
    law_parameters,
    undetermined_stiffening,
)
from fden_ros.experiments.regression import (
    line_through_logarithms,
    minimise_logarithms,
    require_positive,
)
from fden_ros.experiments.result import Fit, r_squared


class RelaxationTest(NamedTuple):
    """One relaxation test."""

    time: Array  #: since the strain was applied [s], positive, shape (n,)
    stress: Array  #: [Pa], positive, shape (n,); of a strain of 1 where it is a modulus
    strain: float  #: [1], constant, positive
    notes: tuple[str, ...] = ()  #: on the reading of the file


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of one relaxation test, or of a folder of them at several strains."""
    if not path.is_dir():
        test = read_relaxation_test(path, options)
        return fit_relaxation(test.time, test.stress, test.strain, test.notes)
    tests = [read_relaxation_test(file, options, needs_strain=True) for file in csv_files(path)]
    if len({test.strain for test in tests}) < LEAST_LEVELS:
        raise InputError(
            f"{path} holds relaxation tests at fewer than {LEAST_LEVELS} strains; nonlinearity "
            f"needs {LEAST_LEVELS} or more"
        )
    return fit_relaxation_series(tests)


def read_relaxation_test(
    path: Path, options: Options, *, needs_strain: bool = False
) -> RelaxationTest:
    """Read time_s, and stress_pa with the strain or relaxation_modulus_pa, of a relaxation test.

    Rows at and before time 0 are left out, and those before `options.start`.
    """
    table = read_table(path)
    time = table.times()
    is_modulus = "stress_pa" not in table and "relaxation_modulus_pa" in table
    name = "relaxation_modulus_pa" if is_modulus else "stress_pa"
    values = table.column(name)
    strain = _strain(table, options, is_optional=is_modulus and not needs_strain)
    start = max(options.start or 0.0, np.nextafter(0.0, 1.0))
    kept, table = table.since(time, start)
    table.require_rows(2, "a relaxation fit")
    table.require_positive(name, values[kept])
    scale = strain if is_modulus else 1.0
    return RelaxationTest(time[kept], scale * values[kept], strain, table.notes(("time_s", name)))


def _strain(table: Table, options: Options, *, is_optional: bool) -> float:
    """Return the constant strain of a test; 1 for a modulus where none is stated."""
    path = table.path
    if options.strain is not None:
        strain = options.strain
    elif "strain" in table:
        values = table.checked_strain(table.column("strain"))
        strain = table.held("strain", values, "a relaxation test has one strain")
    elif is_optional:
        return 1.0
    else:
        raise InputError(f"{path} does not say the strain; give --strain X or a column strain")
    if not strain > 0.0:
        raise InputError(f"{path}: the strain is {strain:g}; it must be positive")
    return strain


def fit_relaxation(time: Array, stress: Array, strain: float, notes: tuple[str, ...] = ()) -> Fit:
    r"""Return alpha, fc and G from one relaxation test by least squares in the log-log plane.

    :math:`\log f = -\alpha \log t + \log f_c`, then
    :math:`G = f_c\,\Gamma(1-\alpha)/x_c`, with the covariance of (alpha, log fc) carried through
    :math:`d\ln G = d\ln f_c - \psi(1-\alpha)\,d\alpha`. G is the secant stiffness phi(x)/x where
    the strain is beyond 1/Gn. Parameters as in :class:`RelaxationTest`.
    """
    require_positive(time=time, stress=stress, strain=np.array([strain]))
    solution = line_through_logarithms(time, stress)
    slope, log_fc = solution.values
    alpha = -float(slope)
    warnings = [*notes, *solution.warnings()]
    parameters = {"alpha": solution.plain(-1.0, 0.0), "f_c": solution.positive(0.0, 1.0)}
    if 0.0 < alpha < 1.0:
        log_g = float(log_fc + gammaln(1.0 - alpha) - math.log(strain))
        parameters["g"] = solution.positive(digamma(1.0 - alpha), 1.0, log_value=log_g)
    else:
        warnings.append(f"alpha is {alpha:.3f}, outside (0, 1): this is no springpot's relaxation")
    logs = np.log(stress)
    fitted = r_squared(logs, logs - solution.residuals)
    return Fit("relaxation", parameters, fitted, time.size, tuple(warnings))


def fit_relaxation_series(tests: Sequence[RelaxationTest]) -> Fit:
    r"""Return alpha, G, Gn, Gi and xb from relaxations at several strains, all at once.

    Least squares of :math:`\log f = \log\varphi(x_c) - \alpha\log t - \log\Gamma(1-\alpha)` over
    all samples. Beside it, as ``coefficients``, stands what comes of one coefficient fc a curve.

    Parameters
    ----------
    tests : sequence of RelaxationTest
        At 3 different strains or more.
    """
    strains = np.array([test.strain for test in tests])
    singles = [fit_relaxation(*test[:3]) for test in tests]
    alpha = float(np.clip(np.mean([one["alpha"].value for one in singles]), 1e-3, 0.99))
    static = np.array([one["f_c"].value for one in singles]) * math.gamma(1.0 - alpha)
    pairs = fit_pairs(static, strains)
    time, stress = (np.concatenate([test[i] for test in tests]) for i in (0, 1))
    strain = np.concatenate([np.full(test.time.size, test.strain) for test in tests])

    def predicted(values: Array) -> Array:
        order, log_g, log_g_n = values
        logs: Array = log_phi(strain, log_g, log_g_n) - order * np.log(time)
        return logs - gammaln(1.0 - order)

    low, high = LOG_RANGE
    bounds = np.array([1e-4, -np.inf, low]), np.array([0.999, np.inf, high])
    logs = np.log(stress)
    solution = minimise_logarithms(predicted, logs, np.array([alpha, *pairs.values]), *bounds)
    notes = dict.fromkeys(note for test in tests for note in test.notes)
    return Fit(
        "relaxation",
        {"alpha": solution.plain(1.0), **law_parameters(solution, 1)},
        r_squared(logs, predicted(solution.values)),
        time.size,
        (
            *notes,
            *undetermined_stiffening(float(strains.max()), solution.values[2]),
            *solution.warnings(),
        ),
        {"coefficients": law_parameters(pairs, 0)},
    )
