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
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gamma

from benchmark.harness import Benchmark, Report, Table, at_most, by_case
from fden_ros.core.law.characteristic import log_phi
from fden_ros.experiments.creep import CreepTest, fit_creep
from fden_ros.experiments.dynamic import fit_complex_modulus
from fden_ros.experiments.nonlinearity import fit_creep_series, fit_nonlinearity
from fden_ros.experiments.result import r_squared
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
    found = fit_nonlinearity(STRESSES, coefficients).beside["appendix_d"]
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
            "ratios": Table("Fitted over true", ratios, {"average": (0.9, 1.1)}),
        },
    )


def statistics(values: Sequence[float]) -> Statistics:
    """Return average, maximum, minimum and sample standard deviation."""
    array = np.asarray(values, dtype=float)
    deviation = array.std(ddof=1) if array.size > 1 else np.nan
    return Statistics(*map(float, (array.mean(), array.max(), array.min(), deviation)))


BENCHMARK = Benchmark(run, EPILOG, contacts=(64, 6))
