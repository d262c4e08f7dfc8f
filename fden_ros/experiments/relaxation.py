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
from collections.abc import Sequence
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
from fden_ros.experiments.regression import (
    Solution,
    half_variance,
    line_through_logarithms,
    minimise,
    require_positive,
)
from fden_ros.experiments.result import Curve, Fit, Panel, plain, positive, r_squared

_NODES = 24
_LEAST_ORDER, _GREATEST_ORDER = 1e-4, 0.999


class Hold(NamedTuple):
    """One relaxation test."""

    time: Array  #: since the strain began to rise [s], positive and after the ramp, shape (n,)
    stress: Array  #: [Pa], positive, shape (n,)
    strain: float  #: [1], held


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
    time = np.concatenate([hold.time for hold in holds])
    stress = np.concatenate([hold.stress for hold in holds])
    strain, logs = holds[0].strain, np.log(stress)
    line = line_through_logarithms(time, stress)
    alpha, log_fc = -line.values[0], line.values[1]
    if ramp == 0.0:
        solution = line
        by_alpha, by_fc = np.array([-1.0, 0.0]), np.array([0.0, 1.0])
    else:
        start = np.array([alpha, log_fc])
        solution = _minimise_logs(
            lambda v: _linear_hold(time, strain, v[0], v[1], ramp), logs, start
        )
        (alpha, log_fc), (by_alpha, by_fc) = solution.values, np.eye(2)
    spread, dof = solution.deviation_of, solution.dof
    warnings = list(solution.warnings())
    parameters = {
        "alpha": plain(alpha, spread(by_alpha), dof),
        "f_c": positive(log_fc, spread(by_fc), dof),
    }
    if 0.0 < alpha < 1.0:
        log_g = log_fc + float(gammaln(1.0 - alpha)) - math.log(strain)
        by_g = by_fc - float(digamma(1.0 - alpha)) * by_alpha
        parameters["g"] = positive(log_g, spread(by_g), dof)
        predicted = _linear_hold(time, strain, alpha, log_fc, ramp)
    else:
        warnings.append(f"alpha is {alpha:.3f}, outside (0, 1): there is no G; is this a hold?")
        predicted = logs - solution.residuals
    curves = (
        Curve(time, stress, "measured", line=False),
        Curve(time, np.exp(predicted), "model", color=1),
    )
    return Fit(
        "relaxation",
        parameters,
        r_squared(logs, predicted),
        time.size,
        tuple(warnings),
        panels=(
            Panel("Relaxation", "time [s]", "stress [Pa]", curves, x_log=True, y_log=True),
            _residual_panel(time, logs - predicted),
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

    solution = _minimise_logs(predicted, logs, start)
    log_g_n = float(solution.values[2])
    model = predicted(solution.values)
    time = np.concatenate([hold.time for hold in holds])
    curves: list[Curve] = []
    for index, hold in enumerate(holds):
        fitted = np.exp(_log_relaxation(hold, solution.values, ramp))
        curves.append(Curve(hold.time, hold.stress, "" if index else "measured", line=False))
        curves.append(Curve(hold.time, fitted, "" if index else "model", color=1))
    parameters = {
        "alpha": plain(solution.values[0], solution.deviation_of(np.eye(3)[0]), solution.dof),
        **stiffness_parameters(solution, 1),
    }
    return Fit(
        "relaxation",
        parameters,
        r_squared(logs, model),
        time.size,
        (
            *undetermined_nonlinearity(float(strains.max()), log_g_n),
            *solution.warnings(),
        ),
        panels=(
            Panel("Relaxation", "time [s]", "stress [Pa]", curves, x_log=True, y_log=True),
            _residual_panel(time, logs - model),
        ),
    )


def _minimise_logs(predicted, logs: Array, start: Array) -> Solution:  # type: ignore[no-untyped-def]
    """Fit logarithms with alpha first among the parameters and, of three, ln Gn last."""
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[0], high[0] = _LEAST_ORDER, _GREATEST_ORDER
    if start.size == 3:
        low[2], high[2] = LOG_NONLINEAR_RANGE
    begin, shift = np.clip(start, low + 1e-3, high - 1e-3), 0.0
    for _ in range(2):
        solution = minimise(lambda v, s=shift: predicted(v) - logs - s, begin, (low, high))  # type: ignore[misc]
        begin, shift = solution.values, half_variance(solution.residuals, start.size)
    return solution


def _residual_panel(time: Array, residuals: Array) -> Panel:
    curve = Curve(time, 100.0 * np.expm1(residuals), "", line=False)
    zero = Curve(np.array([time.min(), time.max()]), np.zeros(2), "", color=1)
    return Panel("Residual", "time [s]", "measured over model - 1 [%]", (curve, zero), x_log=True)
