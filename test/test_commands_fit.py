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

"""``fden fit`` and ``fden reproduce`` as users meet them: numbers, or one clear line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import gamma

from fden_ros.cli import main
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain

MODEL = FdenModel(545.0, 8.55, 0.131)
TIMES = np.geomspace(1.0, 180.0, 40)
SLIPPED = FdenModel(500.0, 4.5, 0.2)
FISH = Path(__file__).parents[2] / "shared" / "data" / "fish_muscle_relaxation_modulus.tsv"


def creep_strain(stress):
    return np.asarray(MODEL.strain_of_phi(stress * TIMES**0.131 / gamma(1.131)))


def write(path, delimiter=",", **columns):
    rows = np.column_stack(list(columns.values()))
    lines = [delimiter.join(columns), *(delimiter.join(f"{v:.17g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def fit_object(capsys, *arguments):
    assert main(["fit", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_dynamic_and_bode_files_give_alpha_and_g(tmp_path, capsys):
    omega = np.geomspace(0.1, 10.0, 11)
    modulus = 545.0 * (1j * omega) ** 0.131
    moduli = {"storage_modulus_pa": modulus.real, "loss_modulus_pa": modulus.imag}
    dynamic = write(tmp_path / "dynamic.csv", omega_rad_s=omega, **moduli)
    bode = write(
        tmp_path / "bode.csv",
        omega_rad_s=omega,
        gain_per_pa=1.0 / np.abs(modulus),
        phase_rad=-np.angle(modulus),
    )
    for kind, path in (("dynamic", dynamic), ("bode", bode)):
        found = fit_object(capsys, kind, path)
        assert (found["alpha"], found["g"]) == pytest.approx((0.131, 545.0), rel=1e-6)
        assert found["g_n"] is None and found["g_n_sd"] is None
        assert found["r2"] == pytest.approx(1.0)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_creep_file_leaves_out_the_first_second(tmp_path, capsys, delimiter):
    times = np.append([0.0, 0.5], TIMES)
    strain = np.append([0.0, 0.9], creep_strain(20.0))
    path = write(tmp_path / "creep.csv", delimiter, time_s=times, strain=strain)
    found = fit_object(capsys, "creep", path, "--stress", 20)
    assert (found["alpha"], found["g"]) == pytest.approx((0.131, 545.0), rel=1e-6)
    assert found["samples"] == TIMES.size


def test_torque_and_angle_with_the_sample_are_stress_and_strain(tmp_path, capsys):
    radius, height = 0.010, 0.005
    path = write(
        tmp_path / "torsion.csv",
        time_s=TIMES,
        angle_rad=creep_strain(20.0) * 2.0 * height / radius,
        torque_n_m=np.full(TIMES.size, 20.0 * math.pi * radius**3),
    )
    found = fit_object(capsys, "creep", path, "--radius", radius, "--height", height)
    assert found["g"] == pytest.approx(545.0, rel=1e-6)


def test_folder_of_creep_files_gives_all_three(tmp_path, capsys):
    for stress in (25.0, 75.0, 200.0, 500.0):
        write(
            tmp_path / f"{stress:04.0f}.csv",
            time_s=TIMES,
            strain=creep_strain(stress),
            stress_pa=np.full(TIMES.size, stress),
        )
    found = fit_object(capsys, "nonlinearity", tmp_path)
    assert (found["alpha"], found["g"], found["g_n"]) == pytest.approx(
        (0.131, 545.0, 8.55), rel=1e-6
    )
    assert found["paper"]["g"] < 0.94 * 545.0


def test_pairs_without_alpha_follow_the_papers_convention_and_say_so(tmp_path, capsys):
    x = np.linspace(0.03, 0.35, 9)
    path = write(tmp_path / "pairs.csv", stress_pa=MODEL.phi(x), strain_coefficient=x)
    plain = fit_object(capsys, "nonlinearity", path)
    named = fit_object(capsys, "nonlinearity", path, "--convention", "paper")
    corrected = fit_object(capsys, "nonlinearity", path, "--alpha", 0.131)
    assert plain["g"] == named["g"] == pytest.approx(545.0, rel=1e-6)
    assert "without --alpha" in plain["warnings"][0] and named["warnings"] == []
    assert corrected["g"] == pytest.approx(545.0 / gamma(1.131), rel=1e-6)


def test_relaxation_file_with_several_strains_gives_gn(tmp_path, capsys):
    strains = np.repeat([0.05, 0.15, 0.3], TIMES.size)
    times = np.tile(TIMES, 3)
    stress = np.asarray(MODEL.phi(strains)) * times**-0.131 / gamma(0.869)
    path = write(tmp_path / "holds.csv", time_s=times, stress_pa=stress, strain=strains)
    found = fit_object(capsys, "relaxation", path)
    assert (found["alpha"], found["g"], found["g_n"]) == pytest.approx(
        (0.131, 545.0, 8.55), rel=1e-6
    )


def test_press_that_slips_is_not_fitted_by_a_poorer_minimum(tmp_path, capsys):
    # Below 1/Gn the law is a straight line whatever Gn: from one start alone a fit ends there.
    times = np.linspace(0.0, 30.0, 151)
    strain = np.interp(times, [0.0, 2.0], [0.0, 0.3])
    stress = stress_of_piecewise_linear_strain([0.0, 2.0], [0.0, 0.3], times, SLIPPED)
    stress[times > 1.0] -= 0.3 * stress.max()
    path = write(tmp_path / "press.csv", time_s=times, strain=strain, stress_pa=stress)
    found = fit_object(capsys, "indentation", path)
    assert 0.3 * found["g_n"] > 1.0 and found["g_n_sd"] < found["g_n"]
    assert found["r2"] > 0.935


def test_deviation_larger_than_the_value_is_said(tmp_path, capsys):
    times = np.linspace(0.0, 3.0, 91)
    stress = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.08], times, MODEL)
    stress *= 1.0 + 0.05 * np.random.default_rng(3).standard_normal(times.size)
    strain = 0.08 * np.minimum(times, 1.0)
    path = write(tmp_path / "shallow.csv", time_s=times, strain=strain, stress_pa=stress)
    found = fit_object(capsys, "indentation", path)
    assert found["g_n_sd"] > found["g_n"] > 0.0 and found["g_sd"] < found["g"]
    named = [w.split()[0] for w in found["warnings"] if "do not determine it" in w]
    assert named == ["g_n", "g_i", "x_b"]


def test_relaxation_with_a_ramp_leaves_the_ramp_out(tmp_path, capsys):
    times = np.linspace(0.0, 10.0, 101)
    stress = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.1], times, MODEL)
    path = write(tmp_path / "hold.csv", time_s=times, stress_pa=stress)
    found = fit_object(capsys, "relaxation", path, "--strain", 0.1, "--ramp", 1)
    assert (found["alpha"], found["g"]) == pytest.approx((0.131, 545.0), rel=1e-6)
    assert found["samples"] == 90


def test_indentation_table_and_plot(tmp_path, capsys):
    times = np.linspace(0.0, 3.0, 61)
    strain = 0.3 * np.minimum(times, 1.0)
    stress = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.3], times, MODEL)
    path = write(tmp_path / "press.csv", time_s=times, strain=strain, stress_pa=stress)
    assert main(["fit", "indentation", str(path), "--plot", str(tmp_path / "press.png")]) == 0
    table = capsys.readouterr().out
    assert "545" in table and "8.55" in table and "0.131" in table
    assert (tmp_path / "press.png").stat().st_size > 10_000


GOOD = "time_s,strain,stress_pa\n1,0.10,50\n2,0.11,50\n3,0.12,50\n"

BAD = {
    "empty": ("creep", "", "is empty"),
    "names only": ("creep", "time_s,strain,stress_pa\n", "no rows"),
    "one row": ("creep", "time_s,strain,stress_pa\n1,0.1,50\n", "has 1 row; a creep fit needs"),
    "no names": ("creep", "1,0.1,50\n2,0.11,50\n", "must hold the column names"),
    "missing column": ("creep", GOOD.replace("strain,", "x,"), "column strain"),
    "other unit": ("creep", GOOD.replace("time_s", "time_ms"), "convert 'time_ms' to s"),
    "percent": ("creep", GOOD.replace("0.1", "10."), "not percent"),
    "text": ("creep", GOOD.replace("0.11", "soft"), "line 3: strain 'soft' is not a number"),
    "hole": ("creep", GOOD.replace("0.11", ""), "line 3: strain is empty"),
    "short row": ("creep", GOOD.replace("2,0.11,50", "2"), "line 3: strain is empty"),
    "nan": ("creep", GOOD.replace("0.11", "nan"), "line 3: strain is nan"),
    "unsorted": ("creep", GOOD.replace("\n3,", "\n1.5,"), "line 4: time_s 1.5 does not come"),
    "twice": ("creep", GOOD.replace("\n3,", "\n2,"), "line 4: time_s 2 does not come after 2"),
    "negative": ("creep", GOOD.replace("0.11", "-0.11"), "line 3: strain is -0.11; it must be"),
    "two stresses": ("creep", GOOD.replace("0.12,50", "0.12,90"), "one stress"),
    "no stress": ("creep", "time_s,strain\n1,0.1\n2,0.11\n", "give --stress PA"),
    "all early": ("creep", "time_s,strain,stress_pa\n.1,.1,50\n.2,.11,50\n", "give --from"),
    "torque alone": ("creep", GOOD.replace("stress_pa", "torque_n_m"), "--radius and --height"),
    "time zero": ("relaxation", "time_s,stress_pa,strain\n0,9,.1\n1,8,.1\n", "see --from"),
    "no strain": ("relaxation", "time_s,stress_pa\n1,9\n2,8\n", "give --strain X"),
    "not held": ("relaxation", "time_s,stress_pa,strain\n1,9,.1\n2,8,.2\n3,7,.3\n", "not held"),
    "loss of 0": (
        "dynamic",
        "omega_rad_s,storage_modulus_pa,loss_modulus_pa\n1,400,80\n2,440,0\n",
        "line 3: loss_modulus_pa is 0; it must be positive",
    ),
    "hertz": (
        "dynamic",
        "freq_hz,storage_modulus_pa,loss_modulus_pa\n1,400,80\n2,440,90\n",
        "convert 'freq_hz' to rad/s",
    ),
    "degrees": (
        "bode",
        "omega_rad_s,gain_per_pa,phase_rad\n1,0.002,-12\n2,0.0018,-12\n",
        "give radians",
    ),
    "two pairs": ("nonlinearity", "stress_pa,strain_coefficient\n20,.1\n40,.2\n", "at least 3"),
    "few samples": ("indentation", GOOD, "needs at least 6"),
}


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


def test_absent_and_binary_files_and_folders_are_named(tmp_path, capsys):
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(128, 256)))
    (tmp_path / "folder").mkdir()
    for path, words in (
        (tmp_path / "none.csv", "does not exist"),
        (binary, "not a text file"),
        (tmp_path / "folder", "is a folder"),
    ):
        assert main(["fit", "creep", str(path), "--stress", "5"]) == 1
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "stretch", "x.csv"],
        ["fit", "dynamic", "x.csv", "--stress", "5"],
        ["fit", "creep", "x.csv", "--radius", "0.01"],
        ["fit", "indentation", "x.csv", "--alpha", "1.5"],
        ["fit", "indentation", "x.csv", "--alpha-sd", "0.1"],
        ["fit", "relaxation", "x.csv", "--strain", "-1"],
        ["fit", "nonlinearity", "x.csv", "--convention", "exact"],
        ["reproduce"],
        ["reproduce", "-o", "x", "--noise", "-1"],
    ],
)
def test_wrong_usage_exits_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "error:" in capsys.readouterr().err


@pytest.mark.skipif(not FISH.exists(), reason="fish_muscle_relaxation_modulus.tsv is not here")
def test_fish_muscle_fits_after_its_conversion_and_the_misfit_is_told(tmp_path, capsys):
    rows = FISH.read_text().splitlines()[1:]
    path = tmp_path / "fish.csv"
    path.write_text("\n".join(["time_s,stress_pa", *(row.replace("\t", ",") for row in rows)]))
    found = fit_object(capsys, "relaxation", path, "--strain", 1)
    assert 0.17 < found["alpha"] < 0.26
    assert found["r2"] > 0.9
    assert "follow each other" in found["warnings"][0]


def test_reproduce_writes_tables_claims_and_figures(tmp_path, capsys):
    assert main(["reproduce", "-o", str(tmp_path), "--samples", "3"]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    holds = {claim["claim"]: claim["holds"] for claim in report["claims"]}
    assert list(holds.values()).count("yes") == 5
    assert holds["the origin of strain follows from data in the nonlinear range alone"] == "no"
    assert report["tables"]["nonlinearity Gn"]["paper"]["average"] == 8.547
    numbers = {claim["claim"]: claim["numbers"] for claim in report["impossible"]}
    lost = numbers["G xc = fc, with xc from the creep fit"]
    assert -0.11 < lost["g_bias"] < -0.07 and abs(lost["g_n_bias"]) < 0.006
    assert numbers["Appendix F: Gn x + log Gi = D^-alpha log f"]["g_n_literal"] > 13.0
    text = (tmp_path / "report.md").read_text()
    assert "Table I" in text and "Table II" in text
    figures = list(tmp_path.glob("*.png"))
    assert len(figures) == 6 and all(f.name in text for f in figures)
