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

"""The paper's study, simulated and evaluated by the paper's own procedures.

64 samples drawn from Table II creep at 11 stresses from 25 to 750 Pa for 180 s, and 11 more are
oscillated from 0.1 to 10 rad/s, all by the model's closed forms. What comes out tells what the
procedures do to data that obey the model exactly, and which claims follow from it. It cannot tell
whether tissue obeys the model: that was the paper's measurement.
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
from fden_ros.core.law.fractional_integral import fractional_stress
from fden_ros.experiments.creep import fit_creep
from fden_ros.experiments.dynamic import fit_complex_modulus
from fden_ros.experiments.nonlinearity import (
    CreepTest,
    fit_creep_series,
    fit_nonlinearity,
)
from fden_ros.experiments.regression import line_through, minimise
from fden_ros.experiments.result import Fit, r_squared
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain

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

    def ratios(self, name: str, way: str) -> Array:
        """Return fitted over true g or g_n, one a sample, by ``appendix_d`` or ``series``."""
        attribute = {"g": "linear_stiffness", "g_n": "nonlinear_stiffness"}[name]
        fits = (
            [fit.beside["appendix_d"] for fit in self.pairs]
            if way == "appendix_d"
            else [fit.parameters for fit in self.series]
        )
        truth = np.array([getattr(tissue, attribute) for tissue in self.tissues])
        return np.array([fit[name].value for fit in fits]) / truth


class Claim(NamedTuple):
    """What the paper says, and what comes of it here."""

    claim: str
    holds: str  #: "yes", "in part" or "no"
    finding: str
    numbers: dict[str, float]


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
    return [FdenModel(*(_truncated_normal(generator, row) for row in rows)) for _ in range(count)]


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


def judge_claims(exact: Study, noisy: Study, seed: int) -> list[Claim]:
    """Return the paper's claims, each with whether it holds on data of its own model."""
    generator = np.random.default_rng(seed)
    average = FdenModel(544.8, 8.547, 0.131)
    return [
        _same_slope(exact, noisy),
        _constant_phase(noisy),
        _log_log_creep(average),
        _joint(average),
        _two_points_in_time(average, generator),
        _two_points_in_strain(average, generator),
        _overlap(average, generator),
        _origin(average, generator),
    ]


def judge_numbers(exact: Study) -> list[Claim]:
    """Return where the paper's numbers or equations cannot be, with the number."""
    average = FdenModel(544.8, 8.547, 0.131)
    return [
        *_impossible_deviations(),
        _two_stiffnesses(),
        _lost_factor(exact),
        _relaxation_factor(),
        _logarithm_inside(average),
        Claim(
            "Appendix C: theta_0 is the zero vector",
            "no",
            "the first prediction is log(G sin(pi alpha/2)) = log 0; the filter starts from the "
            "first pair of moduli instead",
            {},
        ),
        Claim(
            "R was 20 mm, for samples of diameter 20 mm",
            "no",
            "stress goes with R^-3: with the diameter for the radius it is 8 times too small; "
            "strain twice too large",
            {"stress_factor": 8.0, "strain_factor": 2.0},
        ),
    ]


def _same_slope(exact: Study, noisy: Study) -> Claim:
    def differences(study: Study) -> Array:
        slopes = [fit.beside["slopes"] for fit in study.dynamic]
        return np.array([s["storage"].value - s["loss"].value for s in slopes])

    with_noise = differences(noisy)
    worst = float(np.abs(differences(exact)).max())
    return Claim(
        "G' and G'' grow with the same slope",
        "yes",
        f"slopes differ by {worst:.0e} without noise; with noise by {with_noise.mean():+.3f} "
        f"± {with_noise.std(ddof=1):.3f} over {with_noise.size} samples, mean slope "
        f"{np.mean([f['alpha'].value for f in noisy.dynamic]):.3f}",
        {"difference": float(with_noise.mean()), "difference_sd": float(with_noise.std(ddof=1))},
    )


