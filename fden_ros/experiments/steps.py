# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Creep and relaxation: a constant stress or strain from time 0, and the response over time.

In the linear range :math:`D^\alpha(G x) = f` answers a step with a straight line in the log-log
plane (paper, eqs. FC, Creep, CreepLog and xc, where r means alpha),

.. math:: x = \frac{f_c}{G\,\Gamma(1+\alpha)}\, t^\alpha = x_c\, t^\alpha , \qquad
          f = \frac{\varphi(x_c)}{\Gamma(1-\alpha)}\, t^{-\alpha} = f_c\, t^{-\alpha} .

The law of the stress holds at every strain, also beyond :math:`1/G_n`: strain and time separate.
There the exact creep is :math:`x = \varphi^{-1}(f_c t^\alpha/\Gamma(1+\alpha))`, whose log-log
slope is :math:`\alpha/(G_n x)`. The paper (eqs. AppE1a to AppE2) has
:math:`f_c = G\,\Gamma(1+\alpha) x_c` for relaxation, the factor of creep; the fractional
derivative of a step has :math:`1/\Gamma(1-\alpha)`, 2 % less at alpha 0.13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import digamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.core.law import log_phi, log_strain
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
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
from fden_ros.recording.text import looks_like_a_table

#: The paper omits the first second of a creep test: the rheometer still vibrates.
_CREEP_START = 1.0


class Step(NamedTuple):
    """One test."""

    kind: str  #: creep or relaxation
    time: Array  #: since the step [s], positive (n,)
    answer: Array  #: strain [1] of creep, stress [Pa] of relaxation, positive (n,)
    level: float  #: stress [Pa] of creep, strain [1] of relaxation, positive
    notes: tuple[str, ...] = ()  #: on the reading of the file

    @property
    def sign(self) -> float:
        """Sign of the slope."""
        return 1.0 if self.kind == "creep" else -1.0


def fit_of(kind: str, path: Path, options: Options) -> Fit:
    """Return the fit of one test in a file, or of a folder of them at several levels."""
    if not path.is_dir():
        return fit_step(read_step(kind, path, options))
    options = replace(options, stress=None, strain=None)
    files = sorted(filter(looks_like_a_table, path.iterdir()))
    return fit_series([read_step(kind, file, options) for file in files])


def read_step(kind: str, path: Path, options: Options) -> Step:
    """Read time_s, and strain or stress_pa (or relaxation_modulus_pa) with the level of a test.

    Rows at and before time 0 are left out, and those before `options.start`.
    """
    table = read_table(path)
    name, scale = "strain", 1.0
    if kind == "creep":
        level = table.held("stress_pa", options.stress, "--stress PA")
    else:
        is_modulus = "stress_pa" not in table.columns and "relaxation_modulus_pa" in table.columns
        name = "relaxation_modulus_pa" if is_modulus else "stress_pa"
        # The modulus is the stress at a strain of 1.
        own = 1.0 if is_modulus and "strain" not in table.columns else None
        given = own if options.strain is None else options.strain
        level = table.held("strain", given, "--strain X")
        scale = level if is_modulus else 1.0
    default = _CREEP_START if kind == "creep" else 0.0
    start = default if options.start is None else options.start
    table = table.since(max(start, np.nextafter(0.0, 1.0)))
    table.require_rows(2, f"a {kind} fit")
    answer = scale * table.positive(name)
    return Step(kind, table.column("time_s"), answer, level, table.notes)


def fit_step(test: Step) -> Fit:
    r"""Return alpha, the coefficient and G from one test by least squares in the log-log plane.

    :math:`\log y = \pm\alpha \log t + \log c`, with the covariance of (alpha, log c) carried to
    G. G is the secant stiffness phi(x)/x where the strain is beyond 1/Gn.
    """
    answers = "strain" if test.kind == "creep" else "stress"
    require_positive(time=test.time, level=np.array([test.level]), **{answers: test.answer})
    solution = line_through_logarithms(test.time, test.answer)
    alpha = test.sign * float(solution.values[0])
    warnings = [*test.notes, *solution.warnings()]
    parameters = {
        "alpha": solution.plain(test.sign, 0.0),
        "x_c" if test.kind == "creep" else "f_c": solution.positive(0.0, 1.0),
    }
    if 0.0 < alpha < 1.0:
        order = 1.0 + test.sign * alpha
        log_g = -test.sign * (solution.values[1] - np.log(test.level) + gammaln(order))
        parameters["g"] = solution.positive(digamma(order), 1.0, log_value=float(log_g))
    else:
        warnings.append(
            f"alpha is {alpha:.3f}, outside (0, 1): this is not a springpot's {test.kind}"
        )
    logs = np.log(test.answer)
    fitted = r_squared(logs, logs - solution.residuals)
    return Fit(test.kind, parameters, fitted, logs.size, tuple(warnings))


def fit_series(tests: Sequence[Step]) -> Fit:
    r"""Return alpha, G, Gn, Gi and xb from tests at 3 levels or more, all at once.

    Least squares of the logarithms of all samples by the exact answers: also where a curve of
    creep is no power law.
    """
    levels = np.array([test.level for test in tests])
    if np.unique(levels).size < LEAST_LEVELS:
        raise InputError(f"tests at {LEAST_LEVELS} stresses or strains, or more, are needed")
    kind, sign = tests[0].kind, tests[0].sign
    lines = [line_through_logarithms(test.time, test.answer).values for test in tests]
    slopes, coefficients = np.array(lines).T
    # A creep curve is a power law at small stress only.
    alpha = slopes[int(np.argmin(levels))] if kind == "creep" else -float(np.mean(slopes))
    alpha = float(np.clip(alpha, 1e-3, 0.99))
    if kind == "creep":
        pairs = fit_pairs(levels / np.exp(gammaln(1.0 + alpha)), np.exp(coefficients))
    else:
        pairs = fit_pairs(np.exp(coefficients + gammaln(1.0 - alpha)), levels)
    time, answer = (np.concatenate([test[i] for test in tests]) for i in (1, 2))
    level = np.concatenate([np.full(test.time.size, test.level) for test in tests])

    def predicted(values: Array) -> Array:
        order, log_g, log_g_n = values
        growth: Array = sign * order * np.log(time) - gammaln(1.0 + sign * order)
        if kind == "creep":
            return log_strain(np.log(level) + growth, log_g, log_g_n)
        return log_phi(level, log_g, log_g_n) + growth

    low, high = LOG_RANGE
    bounds = np.array([1e-4, -np.inf, low]), np.array([0.999, np.inf, high])
    logs = np.log(answer)
    solution = minimise_logarithms(predicted, logs, np.array([alpha, *pairs.values]), *bounds)
    deepest = float((answer if kind == "creep" else levels).max())
    return Fit(
        "nonlinearity" if kind == "creep" else kind,
        {"alpha": solution.plain(1.0), **law_parameters(solution, 1)},
        r_squared(logs, predicted(solution.values)),
        time.size,
        (
            *dict.fromkeys(note for test in tests for note in test.notes),
            *undetermined_stiffening(deepest, solution.values[2]),
            *solution.warnings(),
        ),
    )
