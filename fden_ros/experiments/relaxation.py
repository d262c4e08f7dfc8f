# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Stress relaxation: a strain that is held, the stress over time.

After a step to xc the model :math:`f = D^\alpha\varphi(x)` is the fractional derivative of a
constant (Riemann-Liouville or, with the step, Caputo),

.. math:: f = \frac{\varphi(x_c)}{\Gamma(1-\alpha)}\, t^{-\alpha} = f_c\, t^{-\alpha} ,

a straight line in the log-log plane. (The paper's Appendix E prints :math:`\Gamma(1+\alpha)` in
place of :math:`1/\Gamma(1-\alpha)`; its G comes out smaller by :math:`\pi\alpha/\sin\pi\alpha`
to one, 1.026 at 0.125.) A strain that rises at constant rate over [0, S] and is held then gives,
for t > S,

.. math:: f = \frac{1}{\Gamma(1-\alpha)} \int_0^S (t-s)^{-\alpha}\, \varphi'(x_c s/S)\,
              \frac{x_c}{S}\, ds ,

which in the linear range is
:math:`\frac{G x_c}{S\,\Gamma(2-\alpha)}\,[t^{1-\alpha} - (t-S)^{1-\alpha}]`. Taking such a hold
for a step biases alpha.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import digamma, gamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.errors import InputError
from fden_ros.experiments.characteristic import (
    LOG_NONLINEAR_RANGE,
    start_from_points,
    stiffness_parameters,
    undetermined_nonlinearity,
)
from fden_ros.experiments.columns import CONSTANT, Table, csv_files, read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import (
    Solution,
    line_through_logarithms,
    minimise_logarithms,
    require_positive,
)
from fden_ros.experiments.result import Curve, Fit, Panel, Parameter, compared, r_squared

_NODES = 24
_LEAST_ORDER, _GREATEST_ORDER = 1e-4, 0.999


