# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The paper's study, simulated and evaluated by the paper's own procedures.

Samples drawn from Table II creep at 11 stresses from 25 to 750 Pa for 180 s, and others are
oscillated from 0.1 to 10 rad/s, all by the model's closed forms: *exact* without noise, *noisy*
with so much that R² comes out near Table I. It tells what the procedures do to data that obey the
model. Whether tissue obeys it, only the paper's measurements can tell.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.special import gamma

from benchmark.harness import Benchmark, Report, Table, at_most, by_case
from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.experiments.characteristic import stiffness_parameters
from fden_ros.experiments.creep import CreepTest, fit_creep
from fden_ros.experiments.dynamic import fit_complex_modulus
from fden_ros.experiments.nonlinearity import fit_creep_series
from fden_ros.experiments.regression import Solution, line_through
from fden_ros.experiments.result import Parameter, r_squared
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.scenario import Distribution

EPILOG = """\
examples:
  fden benchmark study                            # 64 samples, as in the paper
  fden benchmark study --contacts 10 --first 100
"""

STRESSES = np.array([25.0, 50, 75, 100, 150, 200, 300, 400, 500, 600, 750])  # [Pa]
_TIMES = np.arange(1.0, 181.0)  # the first second left out [s]
_OMEGAS = np.geomspace(0.1, 10.0, 11)  # [rad/s]
_DRAWS = 31
#: Pairs that Appendix D takes at either end for its start.
_START_PAIRS = 3
_LEAST_NOISE = 1e-7
_PRIOR_SD = 0.2
EXACT, NOISY = "exact", "noisy"


class Statistics(NamedTuple):
    """A row of the paper's tables: average, maximum, minimum, standard deviation."""

    average: float
    maximum: float
    minimum: float
    sd: float

    @property
    def law(self) -> Distribution:
        """Normal, within the extremes."""
        return Distribution(self.average, self.sd, self.minimum, self.maximum, logarithmic=False)


#: Tables I and II as printed.
PAPER = {
    "R² dynamic": Statistics(0.840, 0.902, 0.751, 0.008),
    "R² creep": Statistics(0.997, 1.000, 0.950, 0.0073),
    "R² nonlinearity": Statistics(0.986, 1.000, 0.923, 0.018),
    "dynamic G": Statistics(391.1, 518.2, 248.2, 111.2),
    "dynamic alpha": Statistics(0.131, 0.146, 0.118, 0.011),
    "nonlinearity G": Statistics(544.8, 1294.0, 341.8, 155.3),
    "nonlinearity Gn": Statistics(8.547, 13.18, 5.26, 1.604),
    "nonlinearity xb": Statistics(0.121, 0.190, 0.076, 0.0022),
    "nonlinearity Gi": Statistics(23.90, 39.64, 11.35, 6.206),
}
#: Fitted over true, by the paper's procedure and by all curves at once.
_RATIOS = ("G, Appendix D", "Gn, Appendix D", "G, all curves", "Gn, all curves")


class Noise(NamedTuple):
    """Relative standard deviations."""

    modulus: float  #: of G' and G'', each frequency by itself
    strain: float  #: of each strain of a creep test
    test: float  #: of a whole creep test: the sample does not repeat itself exactly


NOISES = {EXACT: Noise(0.0, 0.0, 0.0), NOISY: Noise(0.09, 0.002, 0.02)}


def run_trial(which: str, number: int) -> Mapping[str, float]:
    """Simulate sample `number` and evaluate it; return its figures by name."""
    noise, generator = NOISES[which], np.random.default_rng([number, _DRAWS])
    tissue, oscillated = (
        FdenModel(*(PAPER[row].law.draw(generator) for row in rows))
        for rows in (
            ("nonlinearity G", "nonlinearity Gn", "dynamic alpha"),
            ("dynamic G", "nonlinearity Gn", "dynamic alpha"),
        )
    )
    modulus = oscillated.linear_stiffness * (1j * _OMEGAS) ** oscillated.fractional_order
    spread = 1.0 + noise.modulus * generator.standard_normal((2, _OMEGAS.size))
    dynamic = fit_complex_modulus(_OMEGAS, modulus.real * spread[0], modulus.imag * spread[1])
    tests = [_creep_test(tissue, stress, noise, generator) for stress in STRESSES.tolist()]
    creep = [fit_creep(*test) for test in tests]
    coefficients = np.array([fit["x_c"].value for fit in creep])
    found = appendix_d(coefficients, STRESSES)
    model = np.exp(log_phi(coefficients, *np.log([found["g"].value, found["g_n"].value])))
    series = fit_creep_series(tests)
    g, g_n = tissue.linear_stiffness, tissue.nonlinear_stiffness
    return {
        "R² dynamic": dynamic.r_squared,
        "R² creep": float(np.mean([fit.r_squared for fit in creep])),
        "R² nonlinearity": r_squared(STRESSES, model),
        "dynamic G": dynamic["g"].value,
        "dynamic alpha": dynamic["alpha"].value,
        "nonlinearity G": found["g"].value,
        "nonlinearity Gn": found["g_n"].value,
        "nonlinearity xb": found["x_b"].value,
        "nonlinearity Gi": found["g_i"].value,
        "G, Appendix D": found["g"].value / g,
        "Gn, Appendix D": found["g_n"].value / g_n,
        "G, all curves": series["g"].value / g,
        "Gn, all curves": series["g_n"].value / g_n,
    }


