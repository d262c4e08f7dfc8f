# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every experiment gives back its parameters with honest intervals; the command, or one line."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import gamma

from fden_ros.cli import main
from fden_ros.experiments.dynamic import fit_complex_modulus
from fden_ros.experiments.kinds import Options, fit_file
from fden_ros.experiments.nonlinearity import fit_nonlinearity
from fden_ros.experiments.steps import Step, fit_step
from fden_ros.simulation import FdenModel

G, GN, ALPHA = 545.0, 8.55, 0.131
MODEL = FdenModel(G, GN, ALPHA)
TRUTH = {"alpha": ALPHA, "g": G, "g_n": GN, "x_b": 1.0 / GN, "g_i": G / (GN * math.e)}

OMEGAS = np.geomspace(0.1, 10.0, 11)
MODULUS = G * (1j * OMEGAS) ** ALPHA
TIMES = np.geomspace(1.0, 180.0, 60)
STRESSES = np.array([25.0, 50, 75, 100, 150, 200, 300, 400, 500, 600, 750])
STRAINS = np.linspace(0.03, 0.35, 12)


def creep_strain(stress, times=TIMES):
    return np.asarray(MODEL.strain_of_phi(stress * times**ALPHA / gamma(1.0 + ALPHA)))


def creep_columns(stress, times=TIMES):
    """Return the columns of a creep test, which begin with the second that is left out."""
    strain = np.append([0.0, 0.9], creep_strain(stress, times))
    times = np.append([0.0, 0.5], times)
    return {"time_s": times, "strain": strain, "stress_pa": np.full(times.size, stress)}


def relaxation_columns(strain, times=TIMES):
    """Return the columns of a relaxation test, which begin with the row of time 0."""
    stress = MODEL.phi(strain) * times**-ALPHA / gamma(1.0 - ALPHA)
    times, stress = np.append(0.0, times), np.append(0.0, stress)
    return {"time_s": times, "stress_pa": stress, "strain": np.full(times.size, strain)}


def in_kilopascal(columns):
    """Return the columns of a relaxation test under the headings of an instrument."""
    times, stress, strain = columns.values()
    return {
        "Time (min)": times / 60.0,
        "Stress (kPa)": 1e-3 * stress,
        "Strain (%)": 100.0 * strain,
    }


#: Of each file or folder: kind, options, columns of its files, and those that are measured.
DATA = {
    "dynamic": (
        "dynamic", Options(), [{"omega_rad_s": OMEGAS, "storage_modulus_pa": MODULUS.real,
                                "loss_modulus_pa": MODULUS.imag}],
        ("storage_modulus_pa", "loss_modulus_pa"),
    ),
    "creep": ("creep", Options(), [creep_columns(20.0)], ("strain",)),
    "coefficients": (
        "nonlinearity", Options(alpha=ALPHA),
        [{"stress_pa": STRESSES, "strain_coefficient": creep_strain(STRESSES, 1.0)}],
        ("strain_coefficient",),
    ),
    "stresses": (
        "nonlinearity", Options(),
        [{"stress_pa": MODEL.phi(STRAINS), "strain_coefficient": STRAINS}],
        ("stress_pa",),
    ),
    "relaxation": ("relaxation", Options(), [relaxation_columns(0.05)], ("stress_pa",)),
    "relaxation modulus": (
        "relaxation", Options(),
        [{"Time": TIMES, "Relaxation modulus": G * TIMES**-ALPHA / gamma(1.0 - ALPHA)}],
        ("Relaxation modulus",),
    ),
    "relaxation of an instrument": (
        "relaxation", Options(), [in_kilopascal(relaxation_columns(0.05))], ("Stress (kPa)",),
    ),
    "relaxations": (
        "relaxation", Options(), [relaxation_columns(x, TIMES[::3]) for x in STRAINS[::2]],
        ("stress_pa",),
    ),
    "series": (
        "nonlinearity", Options(), [creep_columns(s, TIMES[::3]) for s in STRESSES[::2]],
        ("strain",),
    ),
}  # fmt: skip