def _constant_phase(noisy: Study) -> Claim:
    drifts, expected = [], []
    for tissue in noisy.dynamic_tissues:
        modulus = tissue.linear_stiffness * (1j * OMEGAS) ** tissue.fractional_order
        drifts.append(line_through(np.log10(OMEGAS), np.angle(modulus)).values[0])
        expected.append(0.5 * math.pi * tissue.fractional_order)
    drift = float(np.max(np.abs(drifts)))
    measured = np.array([0.5 * math.pi * fit["alpha"].value for fit in noisy.dynamic])
    error = measured - np.array(expected)
    return Claim(
        "the phase delay is constant over two decades",
        "yes",
        f"it is pi alpha/2 = {np.mean(expected):.3f} rad and drifts by {drift:.0e} rad a decade; "
        f"from noisy moduli it is found within {error.std(ddof=1):.3f} rad",
        {"drift_rad_per_decade": drift, "phase_sd": float(error.std(ddof=1))},
    )


def _log_log_creep(average: FdenModel) -> Claim:
    quiet = Noise(0.0, 0.0, 0.0)
    generator = np.random.default_rng(0)
    fits = {
        stress: fit_creep(*_creep_test(average, stress, quiet, generator))
        for stress in (25.0, 75.0, 750.0)
    }
    slopes = {stress: fit["alpha"].value for stress, fit in fits.items()}
    worst = min(fit.r_squared for fit in fits.values())
    return Claim(
        "creep is a straight line in the log-log plane, of slope alpha",
        "in part",
        f"exact while strain < 1/Gn; beyond, the slope is alpha/(Gn x): "
        f"{slopes[25.0]:.3f} at 25 Pa, {slopes[75.0]:.3f} at 75 Pa, {slopes[750.0]:.3f} at 750 Pa "
        f"for alpha {average.fractional_order}. The curves look straight all the same (R² at "
        f"least {worst:.3f}), so R² does not show it",
        {f"slope_{stress:.0f}_pa": slope for stress, slope in slopes.items()}
        | {"least_r2": worst},
    )


def _joint(average: FdenModel) -> Claim:
    xb = average.boundary_strain
    low, high = np.nextafter(xb, 0.0), np.nextafter(xb, 1.0)
    value = float(abs(average.phi(high) / average.phi(low) - 1.0))
    slope = float(abs(average.phi_derivative(high) / average.phi_derivative(low) - 1.0))
    # One-sided second differences of a smooth curve on either side.
    step = 1e-4
    bend = float(average.phi(xb + 2 * step) - 2 * average.phi(xb + step) + average.phi(xb))
    jump = bend / step**2 / (average.linear_stiffness * average.nonlinear_stiffness)
    return Claim(
        "the branches join C1 at 1/Gn",
        "yes",
        f"value and slope jump by {value:.0e} and {slope:.0e} (rounding); the second derivative "
        f"jumps from 0 to {jump:.2f} G Gn, so it is C1 and not C2",
        {"value_jump": value, "slope_jump": slope, "curvature_jump_g_gn": jump},
    )


def _two_points_in_time(average: FdenModel, generator: np.random.Generator) -> Claim:
    quiet = _creep_test(average, 10.0, Noise(0.0, 0.0, 0.0), generator)
    two = np.array([9, 99])
    fit = fit_creep(quiet.time[two], quiet.strain[two], 10.0)
    error = max(
        abs(fit["alpha"].value / average.fractional_order - 1.0),
        abs(fit["g"].value / average.linear_stiffness - 1.0),
    )
    spreads = {}
    for name, some in (("two", two), ("all", np.arange(quiet.time.size))):
        found = []
        for _ in range(150):
            strain = quiet.strain * (1.0 + 0.01 * generator.standard_normal(quiet.time.size))
            found.append(fit_creep(quiet.time[some], strain[some], 10.0)["alpha"].value)
        spreads[name] = float(np.std(found))
    return Claim(
        "two points in time suffice",
        "yes",
        f"strains at 10 and 100 s give alpha and G within {error:.0e} without noise; at 1 % of "
        f"noise alpha is ± {spreads['two']:.4f} from two points, ± {spreads['all']:.4f} from "
        f"{quiet.time.size}",
        {"error": error, "alpha_sd_two": spreads["two"], "alpha_sd_all": spreads["all"]},
    )


def _two_points_in_strain(average: FdenModel, generator: np.random.Generator) -> Claim:
    x = np.array([0.08, 0.16, 0.24])
    error = _stiffness_error(x, average.phi(x), average)
    spread = _stiffness_spread(x, average, generator)
    return Claim(
        "two points in each range of strain suffice (the origin counts as one)",
        "yes",
        f"strains 0.08, 0.16, 0.24 give G and Gn within {error:.0e} without noise; at 1 % of "
        f"noise ± {100 * spread[0]:.1f} % and ± {100 * spread[1]:.1f} %",
        {"error": error, "g_sd": spread[0], "g_n_sd": spread[1]},
    )