def appendix_d(coefficient: Array, static_stress: Array) -> dict[str, Parameter]:
    r"""Return G, Gn, Gi, xb by the paper's filter with a switching observation (Appendix D).

    An extended Kalman filter with the constant state (G, Gn) takes the pairs in the order of
    strain. Its observation is :math:`f = G x` while :math:`x < 1/G_n` by the present estimate, and
    :math:`\log f = G_n x + \log(G/(G_n e))` beyond. It starts at what regression lines through
    the three pairs of least and of greatest strain say. The relative noise is taken from the
    residuals of a first run.

    Parameters
    ----------
    coefficient : ndarray, shape (n,)
        Strains x, positive.
    static_stress : ndarray, shape (n,)
        phi at these strains [Pa s^alpha], positive.
    """
    order = np.argsort(coefficient, kind="stable")
    x, f = coefficient[order], static_stress[order]
    low, high = slice(None, _START_PAIRS), slice(-_START_PAIRS, None)
    g = float(x[low] @ f[low] / (x[low] @ x[low]))
    g_n = line_through(x[high], np.log(f[high])).values[0]
    start, noise = np.array([g, max(g_n, 1e-3)]), 0.05
    for _ in range(3):
        state, covariance = _switching_filter(x, f, start, noise)
        if not (state > 0.0).all():
            return dict.fromkeys(("g", "g_n", "g_i", "x_b"), Parameter(*[math.nan] * 4))
        residuals = np.log(f) - log_phi(x, *np.log(state))
        noise = float(np.sqrt(residuals @ residuals / max(x.size - 2, 1))) + _LEAST_NOISE
    relative = covariance / np.outer(state, state)
    found = Solution(np.log(state), relative, float(x.size - 2), residuals, 0.0)
    return stiffness_parameters(found, 0)


def _switching_filter(x: Array, f: Array, start: Array, noise: float) -> tuple[Array, Array]:
    ekf = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    ekf.x = start.copy()
    ekf.P = np.diag((_PRIOR_SD * start) ** 2)
    for strain, stress in zip(x, f, strict=True):
        g, g_n = ekf.x
        if not (g > 0.0 and g_n > 0.0):
            break
        if strain < 1.0 / g_n:
            observed, expected, row = stress, g * strain, [strain, 0.0]
            variance = (noise * stress) ** 2
        else:
            observed, expected = math.log(stress), g_n * strain + math.log(g / (g_n * math.e))
            row, variance = [1.0 / g, strain - 1.0 / g_n], noise**2
        ekf.update(
            np.array([observed]),
            lambda _, row=row: np.array([row]),
            lambda _, expected=expected: np.array([expected]),
            R=np.array([[variance]]),
        )
    return np.array(ekf.x), np.array(ekf.P)


def _creep_test(
    tissue: FdenModel, stress: float, noise: Noise, generator: np.random.Generator
) -> CreepTest:
    alpha = tissue.fractional_order
    strain = tissue.strain_of_phi(stress * _TIMES**alpha / gamma(1.0 + alpha))
    spread = 1.0 + noise.strain * generator.standard_normal(strain.size)
    whole = 1.0 + noise.test * generator.standard_normal()
    return CreepTest(_TIMES, strain * spread * whole, stress)


def run(args: argparse.Namespace) -> Report:
    """Simulate and evaluate."""
    tasks = [(which, number) for which in NOISES for number in args.numbers]
    found = by_case(run_trial, tasks, jobs=args.jobs, what="samples")
    rows: dict[str, dict[str, Any]] = {}
    for name, row in PAPER.items():
        rows[f"{name}, paper"] = row._asdict()
        for which, samples in found.items():
            rows[f"{name}, {which}"] = statistics([one[name] for one in samples])._asdict()
    ratios = {
        f"{name}, {which}": statistics([one[name] for one in samples])._asdict()
        for name in _RATIOS
        for which, samples in found.items()
    }
    off = max(abs(one[name] - 1.0) for one in found[EXACT] for name in _RATIOS[2:])
    return Report(
        [at_most("exact creep, all curves at once: error of G and Gn", off, 1e-3)],
        {
            "tables": Table("Tables I and II", rows),
            "ratios": Table("Fitted over true", ratios),
        },
    )


def statistics(values: Sequence[float]) -> Statistics:
    """Return average, maximum, minimum and sample standard deviation."""
    array = np.asarray(values, dtype=float)
    deviation = array.std(ddof=1) if array.size > 1 else np.nan
    return Statistics(*map(float, (array.mean(), array.max(), array.min(), deviation)))


BENCHMARK = Benchmark(run, EPILOG, contacts=(64, 6))
