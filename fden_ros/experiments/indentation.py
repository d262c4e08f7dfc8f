# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Indentation: any motion of the probe from rest, its strain and stress over time.

The paper (Appendix F) integrates the stress, :math:`f' = D^{-\alpha} f`, which turns the test into
a static one, :math:`f' = \varphi(x)`, and identifies (G, Gn) as in the nonlinearity measurement.
(It prints :math:`D^{-\alpha}\log f` for :math:`\log(D^{-\alpha} f)`; literally, Gn comes out 13.3
for 8.55.) The integral colours the noise and needs alpha. So the fit here is on the stress itself,

.. math:: f(t_k) = \frac{1}{\Gamma(1-\alpha)} \int_0^{t_k} (t_k - s)^{-\alpha}\,
                   \frac{d}{ds}\varphi(x(s))\, ds + \text{noise} ,

and the paper's procedure stands beside it, as ``appendix_f``. phi is taken linear between closely
spaced times, and the integral over each stretch is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve
from scipy.special import gamma

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.core.law.fractional_integral import fractional_stress
from fden_ros.errors import InputError
from fden_ros.experiments.characteristic import (
    LOG_NONLINEAR_RANGE,
    stiffness_parameters,
    undetermined_nonlinearity,
)
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.nonlinearity import appendix_d
from fden_ros.experiments.regression import Solution, minimise
from fden_ros.experiments.result import Curve, Fit, Panel, Parameter, compared, plain, r_squared