class Hold(NamedTuple):
    """One relaxation test."""

    time: Array  #: since the strain began to rise [s], positive and after the ramp, shape (n,)
    stress: Array  #: [Pa], positive, shape (n,)
    strain: float  #: [1], held


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of all holds of a file, or of a folder of files."""
    paths = csv_files(path) if path.is_dir() else [path]
    return fit_relaxation([h for p in paths for h in read_holds(p, options)], options.ramp)


def read_holds(path: Path, options: Options) -> list[Hold]:
    """Read time_s, stress_pa and the strains of a file: a hold for each of them."""
    table = read_table(path)
    if options.strain is not None:
        levels = np.full(len(table.rows), options.strain)
    elif "strain" in table or "angle_rad" in table:
        levels = _strain_levels(table, options)
    else:
        raise InputError(f"{path} does not say the strain; give --strain X or a column strain")
    time, stress = table.times(restart_where=levels), table.stress(options.sample)
    start = options.start
    if options.ramp > 0.0:
        # The first sample must lie after the ramp, where alone the hold's formula holds.
        start = max(start or 0.0, float(np.nextafter(options.ramp, math.inf)))
    kept, table = table.since(time, start)
    table.require_rows(2, "a relaxation fit")
    table.require_positive("time_s", time[kept], "its logarithm is taken (see --from)")
    table.require_positive("stress_pa", stress[kept])
    holds = []
    for level in dict.fromkeys(levels[kept].tolist()):
        some = kept & (levels == level)
        if np.count_nonzero(some) < 2:
            raise InputError(f"{path}: strain {level:g} has a single row; each needs at least 2")
        holds.append(Hold(time[some], stress[some], level))
    return holds


def _strain_levels(table: Table, options: Options) -> Array:
    strain = table.strain(options.sample)
    if np.ptp(strain) <= CONSTANT * abs(float(strain.mean())):
        return np.full(strain.size, float(strain.mean()))
    if np.unique(strain).size > max(strain.size // 2, 1):
        raise InputError(
            f"{table.path}: strain is not held, it goes from {strain.min():g} to "
            f"{strain.max():g}; cut the hold out and give --strain X, or fit the whole as "
            "indentation"
        )
    return strain


def fit_relaxation(holds: Sequence[Hold], ramp: float = 0.0) -> Fit:
    r"""Return alpha, fc and G from one hold; alpha, G and Gn from holds at several strains.

    Least squares of log f. One hold after a step is linear regression:
    :math:`\log f = -\alpha\log t + \log f_c` and :math:`G = f_c\,\Gamma(1-\alpha)/x_c`, its
    deviation by :math:`d\ln G = d\ln f_c - \psi(1-\alpha)\,d\alpha`; this G is the secant
    stiffness phi(x)/x where x is beyond 1/Gn. Several strains are fitted at once, with one alpha.

    Parameters
    ----------
    holds : sequence of Hold
    ramp : float
        Time S [s] in which each strain rose, at constant rate, from time 0; 0 is a step.
    """
    for hold in holds:
        require_positive(time=hold.time, stress=hold.stress, strain=np.array([hold.strain]))
        if hold.time.min() <= ramp:
            raise InputError(
                f"time {hold.time.min():g} s is within the ramp of {ramp:g} s; a hold begins after"
            )
    if len({hold.strain for hold in holds}) == 1:
        return _fit_one_strain(holds, ramp)
    return _fit_strains(holds, ramp)


def log_relaxation(
    time: Array, strain: float, alpha: float, log_g: float, log_g_n: float, ramp: float
) -> Array:
    """Return ln f of a hold after a ramp (or a step, ramp 0) at times (n,) after the ramp."""
    power = 1.0 - alpha
    if ramp == 0.0:
        level = float(log_phi(np.array([strain]), log_g, log_g_n)[0])
        step: Array = level - gammaln(power) - alpha * np.log(time)
        return step
    rate, boundary = strain / ramp, math.exp(-log_g_n)
    bend = min(boundary / rate, ramp)
    linear = _integral_of_kernel(time, bend, power)
    total = linear
    if bend < ramp:
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        # In v = (t - s)^(1 - alpha) the kernel is constant, so the rule does not see its pole.
        first, last = (time - ramp) ** power, (time - bend) ** power
        half = 0.5 * (last - first)[:, None]
        past = (0.5 * (first + last)[:, None] + half * nodes) ** (1.0 / power)
        growth = np.exp(rate * (time[:, None] - past) / boundary - 1.0)
        total = linear + (growth * half) @ weights / power
    result: Array = np.log(total * rate / gamma(power)) + log_g
    return result


def _log_relaxation(hold: Hold, values: Array, ramp: float) -> Array:
    alpha, log_g, log_g_n = values
    return log_relaxation(hold.time, hold.strain, alpha, log_g, log_g_n, ramp)


def _integral_of_kernel(time: Array, stop: float, power: float) -> Array:
    """Return int_0^stop (t - s)^(power - 1) ds without cancellation."""
    with np.errstate(divide="ignore"):
        result: Array = -(time**power) * np.expm1(power * np.log1p(-stop / time)) / power
    return result


def _fit_one_strain(holds: Sequence[Hold], ramp: float) -> Fit:
    time, stress = (np.concatenate([hold[i] for hold in holds]) for i in (0, 1))
    strain, logs = holds[0].strain, np.log(stress)
    solution = line_through_logarithms(time, stress)
    # ln f falls with alpha along a line; of a ramp alpha itself is fitted.
    sign = -1.0
    alpha, log_fc = -solution.values[0], solution.values[1]
    if ramp > 0.0:
        sign, start = 1.0, np.array([alpha, log_fc])
        solution = _minimise(lambda v: _linear_hold(time, strain, v[0], v[1], ramp), logs, start)
        alpha, log_fc = solution.values
    parameters = {"alpha": solution.plain(sign), "f_c": solution.positive(0.0, 1.0)}
    warnings = solution.warnings()
    predicted = logs - solution.residuals
    if 0.0 < alpha < 1.0:
        log_g = log_fc + float(gammaln(1.0 - alpha)) - math.log(strain)
        by_alpha = -sign * float(digamma(1.0 - alpha))
        parameters["g"] = solution.positive(by_alpha, 1.0, log_value=log_g)
        predicted = _linear_hold(time, strain, alpha, log_fc, ramp)
    else:
        problem = f"alpha is {alpha:.3f}, outside (0, 1): there is no G; is this a hold?"
        warnings = (*warnings, problem)
    curves = compared(time, stress, time, np.exp(predicted))
    return _fit(parameters, time, logs, predicted, warnings, curves)


def _fit(
    parameters: dict[str, Parameter],
    time: Array,
    logs: Array,
    predicted: Array,
    warnings: tuple[str, ...],
    curves: Sequence[Curve],
) -> Fit:
    residuals = Curve(time, 100.0 * np.expm1(logs - predicted), "", line=False)
    zero = Curve(np.array([time.min(), time.max()]), np.zeros(2), "", color=1)
    return Fit(
        "relaxation",
        parameters,
        r_squared(logs, predicted),
        time.size,
        warnings,
        panels=(
            Panel("Relaxation", "time [s]", "stress [Pa]", curves, x_log=True, y_log=True),
            Panel(
                "Residual",
                "time [s]",
                "measured over model - 1 [%]",
                (residuals, zero),
                x_log=True,
            ),
        ),
    )


def _linear_hold(time: Array, strain: float, alpha: float, log_fc: float, ramp: float) -> Array:
    # Any Gn keeps to the linear branch as long as the strain is within 1/Gn.
    log_g = log_fc + float(gammaln(1.0 - alpha)) - math.log(strain)
    return log_relaxation(time, strain, alpha, log_g, -math.log(strain), ramp)


def _fit_strains(holds: Sequence[Hold], ramp: float) -> Fit:
    strains = np.array([hold.strain for hold in holds])
    lines = [line_through_logarithms(hold.time, hold.stress).values for hold in holds]
    alpha = float(np.clip(-np.median([line[0] for line in lines]), 0.01, 0.9))
    levels = np.exp([line[1] for line in lines]) * gamma(1.0 - alpha)
    start = np.array([alpha, *start_from_points(strains, levels)])
    logs = np.log(np.concatenate([hold.stress for hold in holds]))

    def predicted(values: Array) -> Array:
        return np.concatenate([_log_relaxation(hold, values, ramp) for hold in holds])

    solution = _minimise(predicted, logs, start)
    curves: list[Curve] = []
    for hold in holds:
        model = np.exp(_log_relaxation(hold, solution.values, ramp))
        pair = compared(hold.time, hold.stress, hold.time, model)
        curves += [replace(curve, label="") for curve in pair] if curves else pair
    return _fit(
        {"alpha": solution.plain(1.0), **stiffness_parameters(solution, 1)},
        np.concatenate([hold.time for hold in holds]),
        logs,
        predicted(solution.values),
        (
            *undetermined_nonlinearity(float(strains.max()), float(solution.values[2])),
            *solution.warnings(),
        ),
        curves,
    )


def _minimise(predicted: Callable[[Array], Array], logs: Array, start: Array) -> Solution:
    """Fit logarithms with alpha first among the parameters and, of three, ln Gn last."""
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[0], high[0] = _LEAST_ORDER, _GREATEST_ORDER
    if start.size == 3:
        low[2], high[2] = LOG_NONLINEAR_RANGE
    return minimise_logarithms(predicted, logs, start, low, high)
