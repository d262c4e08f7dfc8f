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

"""Every experiment gives back the parameters of its own closed form, and honest intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import gamma

from fden_ros.errors import InputError
from fden_ros.experiments.creep import fit_creep
from fden_ros.experiments.dynamic import fit_bode, fit_complex_modulus
from fden_ros.experiments.indentation import fit_indentation
from fden_ros.experiments.nonlinearity import CreepTest, fit_creep_series, fit_nonlinearity
from fden_ros.experiments.relaxation import Hold, fit_relaxation
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain

G, GN, ALPHA = 545.0, 8.55, 0.131
MODEL = FdenModel(G, GN, ALPHA)
TRUTH = {"alpha": ALPHA, "g": G, "g_n": GN, "x_b": 1.0 / GN, "g_i": G / (GN * math.e)}

OMEGAS = np.geomspace(0.1, 10.0, 11)
MODULUS = G * (1j * OMEGAS) ** ALPHA
TIMES = np.geomspace(1.0, 180.0, 60)
STRESSES = np.array([25.0, 50, 75, 100, 150, 200, 300, 400, 500, 600, 750])
HELD = (0.05, 0.1, 0.2, 0.3)
AFTER = np.geomspace(0.05, 100.0, 60)


def creep_strain(stress, times=TIMES):
    return np.asarray(MODEL.strain_of_phi(stress * times**ALPHA / gamma(1.0 + ALPHA)))


def held_stress(strain, ramp=0.0, model=MODEL):
    alpha = model.fractional_order
    if ramp == 0.0:
        return float(model.phi(strain)) * AFTER**-alpha / gamma(1.0 - alpha)
    times = AFTER + ramp
    return stress_of_piecewise_linear_strain([0.0, ramp], [0.0, strain], times, model)


PRESS_TIMES = np.linspace(0.0, 3.0, 91)
PRESS_STRAIN = 0.3 * np.minimum(PRESS_TIMES, 1.0)
PRESS_STRESS = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.3], PRESS_TIMES, MODEL)
RAMP_HELD = [held_stress(x, 1.0) for x in HELD]


def no_noise(values):
    return values


FITS = {
    "dynamic": lambda k: fit_complex_modulus(OMEGAS, k(MODULUS.real), k(MODULUS.imag)),
    "bode": lambda k: fit_bode(OMEGAS, k(1.0 / np.abs(MODULUS)), k(-np.angle(MODULUS))),
    "creep": lambda k: fit_creep(TIMES, k(creep_strain(20.0)), 20.0),
    "coefficients": lambda k: fit_nonlinearity(STRESSES, k(creep_strain(STRESSES, 1.0)), ALPHA),
    "stresses": lambda k: fit_nonlinearity(k(MODEL.phi(np.linspace(0.03, 0.35, 12))),
                                           np.linspace(0.03, 0.35, 12)),
    "series": lambda k: fit_creep_series(
        [CreepTest(TIMES[::3], k(creep_strain(s, TIMES[::3])), s) for s in STRESSES[::2]]
    ),
    "step": lambda k: fit_relaxation([Hold(AFTER, k(held_stress(0.1)), 0.1)]),
    "ramp": lambda k: fit_relaxation([Hold(AFTER + 1.0, k(RAMP_HELD[1]), 0.1)], ramp=1.0),
    "steps": lambda k: fit_relaxation([Hold(AFTER, k(held_stress(x)), x) for x in HELD]),
    "ramps": lambda k: fit_relaxation(
        [Hold(AFTER + 1.0, k(f), x) for x, f in zip(HELD, RAMP_HELD, strict=True)], ramp=1.0
    ),
    "press": lambda k: fit_indentation(PRESS_TIMES, PRESS_STRAIN, k(PRESS_STRESS)),
    "press, alpha given": lambda k: fit_indentation(
        PRESS_TIMES, PRESS_STRAIN, k(PRESS_STRESS), ALPHA
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FITS)
def test_noise_free_data_give_the_parameters_back(name):
    fit = FITS[name](no_noise)
    tolerance = 1e-3 if name == "dynamic" else 1e-6
    found = {key: fit[key].value for key in TRUTH if key in fit.parameters}
    assert found == pytest.approx({key: TRUTH[key] for key in found}, rel=tolerance)
    assert fit.r_squared == pytest.approx(1.0, abs=1e-9)
    assert fit.warnings == ()


REPETITIONS = (
    dict.fromkeys(FITS, 500)
    | dict.fromkeys(["stresses", "coefficients", "ramp", "steps", "series"], 100)
    | dict.fromkeys(["ramps", "press", "press, alpha given"], 40)
)


@pytest.mark.parametrize("name", FITS)
def test_intervals_cover_the_truth_under_five_percent_noise(name):
    hits: dict[str, list[bool]] = {}
    normal: list[bool] = []
    for seed in range(REPETITIONS[name]):
        generator = np.random.default_rng(seed)
        fit = FITS[name](lambda v, r=generator: v * (1.0 + 0.05 * r.standard_normal(v.shape)))
        for key in ("alpha", "g", "g_n"):
            if key in fit.parameters and fit[key].sd > 0.0:
                p = fit[key]
                hits.setdefault(key, []).append(p.low <= TRUTH[key] <= p.high)
                normal.append(abs(p.value - TRUTH[key]) <= 1.96 * p.sd)
    # The bound is for 500 repetitions, which scatter by ±2 %; fewer scatter by more.
    slack = {500: 0.0, 100: 0.03, 40: 0.06}[REPETITIONS[name]]
    for key, covered in hits.items():
        assert 0.90 - slack <= np.mean(covered) <= min(0.99 + slack, 1.0), key
    assert 0.90 - slack <= np.mean(normal) <= min(0.99 + slack, 1.0)


def test_intervals_stay_honest_when_noise_is_correlated():
    hits = []
    for seed in range(200):
        white = np.random.default_rng(seed).standard_normal(500)
        noise = 0.05 * 0.6 * lfilter([1.0], [1.0, -0.8], white)[100:]
        times = np.geomspace(1.0, 180.0, 400)
        fit = fit_creep(times, creep_strain(10.0, times) * (1.0 + noise), 10.0)
        hits += [fit[k].low <= TRUTH[k] <= fit[k].high for k in ("alpha", "g")]
        assert any("follow each other" in warning for warning in fit.warnings)
    assert 0.88 <= np.mean(hits) <= 0.99


def test_noise_of_one_modulus_does_not_spoil_the_others_interval():
    hits = []
    for seed in range(200):
        generator = np.random.default_rng(seed)
        loss = MODULUS.imag * (1.0 + 0.15 * generator.standard_normal(11))
        storage = MODULUS.real * (1.0 + 0.02 * generator.standard_normal(11))
        fit = fit_complex_modulus(OMEGAS, storage, loss)
        hits += [fit[k].low <= TRUTH[k] <= fit[k].high for k in ("alpha", "g")]
    assert 0.90 <= np.mean(hits) <= 0.99


def test_appendix_d_stands_beside_and_agrees_on_exact_pairs():
    fit = FITS["coefficients"](no_noise)
    beside = fit.beside["appendix_d"]
    for key in ("g", "g_n", "g_i", "x_b"):
        assert beside[key].value == pytest.approx(TRUTH[key], rel=1e-3)


def test_the_papers_convention_reads_g_low_and_gn_right():
    tests = [CreepTest(TIMES, creep_strain(s), s) for s in STRESSES]
    paper = fit_creep_series(tests).beside["paper"]
    assert 0.90 <= paper["g"].value / G <= 0.93
    assert paper["g_n"].value == pytest.approx(GN, rel=0.006)


def test_creep_beyond_the_boundary_strain_is_no_power_law_of_order_alpha():
    assert fit_creep(TIMES, creep_strain(750.0), 750.0)["alpha"].value < 0.3 * ALPHA


def test_relaxation_factor_is_that_of_the_erratum():
    fit = FITS["step"](no_noise)
    printed = fit["f_c"].value / (0.1 * gamma(1.0 + ALPHA))
    assert fit["g"].value / printed == pytest.approx(
        math.pi * ALPHA / math.sin(math.pi * ALPHA), rel=1e-9
    )


def test_ramp_taken_for_a_step_is_wrong_where_the_ramp_formula_is_right():
    stress = held_stress(0.1, 1.0)
    naive = fit_relaxation([Hold(AFTER, stress, 0.1)])["alpha"].value
    right = fit_relaxation([Hold(AFTER + 1.0, stress, 0.1)], ramp=1.0)["alpha"].value
    assert abs(naive - ALPHA) > 0.02 > 1e-6 > abs(right - ALPHA)


def test_phase_that_contradicts_the_gain_is_reported():
    generator = np.random.default_rng(1)
    noise = 1.0 + 0.05 * generator.standard_normal((2, 11))
    gain = noise[0] / np.abs(MODULUS)
    agreeing = fit_bode(OMEGAS, gain, -np.angle(MODULUS) * noise[1])
    contradicting = fit_bode(OMEGAS, gain, -2.0 * np.angle(MODULUS) * noise[1])
    assert agreeing.warnings == ()
    assert any("contradict" in warning for warning in contradicting.warnings)
    assert contradicting["alpha"].value == pytest.approx(ALPHA, abs=0.03)


def test_loss_angle_that_contradicts_the_slope_is_reported():
    fit = fit_complex_modulus(OMEGAS, MODULUS.real, 2.0 * MODULUS.imag)
    assert any("contradict" in warning for warning in fit.warnings)


def test_false_contradictions_are_rare():
    reports = [
        bool(
            fit_bode(
                OMEGAS,
                (1.0 + 0.05 * r.standard_normal(11)) / np.abs(MODULUS),
                -np.angle(MODULUS) * (1.0 + 0.05 * r.standard_normal(11)),
            ).warnings
        )
        for r in (np.random.default_rng(seed) for seed in range(300))
    ]
    assert np.mean(reports) < 0.04


def test_shallow_data_say_that_they_do_not_determine_gn():
    x = np.linspace(0.01, 0.08, 10)
    noise = 1.0 + 0.01 * np.random.default_rng(0).standard_normal(10)
    fit = fit_nonlinearity(MODEL.phi(x) * noise, x)
    assert any("do not determine Gn" in warning for warning in fit.warnings)
    assert math.isnan(fit["g_n"].sd)


def test_ramp_alone_hardly_determines_alpha_and_says_so():
    kept = PRESS_TIMES <= 1.0
    noise = 1.0 + 0.05 * np.random.default_rng(0).standard_normal(int(kept.sum()))
    stress = PRESS_STRESS[kept] * noise
    free = fit_indentation(PRESS_TIMES[kept], PRESS_STRAIN[kept], stress)
    prior = fit_indentation(PRESS_TIMES[kept], PRESS_STRAIN[kept], stress, ALPHA, 0.011)
    assert any("hardly determines alpha" in warning for warning in free.warnings)
    assert free["alpha"].sd > 0.05 > 0.02 > prior["alpha"].sd
    assert prior["g"].sd < 0.7 * free["g"].sd


def test_press_is_identified_whatever_the_steps_of_time():
    generator = np.random.default_rng(0)
    times = np.append(0.0, np.sort(generator.uniform(0.0, 4.0, 200)))
    strain = 0.3 * np.minimum(times, 1.0)
    stress = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.3], times, MODEL)
    fit = fit_indentation(times, strain, stress)
    found = {key: fit[key].value for key in ("alpha", "g", "g_n")}
    # The samples do not hit the corner at 1 s: their polygon is not quite the motion.
    assert found == pytest.approx({k: TRUTH[k] for k in found}, rel=0.02)


def test_long_fast_recording_is_fitted_by_the_uniform_grid():
    times = np.arange(0.0, 6.0, 0.0005)
    strain = np.interp(times, [0.0, 1.0, 3.0, 4.0], [0.0, 0.2, 0.2, 0.3])
    stress = stress_of_piecewise_linear_strain(
        [0.0, 1.0, 3.0, 4.0], [0.0, 0.2, 0.2, 0.3], times, MODEL
    )
    fit = fit_indentation(times, strain, stress)
    found = {key: fit[key].value for key in ("alpha", "g", "g_n")}
    assert found == pytest.approx({k: TRUTH[k] for k in found}, rel=1e-6)
    assert fit.beside["appendix_f"]["g_n"].value == pytest.approx(GN, rel=1e-3)


def test_two_points_are_enough_for_parameters_but_not_for_a_deviation():
    two = np.array([10.0, 100.0])
    fit = fit_creep(two, creep_strain(20.0, two), 20.0)
    assert (fit["alpha"].value, fit["g"].value) == pytest.approx((ALPHA, G), rel=1e-9)
    assert math.isnan(fit["alpha"].sd)
    assert fit.as_object()["alpha_sd"] is None


@pytest.mark.parametrize(
    "fit, words",
    [
        (lambda: fit_creep(TIMES, -creep_strain(20.0), 20.0), "strain is -"),
        (lambda: fit_creep(TIMES - 1.0, creep_strain(20.0), 20.0), "time is 0"),
        (lambda: fit_bode(OMEGAS, 1.0 / np.abs(MODULUS), np.angle(MODULUS)), "turn its sign"),
        (lambda: fit_bode(OMEGAS, 1.0 / np.abs(MODULUS), np.full(11, -12.0)), "not degrees"),
        (lambda: fit_nonlinearity(STRESSES[:2], creep_strain(STRESSES[:2], 1.0)), "3 different"),
        (
            lambda: fit_relaxation([Hold(AFTER, held_stress(0.1), 0.1)], ramp=1.0),
            "within the ramp",
        ),
        (lambda: fit_indentation(PRESS_TIMES, PRESS_STRAIN + 0.1, PRESS_STRESS), "first row"),
        (lambda: fit_indentation(PRESS_TIMES, -PRESS_STRAIN, PRESS_STRESS), "must be positive"),
    ],
)
def test_data_that_cannot_be_are_refused_with_the_reason(fit, words):
    with pytest.raises(InputError, match=words):
        fit()


def test_slope_and_phase_of_a_dynamic_test_have_deviations_of_their_own():
    slope, phase, errors = 0.15, 0.4, {"slope": [], "phase": []}
    for seed in range(200):
        generator = np.random.default_rng(seed)
        noise = np.exp(0.03 * generator.standard_normal((2, OMEGAS.size)))
        magnitude = 500.0 * OMEGAS**slope
        storage = magnitude * math.cos(phase) * noise[0]
        fit = fit_complex_modulus(OMEGAS, storage, magnitude * math.sin(phase) * noise[1])
        assert any("contradict" in warning for warning in fit.warnings)
        for name, truth in (("slope", slope), ("phase", 2.0 / math.pi * phase)):
            low, high = fit.beside[name]["alpha"][2:]
            errors[name].append(low <= truth <= high)
    for held in errors.values():
        assert 0.91 <= np.mean(held) <= 0.99