#: Change of strain within which phi is taken linear: an error of 2e-8 at Gn 10.
_STRAIN_STEP = 5e-5
#: Beyond this number of pairs of sample and stretch even jittered samples go by a uniform grid.
_MOST_PAIRS = 3_000_000
_MOST_GRID = 1 << 20
#: Steps that differ by less than this part are equal.
_EVEN = 1e-6
_ORDER_RANGE = (1e-3, 0.95)
_WEAK_ORDER_SD = 0.05
#: Gn from which a fit starts, the best of each pair.
_START_NONLINEARITIES = ((1.5, 3.0), (5.0, 8.0), (12.0, 20.0))
#: Appendix F takes 60 samples, at strains from a fifth of the largest on.
_STATIC_FROM = 0.2
_STATIC_PAIRS = 60


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of a file of strain and stress over time."""
    table = read_table(path)
    time, strain = table.times(), table.strain(options.sample)
    stress = table.stress(options.sample)
    table.require_rows(6, "an indentation fit")
    return fit_indentation(time, strain, stress, options.alpha, options.alpha_sd)


def fit_indentation(
    time: Array,
    strain: Array,
    stress: Array,
    fractional_order: float | None = None,
    fractional_order_sd: float = 0.0,
) -> Fit:
    r"""Return alpha, G, Gn, Gi and xb from one indentation that starts at rest.

    A ramp at constant rate hardly shows alpha; a hold, a change of rate or an oscillation does.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s], increasing. The motion begins at the first sample; if that has a strain already, at
        time 0.
    strain, stress : ndarray, shape (n,)
        [1] and [Pa], while the probe presses.
    fractional_order : float, optional
        alpha [1] from elsewhere; None learns it from these data.
    fractional_order_sd : float
        Its deviation: with 0, alpha is exact; else it is prior knowledge that data may change.

    Raises
    ------
    InputError
        If the first sample is not at rest, or nothing is pressed.
    """
    history = StrainHistory.of(time, strain)
    observed = stress[history.kept]
    if not (np.max(strain) > 0.0 and np.max(stress) > 0.0):
        raise InputError("strain and stress never become positive; pressing must be positive")
    fixed = fractional_order is not None and fractional_order_sd == 0.0
    given = 0.15 if fractional_order is None else fractional_order
    scale = float(np.max(np.abs(observed)))

    def residuals(values: Array) -> Array:
        alpha = given if fixed else float(values[0])
        rows = (history.stress(alpha, *values[-2:]) - observed) / scale
        if fixed or fractional_order is None:
            return rows
        return np.append(rows, (alpha - given) / fractional_order_sd)

    orders = (given,) if fractional_order is not None else (0.1, 0.3)
    starts = _starts(history, observed, orders)
    low = np.array([_ORDER_RANGE[0], -np.inf, LOG_NONLINEAR_RANGE[0]])
    high = np.array([_ORDER_RANGE[1], np.inf, LOG_NONLINEAR_RANGE[1]])
    free = slice(1, None) if fixed else slice(None)
    prior_rows = 0 if fixed or fractional_order is None else 1
    bounds = (low[free], high[free])
    solutions: list[Solution] = []
    for start in starts:
        solutions.append(minimise(residuals, start[free], bounds, prior_rows))
        if solutions[-1].values[-1] > -math.log(float(strain.max())):
            break
    solution = min(solutions, key=lambda found: float(found.residuals @ found.residuals))
    values = solution.values
    alpha = given if fixed else float(values[0])
    alpha_sd = 0.0 if fixed else solution.deviation(np.eye(3)[0])
    predicted = history.stress(alpha, *values[-2:])
    warnings = [*undetermined_nonlinearity(float(strain.max()), float(values[-1]))]
    if fractional_order is None and not alpha_sd <= _WEAK_ORDER_SD:
        warnings.append(
            f"this motion hardly determines alpha ({alpha:.2f}, deviation {alpha_sd:.2g}): give "
            "--alpha, or press and hold"
        )
    parameters = {
        "alpha": plain(alpha, alpha_sd, solution.dof),
        **stiffness_parameters(solution, values.size - 2),
    }
    return Fit(
        "indentation",
        parameters,
        r_squared(observed, predicted),
        observed.size,
        (*warnings, *solution.warnings()),
        {"appendix_f": _appendix_f(time, strain, stress, alpha)},
        _panels(history, observed, predicted, alpha, values),
    )


@dataclass
class StrainHistory:
    """A sampled strain from rest, cut finely, and the stress it causes.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times of the samples since the motion began [s].
    strains : ndarray, shape (n,)
    kept : slice
        Which of the file's samples these are.
    knots, knot_strains : ndarray, shape (m,)
        The motion, cut so that phi is nearly linear between knots.
    """

    times: Array
    strains: Array
    kept: slice
    knots: Array
    knot_strains: Array
    uniform: bool
    _kernel: tuple[float, Array] | None = field(default=None, repr=False)

    @classmethod
    def of(cls, time: Array, strain: Array) -> StrainHistory:
        """Return the history of samples, both of shape (n,)."""
        reach = float(np.max(np.abs(strain)))
        if abs(strain[0]) <= 0.01 * reach:
            origin, first = time[0], 1
        elif time[0] > 0.0:
            origin, first = 0.0, 0
        else:
            raise InputError(
                f"the first row has strain {strain[0]:g}; begin the file before the touch, at "
                "strain 0"
            )
        kept = slice(first, None)
        times, strains = time[kept] - origin, strain[kept]
        knots, values = np.append(0.0, times), np.append(strain[0] if first else 0.0, strains)
        cuts = np.maximum(np.ceil(np.abs(np.diff(values)) / _STRAIN_STEP), 1.0).astype(int)
        steps = np.diff(knots)
        step = float(np.median(steps))
        even = bool(np.max(np.abs(steps - step)) <= _EVEN * step)
        if not even and times.size * int(cuts.sum()) <= _MOST_PAIRS:
            stretches = zip(knots[:-1], knots[1:], cuts, strict=True)
            starts = [np.linspace(a, b, count, endpoint=False) for a, b, count in stretches]
            fine = np.append(np.concatenate(starts), knots[-1])
            return cls(times, strains, kept, fine, np.interp(fine, knots, values), False)
        if knots[-1] / step > _MOST_GRID:
            raise InputError(
                f"the file has {knots[-1] / step:.0f} steps of {step:g} s, {_MOST_GRID} at most "
                "can be fitted; thin it or cut it"
            )
        most = max(int(_MOST_GRID * step / knots[-1]), 1)
        count = min(int(cuts.max()), most)
        fine = np.arange(math.ceil(knots[-1] / step * count - 1e-6) + 1) * (step / count)
        return cls(times, strains, kept, fine, np.interp(fine, knots, values), True)

    def stress(self, alpha: float, log_g: float, log_g_n: float) -> Array:
        """Return the stress [Pa] at the samples, shape (n,)."""
        magnitude = np.maximum(np.abs(self.knot_strains), 1e-300)
        exponent = np.minimum(log_phi(magnitude, log_g, log_g_n), 600.0)
        phi = np.sign(self.knot_strains) * np.exp(exponent)
        phi -= phi[0]
        if self._kernel is None or self._kernel[0] != alpha:
            self._kernel = (alpha, self._kernel_of(alpha))
        kernel = self._kernel[1]
        if not self.uniform:
            rates: Array = np.diff(phi) / np.diff(self.knots)
            return np.asarray(kernel @ rates)
        on_grid = fftconvolve(np.diff(phi), kernel)[: phi.size - 1]
        return np.interp(self.times, self.knots[1:], on_grid)

    def _kernel_of(self, alpha: float) -> Array:
        power = 1.0 - alpha
        if self.uniform:
            step = self.knots[1]
            weights = np.diff(np.arange(self.knots.size, dtype=float) ** power)
            return np.asarray(weights * step**-alpha / gamma(1.0 + power))
        past = np.maximum(self.times[:, None] - self.knots, 0.0) ** power
        return np.asarray(-np.diff(past, axis=1) / gamma(1.0 + power))


def _starts(history: StrainHistory, observed: Array, orders: tuple[float, ...]) -> list[Array]:
    """Return (alpha, ln G, ln Gn), the best of a coarse grid in each range of Gn, best first.

    G enters linearly. Several, since the misfit is flat in Gn where no strain lies beyond 1/Gn: a
    fit that ends there may have missed a better minimum.
    """
    cells = [
        min(
            (_cell(history, observed, alpha, math.log(g_n)) for alpha in orders for g_n in some),
            key=lambda cell: cell[0],
        )
        for some in _START_NONLINEARITIES
    ]
    return [start for _, start in sorted(cells, key=lambda cell: cell[0])]


def _cell(
    history: StrainHistory, observed: Array, alpha: float, log_g_n: float
) -> tuple[float, Array]:
    """Return the misfit of the best G, and (alpha, ln G, ln Gn)."""
    shape = history.stress(alpha, 0.0, log_g_n)
    g = max(float(shape @ observed / (shape @ shape)), 1e-9)
    return float(np.sum((g * shape - observed) ** 2)), np.array([alpha, math.log(g), log_g_n])


def _appendix_f(time: Array, strain: Array, stress: Array, alpha: float) -> dict[str, Parameter]:
    """Return G, Gn, Gi, xb by Appendix D on the fractional stress; deviations are not known."""
    static = fractional_stress(time, stress, alpha)
    useful = np.flatnonzero((strain > _STATIC_FROM * strain.max()) & (static > 0.0))
    if useful.size == 0:
        return {}
    # The filter starts from three pairs at either end: they must differ, so no hold.
    levels = np.linspace(_STATIC_FROM, 1.0, _STATIC_PAIRS) * strain.max()
    reached = [useful[np.argmax(strain[useful] >= level)] for level in levels]
    some = np.unique(reached)
    if np.unique(strain[some]).size < 6:
        return {}
    found = appendix_d(strain[some], static[some])
    # The integral has coloured the noise: the filter's own deviations would be too small.
    return {name: Parameter(p.value, *[math.nan] * 3) for name, p in found.items()}


def _panels(
    history: StrainHistory, observed: Array, predicted: Array, alpha: float, values: Array
) -> tuple[Panel, ...]:
    static = fractional_stress(np.append(0.0, history.times), np.append(0.0, observed), alpha)[1:]
    fine = np.linspace(1e-3, 1.0, 200) * history.strains.max()
    model = np.exp(log_phi(fine, *values[-2:]))
    boundary = np.full(2, math.exp(-values[-1]))
    stresses = compared(history.times, observed, history.times, predicted)
    shapes = compared(history.strains, static, fine, model, "φ(x)")
    end = Curve(boundary, np.array([0.0, model[-1]]), "1/Gn", color=2, dashed=True)
    return (
        Panel("Stress", "time [s]", "stress [Pa]", stresses),
        Panel("Characteristic", "strain", "fractional stress f' [Pa s^α]", (*shapes, end)),
    )