def _overlap(average: FdenModel, generator: np.random.Generator) -> Claim:
    overlap, full = np.linspace(0.10, 0.15, 11), np.linspace(0.03, 0.35, 11)
    error = _stiffness_error(overlap, average.phi(overlap), average)
    narrow = _stiffness_spread(overlap, average, generator)
    wide = _stiffness_spread(full, average, generator)
    return Claim(
        "data of the overlap (strain 0.10 to 0.15) suffice for G and Gn",
        "in part",
        f"without noise within {error:.0e}; at 1 % of noise in the stress, 11 points, G ± "
        f"{100 * narrow[0]:.1f} % and Gn ± {100 * narrow[1]:.1f} %, against ± "
        f"{100 * wide[0]:.1f} % and ± {100 * wide[1]:.1f} % from strains 0.03 to 0.35: Gn "
        f"is {narrow[1] / wide[1]:.0f} times less certain",
        {
            "error": error,
            "g_sd": narrow[0],
            "g_n_sd": narrow[1],
            "g_sd_full": wide[0],
            "g_n_sd_full": wide[1],
        },
    )


def _origin(average: FdenModel, generator: np.random.Generator) -> Claim:
    shift = 0.02
    beyond = np.linspace(0.15, 0.35, 21)
    other = FdenModel(
        average.linear_stiffness * math.exp(average.nonlinear_stiffness * shift),
        average.nonlinear_stiffness,
        average.fractional_order,
    )
    same = float(np.max(np.abs(other.phi(beyond - shift) / average.phi(beyond) - 1.0)))
    across = np.linspace(0.05, 0.35, 31)
    origins = []
    for _ in range(80):
        f = average.phi(across) * (1.0 + 0.01 * generator.standard_normal(across.size))
        origins.append(_fit_with_origin(across + shift, f)[2])
    sd, bias = float(np.std(origins)), float(np.mean(origins)) - shift
    return Claim(
        "the origin of strain follows from data in the nonlinear range alone",
        "no",
        f"there phi = (G/(Gn e)) exp(Gn (x - o)) holds G exp(-Gn o) only: o = {shift} with G "
        f"{100 * (other.linear_stiffness / average.linear_stiffness - 1.0):.0f} % larger gives "
        f"the same stress within {same:.0e}. The subtangent 1/Gn is the same everywhere, so "
        f"it does not tell where xb lies. Data on both sides of xb do give the origin: "
        f"± {sd:.4f} (bias {bias:+.4f}) at 1 % of noise from 31 strains, 0.05 to 0.35",
        {"difference": same, "origin_sd": sd, "origin_bias": bias},
    )


def _impossible_deviations() -> list[Claim]:
    claims = []
    for name, count, meant in (("R² dynamic", 11, 0.08), ("nonlinearity xb", 64, 0.022)):
        row = PAPER[name]
        least = (row.maximum - row.minimum) / math.sqrt(2.0 * (count - 1))
        greatest = math.sqrt(
            (row.maximum - row.average) * (row.average - row.minimum) * count / (count - 1)
        )
        claims.append(
            Claim(
                f"the standard deviation of {name} is {row.sd:g}",
                "no",
                f"{count} values between {row.minimum:g} and {row.maximum:g} that average "
                f"{row.average:g} have one between {least:.4f} and {greatest:.4f}; a slipped "
                f"decimal ({meant:g}) is likely",
                {"least": least, "greatest": greatest},
            )
        )
    return claims


def _two_stiffnesses() -> Claim:
    ratio = PAPER["nonlinearity G"].average / PAPER["dynamic G"].average
    factor = float(gamma(1.131))
    return Claim(
        "G is 391 by the dynamic test and 545 by the creep tests",
        "no",
        f"in the model both are the same G. The ratio is {ratio:.2f}, and as the creep tests' "
        f"convention gives G Gamma(1+alpha) it is {ratio / factor:.2f} in truth; other samples, "
        "or preloaded tissue at another strain, but not the equations, can explain it",
        {"ratio": ratio, "corrected_ratio": ratio / factor},
    )


