# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The paper's study, simulated and evaluated by the paper's own procedures.

64 samples drawn from Table II creep at 11 stresses from 25 to 750 Pa for 180 s, and 11 more are
oscillated from 0.1 to 10 rad/s, all by the model's closed forms. What comes out tells what the
procedures do to data that obey the model exactly. It cannot tell whether tissue obeys the model:
that was the paper's measurement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import log_phi
from fden_ros.experiments.creep import CreepTest, fit_creep
from fden_ros.experiments.dynamic import fit_complex_modulus
from fden_ros.experiments.nonlinearity import fit_creep_series, fit_nonlinearity
from fden_ros.experiments.result import Fit, r_squared
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.scenario import Distribution

STRESSES = np.array([25.0, 50, 75, 100, 150, 200, 300, 400, 500, 600, 750])  # Pa
CREEP_TIMES = np.arange(1.0, 181.0)  # s, the first second left out
OMEGAS = np.geomspace(0.1, 10.0, 11)  # rad/s
SAMPLES = 64
DYNAMIC_SAMPLES = 11


class Statistics(NamedTuple):
    """A row of the paper's tables: average, maximum, minimum, standard deviation."""

    average: float
    maximum: float
    minimum: float
    sd: float


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
TABLE_1 = ("R² dynamic", "R² creep", "R² nonlinearity")
TABLE_2 = tuple(name for name in PAPER if name not in TABLE_1)


@dataclass(frozen=True)
class Noise:
    """Relative standard deviations; chosen so that R² comes out near Table I."""

    modulus: float = 0.09  #: of G' and G'', each frequency by itself
    strain: float = 0.002  #: of each strain of a creep test
    test: float = 0.02  #: of a whole creep test: the sample does not repeat itself exactly

    def scaled(self, factor: float) -> Noise:
        """Return noise that is `factor` times as strong."""
        return Noise(factor * self.modulus, factor * self.strain, factor * self.test)


@dataclass(frozen=True)
class Study:
    """One run of the study.

    Parameters
    ----------
    tissues, dynamic_tissues : sequence of FdenModel
        The truth.
    dynamic : sequence of Fit
        Appendix C, one a sample.
    creep : sequence of sequence of Fit
        One a sample and stress.
    pairs : sequence of Fit
        Nonlinearity in the paper's convention; Appendix D stands beside.
    series : sequence of Fit
        All curves of a sample at once.
    tests : sequence of sequence of CreepTest
        The simulated creep curves.
    """

    tissues: Sequence[FdenModel]
    dynamic_tissues: Sequence[FdenModel]
    dynamic: Sequence[Fit]
    creep: Sequence[Sequence[Fit]]
    pairs: Sequence[Fit]
    series: Sequence[Fit]
    tests: Sequence[Sequence[CreepTest]]

    def tables(self) -> dict[str, Statistics]:
        """Return the rows of Tables I and II as the paper's procedures give them."""
        appendix = [fit.beside["appendix_d"] for fit in self.pairs]
        values = {
            "R² dynamic": [fit.r_squared for fit in self.dynamic],
            "R² creep": [fit.r_squared for fits in self.creep for fit in fits],
            "R² nonlinearity": [
                _stress_r_squared(fits, found)
                for fits, found in zip(self.creep, appendix, strict=True)
            ],
            "dynamic G": [fit["g"].value for fit in self.dynamic],
            "dynamic alpha": [fit["alpha"].value for fit in self.dynamic],
            **{
                f"nonlinearity {symbol}": [found[name].value for found in appendix]
                for symbol, name in (("G", "g"), ("Gn", "g_n"), ("xb", "x_b"), ("Gi", "g_i"))
            },
        }
        return {name: statistics(v) for name, v in values.items()}

    def ratios(self, name: str, procedure: str) -> Array:
        """Return fitted over true g or g_n, one a sample, by ``appendix_d`` or ``series``."""
        attribute = {"g": "linear_stiffness", "g_n": "nonlinear_stiffness"}[name]
        fits = {
            "appendix_d": [fit.beside["appendix_d"] for fit in self.pairs],
            "series": [fit.parameters for fit in self.series],
        }[procedure]
        truth = np.array([getattr(tissue, attribute) for tissue in self.tissues])
        return np.array([fit[name].value for fit in fits]) / truth


def statistics(values: Sequence[float] | Array) -> Statistics:
    """Return average, maximum, minimum and sample standard deviation."""
    array = np.asarray(values, dtype=float)
    return Statistics(
        float(array.mean()), float(array.max()), float(array.min()), float(array.std(ddof=1))
    )


def draw_tissues(
    generator: np.random.Generator, count: int, stiffness: Statistics
) -> list[FdenModel]:
    """Return tissues drawn from Table II: normal, independent, within the printed extremes."""
    rows = (stiffness, PAPER["nonlinearity Gn"], PAPER["dynamic alpha"])
    laws = [Distribution(r.average, r.sd, r.minimum, r.maximum, logarithmic=False) for r in rows]
    return [FdenModel(*(law.draw(generator) for law in laws)) for _ in range(count)]


def run_study(
    seed: int,
    noise: Noise,
    samples: int = SAMPLES,
    advance: Callable[[], Any] = lambda: None,
) -> Study:
    """Simulate and evaluate; `advance` is called after each sample."""
    generator = np.random.default_rng(seed)
    tissues = draw_tissues(generator, samples, PAPER["nonlinearity G"])
    dynamic_tissues = draw_tissues(generator, DYNAMIC_SAMPLES, PAPER["dynamic G"])
    dynamic = []
    for tissue in dynamic_tissues:
        alpha = tissue.fractional_order
        modulus = tissue.linear_stiffness * (1j * OMEGAS) ** alpha
        spread = 1.0 + noise.modulus * generator.standard_normal((2, OMEGAS.size))
        dynamic.append(
            fit_complex_modulus(OMEGAS, modulus.real * spread[0], modulus.imag * spread[1])
        )
    creep, pairs, series, all_tests = [], [], [], []
    for tissue in tissues:
        tests = [_creep_test(tissue, stress, noise, generator) for stress in STRESSES]
        fits = [fit_creep(*test) for test in tests]
        coefficients = np.array([fit["x_c"].value for fit in fits])
        creep.append(fits)
        pairs.append(fit_nonlinearity(STRESSES, coefficients))
        series.append(fit_creep_series(tests))
        all_tests.append(tests)
        advance()
    return Study(tissues, dynamic_tissues, dynamic, creep, pairs, series, all_tests)


def _creep_test(
    tissue: FdenModel, stress: float, noise: Noise, generator: np.random.Generator
) -> CreepTest:
    alpha = tissue.fractional_order
    strain = tissue.strain_of_phi(stress * CREEP_TIMES**alpha / gamma(1.0 + alpha))
    spread = 1.0 + noise.strain * generator.standard_normal(strain.size)
    return CreepTest(
        CREEP_TIMES, strain * spread * (1.0 + noise.test * generator.standard_normal()), stress
    )


def _stress_r_squared(fits: Sequence[Fit], found: Any) -> float:
    x = np.array([fit["x_c"].value for fit in fits])
    model = np.exp(log_phi(x, math.log(found["g"].value), math.log(found["g_n"].value)))
    return r_squared(STRESSES, model)