def write(path, delimiter=",", **columns):
    rows = np.column_stack(list(columns.values()))
    lines = [delimiter.join(columns), *(delimiter.join(f"{v:.17g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def fitted(tmp_path):
    """Return a function: the fit of some data, with relative noise if a seed is given."""

    def fit(name, seed=None, size=0.05, delimiter=","):
        kind, options, tests, measured = DATA[name]
        generator = np.random.default_rng(seed)
        for number, columns in enumerate(tests):
            noise = size * (seed is not None)
            noisy = {
                c: v * (1.0 + noise * generator.standard_normal(v.shape)) if c in measured else v
                for c, v in columns.items()
            }
            path = write(tmp_path / f"{number:02}.csv", delimiter, **noisy)
        return fit_file(kind, path if len(tests) == 1 else tmp_path, options)

    return fit


def covered(fit):
    """Return whether the interval of each fitted parameter holds the truth."""
    known = [k for k in ("alpha", "g", "g_n") if k in fit.parameters and fit[k].sd > 0.0]
    return [fit[k].low <= TRUTH[k] <= fit[k].high for k in known]


@pytest.mark.parametrize("name", DATA)
def test_noise_free_file_gives_the_parameters_back(fitted, name):
    fit = fitted(name, delimiter=";" if name == "creep" else ",")
    tolerance = 1e-3 if name == "dynamic" else 1e-6
    found = {key: fit[key].value for key in TRUTH if key in fit.parameters}
    assert found == pytest.approx({key: TRUTH[key] for key in found}, rel=tolerance)
    assert {"alpha", "g"} <= set(found) or name == "stresses"
    assert fit.r_squared == pytest.approx(1.0, abs=1e-9)
    said = ("without --alpha", "states no unit")
    assert [w for w in fit.warnings if not any(words in w for words in said)] == []


@pytest.mark.statistics
@pytest.mark.parametrize("name", DATA)
def test_intervals_cover_the_truth_under_five_percent_noise(fitted, name):
    hits = np.array([covered(fitted(name, seed)) for seed in range(500)])
    for one in hits.T:
        assert 0.90 <= np.mean(one) <= 0.99


def test_residuals_that_follow_each_other_are_reported():
    times = np.geomspace(1.0, 180.0, 400)
    white = np.random.default_rng(0).standard_normal(500)
    noise = 0.03 * lfilter([1.0], [1.0, -0.8], white)[100:]
    fit = fit_step(Step("creep", times, creep_strain(10.0, times) * (1.0 + noise), 10.0))
    assert any("residuals are correlated" in warning for warning in fit.warnings)
    assert covered(fit) == [True, True]


def test_phase_that_contradicts_the_slope_is_reported():
    noise = 1.0 + 0.05 * np.random.default_rng(1).standard_normal((2, 11))
    moduli = noise * [MODULUS.real, MODULUS.imag]
    assert fit_complex_modulus(OMEGAS, *moduli).warnings == ()
    fit = fit_complex_modulus(OMEGAS, MODULUS.real, 2.0 * MODULUS.imag)
    assert any("contradict" in warning for warning in fit.warnings)


def test_shallow_data_say_that_they_do_not_determine_gn():
    x = np.linspace(0.01, 0.08, 10)
    noise = 1.0 + 0.01 * np.random.default_rng(0).standard_normal(10)
    fit = fit_nonlinearity(MODEL.phi(x) * noise, x)
    assert any("do not determine Gn" in warning for warning in fit.warnings)
    assert math.isnan(fit["g_n"].sd)


def fit_object(capsys, *arguments):
    assert main(["fit", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_options_reach_the_fit(tmp_path, capsys):
    path = write(tmp_path / "creep.csv", time_s=TIMES, strain=creep_strain(20.0))
    found = fit_object(capsys, "creep", path, "--stress", 20, "--from", 1.5)
    assert (found["alpha"], found["g"]) == pytest.approx((0.131, 545.0), rel=1e-6)
    assert found["samples"] == np.count_nonzero(TIMES >= 1.5)


def test_pairs_without_alpha_follow_the_papers_convention_and_say_so(tmp_path, capsys):
    x = np.linspace(0.03, 0.35, 9)
    path = write(tmp_path / "pairs.csv", stress_pa=MODEL.phi(x), strain_coefficient=x)
    plain = fit_object(capsys, "nonlinearity", path)
    corrected = fit_object(capsys, "nonlinearity", path, "--alpha", 0.131)
    assert plain["g"] == pytest.approx(545.0, rel=1e-6)
    assert "without --alpha" in plain["warnings"][0]
    assert corrected["g"] == pytest.approx(545.0 / gamma(1.131), rel=1e-6)


GOOD = "time_s,strain,stress_pa\n1,0.10,50\n2,0.11,50\n3,0.12,50\n"

BAD = {
    "one row": ("creep", "time_s,strain,stress_pa\n1,0.1,50\n", "rows: 1; a creep fit needs"),
    "missing column": ("creep", GOOD.replace("strain,", "x,"), "column strain"),
    "text": ("creep", GOOD.replace("0.11", "soft"), "line 3: '2,soft,50' has no number"),
    "negative": ("creep", GOOD.replace("0.11", "-0.11"), "line 3: strain is -0.11; it must be"),
    "no strain": ("relaxation", "time_s,stress_pa\n1,5\n2,4\n", "give --strain X"),
    "two strains": (
        "relaxation", "time_s,stress_pa,strain\n1,5,0.1\n2,4,0.2\n",
        "a test has one",
    ),
    "several stresses": (
        "relaxation", "Time (s),Strain,True stress (kPa),Stress (kPa)\n1,.1,5,5\n2,.1,4,4\n",
        "several could be it",
    ),
    "two stresses": (
        "nonlinearity", "stress_pa,strain_coefficient\n1,.1\n2,.2\n1,.1\n", "3 different",
    ),
    "no stress": ("creep", "time_s,strain\n1,0.1\n2,0.11\n", "give --stress PA"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_file_gets_one_clear_line_and_exit_code_1(tmp_path, capsys, case):
    kind, text, words = BAD[case]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert main(["fit", kind, str(path)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert words in captured.err and str(path) in captured.err