def _lost_factor(exact: Study) -> Claim:
    paper_g, paper_g_n = (exact.ratios(name, "appendix_d") - 1.0 for name in ("g", "g_n"))
    joint_g, joint_g_n = (np.abs(exact.ratios(n, "series") - 1.0).max() for n in ("g", "g_n"))
    return Claim(
        "G xc = fc, with xc from the creep fit",
        "no",
        f"the creep fit's xc holds fc/(G Gamma(1+alpha)). Without noise the paper's way reads G "
        f"{100 * paper_g.mean():+.1f} % ({100 * paper_g.min():+.1f} to {100 * paper_g.max():+.1f} "
        f"%) and Gn {100 * paper_g_n.mean():+.1f} %; Gamma(1+alpha) alone is "
        f"{100 * (gamma(1.131) - 1.0):+.1f} %, the rest is the straight line through creep beyond "
        f"1/Gn. All curves at once: G within {joint_g:.0e}, Gn within {joint_g_n:.0e}",
        {
            "g_bias": float(paper_g.mean()),
            "g_n_bias": float(paper_g_n.mean()),
            "g_error_series": float(joint_g),
        },
    )


def _relaxation_factor() -> Claim:
    def ratio(alpha: float) -> float:
        return math.pi * alpha / math.sin(math.pi * alpha)

    return Claim(
        "Appendix E: f = G Gamma(1+alpha) xc t^-alpha",
        "no",
        "it is G xc t^-alpha / Gamma(1-alpha); the printed form is pi alpha/sin(pi alpha) times "
        f"as large: {ratio(0.125):.3f} at 0.125, {ratio(0.3):.3f} at 0.3",
        {"ratio_0.125": ratio(0.125), "ratio_0.3": ratio(0.3)},
    )


def _logarithm_inside(average: FdenModel) -> Claim:
    time = np.linspace(0.0, 5.0, 2001)[1:]
    strain = 0.05 * time
    alpha = average.fractional_order
    stress = stress_of_piecewise_linear_strain([0.0, 5.0], [0.0, 0.25], time, average)
    beyond = strain > average.boundary_strain
    literal = fractional_stress(time, np.log(stress), alpha)
    right = np.log(fractional_stress(np.append(0, time), np.append(0, stress), alpha)[1:])
    slopes = [line_through(strain[beyond], y[beyond]).values[0] for y in (literal, right)]
    return Claim(
        "Appendix F: Gn x + log Gi = D^-alpha log f",
        "no",
        f"on a ramp to 0.25 in 5 s this gives Gn {slopes[0]:.1f} for "
        f"{average.nonlinear_stiffness}; log(D^-alpha f) gives {slopes[1]:.3f}",
        {"g_n_literal": float(slopes[0]), "g_n_right": float(slopes[1])},
    )


def _truncated_normal(generator: np.random.Generator, row: Statistics) -> float:
    while True:
        value = float(generator.normal(row.average, row.sd))
        if row.minimum <= value <= row.maximum:
            return value


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


def _stiffness_error(x: Array, phi: Array, truth: FdenModel) -> float:
    fit = fit_nonlinearity(phi, x)
    return max(
        abs(fit["g"].value / truth.linear_stiffness - 1.0),
        abs(fit["g_n"].value / truth.nonlinear_stiffness - 1.0),
    )


def _stiffness_spread(
    x: Array, truth: FdenModel, generator: np.random.Generator
) -> tuple[float, float]:
    logs = []
    for _ in range(60):
        phi = truth.phi(x) * (1.0 + 0.01 * generator.standard_normal(x.size))
        fit = fit_nonlinearity(phi, x)
        logs.append([math.log(fit["g"].value), math.log(fit["g_n"].value)])
    spread = np.std(logs, axis=0)
    return float(spread[0]), float(spread[1])


def _fit_with_origin(x: Array, f: Array) -> Array:
    """Return (ln G, ln Gn, origin) of points on phi(x - origin)."""

    def residuals(values: Array) -> Array:
        strain = np.maximum(x - values[2], 1e-9)
        return log_phi(strain, values[0], values[1]) - np.log(f)

    start = np.array([math.log(f[0] / x[0]), math.log(8.0), 0.0])
    bounds = (np.array([-np.inf, 0.0, -0.2]), np.array([np.inf, 4.0, float(x[0]) - 1e-6]))
    return minimise(residuals, start, bounds).values
