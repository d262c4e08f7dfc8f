# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden fit`` as users meet it: numbers, or one clear line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.special import gamma

from fden_ros.cli import main
from fden_ros.simulation.model import FdenModel

MODEL = FdenModel(545.0, 8.55, 0.131)
TIMES = np.geomspace(0.5, 100.0, 60)


def write(path, **columns):
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(f"{v:.17g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_creep(path, stress=20.0):
    strain = MODEL.strain_of_phi(stress * TIMES**0.131 / gamma(1.131))
    return write(path, time_s=TIMES, strain=strain)


def fit_object(capsys, *arguments):
    assert main(["fit", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_creep_becomes_a_table(tmp_path, capsys):
    path = write_creep(tmp_path / "creep.csv")
    assert main(["fit", "creep", str(path), "--stress", "20"]) == 0
    table = capsys.readouterr().out
    assert "545" in table and "0.131" in table


def test_every_kind_prints_what_stands_beside(tmp_path, capsys):
    omega = np.geomspace(0.1, 10.0, 11)
    modulus = 545.0 * (1j * omega) ** 0.131
    moduli = {"storage_modulus_pa": modulus.real, "loss_modulus_pa": modulus.imag}
    path = write(tmp_path / "dynamic.csv", omega_rad_s=omega, **moduli)
    assert main(["fit", "dynamic", str(path)]) == 0
    table = capsys.readouterr().out
    assert "by the slope of |G*|" in table and "by the phase" in table
    found = fit_object(capsys, "dynamic", path)
    assert found["g_n"] is None and found["slopes"]["loss"] == pytest.approx(0.131)


def test_options_reach_the_fit(tmp_path, capsys):
    path = write_creep(tmp_path / "creep.csv")
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
    "empty": ("creep", "", "is empty"),
    "names only": ("creep", "time_s,strain,stress_pa\n", "no rows"),
    "one row": ("creep", "time_s,strain,stress_pa\n1,0.1,50\n", "has 1 row; a creep fit needs"),
    "missing column": ("creep", GOOD.replace("strain,", "x,"), "column strain"),
    "text": ("creep", GOOD.replace("0.11", "soft"), "line 3: strain 'soft' is not a number"),
    "hole": ("creep", GOOD.replace("0.11", ""), "line 3: strain is empty"),
    "unsorted": ("creep", GOOD.replace("\n3,", "\n1.5,"), "line 4: time_s 1.5 does not come"),
    "negative": ("creep", GOOD.replace("0.11", "-0.11"), "line 3: strain is -0.11; it must be"),
    "two stresses": ("creep", GOOD.replace("0.12,50", "0.12,90"), "one stress"),
    "no stress": ("creep", "time_s,strain\n1,0.1\n2,0.11\n", "give --stress PA"),
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
