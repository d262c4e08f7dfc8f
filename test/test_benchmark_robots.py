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

"""The benchmark of disturbed rigs: what it counts, and a small run of it."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from fden_ros.benchmarks.disturbed import CASES, Judged, Trial, press_time, scenario_of
from fden_ros.benchmarks.robots import _draw, goals_of, measure
from fden_ros.cli import main
from fden_ros.core.outputs import Flag
from fden_ros.simulation.simulate import simulate

BY_NAME = {case.name: case for case in CASES}
DEVIATION = np.array([0.01, 0.01, 0.002])


def judged(error=(0.0, 0.0, 0.0), *, flags=Flag.NONE, converged=True, number=0):
    return Judged(converged, flags, np.array(error), DEVIATION, number)


def trial(*contacts, presses=1, **changes):
    given = Trial(presses, presses, 0, contacts, 10, 0, DEVIATION, 0)
    return given._replace(**changes)


def test_error_counts_beyond_five_deviations_and_the_least_size():
    assert not judged((0.04, 0.0, 0.0)).is_off
    assert judged((0.06, 0.0, 0.0)).is_off
    assert judged((0.0, -0.06, 0.0)).is_off
    assert judged((0.0, 0.0, 0.011)).is_off
    assert not judged((0.0, 0.0, 0.009)).is_off
    assert not Judged(True, Flag.NONE, np.array([0.02, 0, 0]), DEVIATION / 10, 0).is_off
    assert not judged((math.nan,) * 3).is_off


def test_error_is_silent_unless_something_tells_of_it():
    off = (0.1, 0.0, 0.0)
    assert judged(off).is_silent
    assert judged(off, flags=Flag.INPUT_REJECTED).is_silent
    assert not judged(off, converged=False).is_silent
    for flag in (Flag.MODEL_MISMATCH, Flag.TISSUE_CHANGED, Flag.ORIGIN_UNCERTAIN, Flag.GAP):
        assert not judged(off, flags=flag).is_silent


def test_row_counts_presses_claims_and_contacts_that_were_none():
    off = (0.1, 0.0, 0.0)
    trials = [
        trial(judged(off), wrong_claims=4),
        trial(judged((0.01, 0.02, 0.002))),
        trial(judged(off, flags=Flag.MODEL_MISMATCH), judged(number=-1)),
        trial(judged(flags=Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED), stuck=7),
        trial(clear_missed=1),
    ]
    row = measure(BY_NAME["hum_20mN"], trials)
    assert (row.silent_count, row.presses, row.silent) == (1, 5, 0.2)
    assert row.live == pytest.approx(4 / 50)
    assert (row.mismatch, row.fine_mismatch, row.changed) == (0.5, 0.25, 0.25)
    assert (row.invented, row.missed, row.clear, row.stuck) == (1, 1, 5, 7)
    assert row.last_off == pytest.approx(3 / 5)
    np.testing.assert_allclose(row.rms, np.sqrt([201 / 4, 4 / 4, 1 / 4]))
    np.testing.assert_allclose(row.deviation, DEVIATION)


def test_goals_are_decided_by_their_rows_alone():
    fine = [trial(judged(tuple(DEVIATION * (-1.0) ** n))) for n in range(1000)]
    wrong = [trial(judged((0.1, 0.0, 0.0)), wrong_claims=10) for _ in range(50)]
    names = {goal.name: goal for goal in goals_of([measure(BY_NAME["undisturbed"], fine)])}
    assert names["silent: presses converged, unflagged and off"].met
    assert names["root mean square of error over deviation, ln Gn"].value == pytest.approx(1.0)
    assert names["undisturbed, deviation of alpha after release"].value == pytest.approx(0.002)
    assert names["contacts invented: worst row"].met is None
    rows = [measure(BY_NAME["creep_20mN"], wrong)]
    names = {goal.name: goal for goal in goals_of(rows)}
    assert names["silent: worst row"].met is False
    assert names["live: unflagged CONVERGED states that are off"].value == 1.0
    assert goals_of([])


def test_tissue_is_as_thick_as_stated_within_two_percent_and_not_exactly():
    drawn = [scenario_of(BY_NAME["undisturbed"], n).geometry.thickness_m for n in range(200)]
    off = np.array(drawn) / 0.02 - 1.0
    assert np.std(off) == pytest.approx(0.02, rel=0.15)
    assert abs(np.mean(off)) < 0.004
    assert np.all(np.abs(off) < 0.035)


def test_ten_sites_show_how_the_deviation_shrinks():
    contacts = [Judged(True, Flag.NONE, np.zeros(3), DEVIATION / (1 + n), n) for n in range(10)]
    row = measure(BY_NAME["ten_sites"], [trial(*contacts, presses=10)])
    assert row.narrowing == pytest.approx(0.1)


# Of many sites one is like the other.
@pytest.mark.parametrize(
    "case", [case for case in CASES if case.press_count <= 3], ids=lambda case: case.name
)
def test_case_makes_the_presses_that_it_plans(case):
    scenario = scenario_of(case, 0)
    assert scenario == scenario_of(case, 0)
    recording = simulate(scenario)
    force = recording.force.value.max()
    assert case.liver or 0.1 < force < 10.0
    assert {c["site"] for c in recording.truth["contacts"]} == set(range(1, case.sites + 1))
    assert press_time(case.presses[0]) > 0.5


def test_picture_holds_a_row_without_anything(tmp_path):
    figure = Figure(layout="constrained")
    row = measure(BY_NAME["liver_white_20mN"], [trial(claims=0)])
    assert math.isnan(row.live) and np.all(np.isnan(row.rms))
    _draw(figure, [row])
    figure.savefig(tmp_path / "empty.png")


def benchmark(capsys, *arguments):
    assert main(["benchmark", "robots", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_quick_run_of_two_rows_finds_what_is_disturbed(tmp_path, capsys):
    rows = ("--quick", "--cases", "undisturbed,friction_20mN", "--contacts", 2, "--jobs", 1)
    shown = json.loads(benchmark(capsys, *rows, "--json", "-o", tmp_path))
    assert shown == json.loads((tmp_path / "robots.json").read_text())
    assert (tmp_path / "robots.png").read_bytes().startswith(b"\x89PNG")
    names = [goal["name"] for goal in shown["goals"]]
    assert len(set(names)) == len(names)
    clean, friction = shown["figures"]["cases"]
    assert (clean["presses"], clean["silent"], clean["last_off"]) == (2, 0.0, 0.0)
    assert clean["invented"] == friction["invented"] == 0
    assert friction["median_error"]["alpha"] > 2.0 * clean["median_error"]["alpha"]


def test_parameters_come_from_a_file_and_tables_can_be_pasted(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    displacement: {compliance: 0.0005, compliance_sd: 0.0}\n"
    )
    arguments = ("--cases", "compliance_0.5", "--contacts", 1, "--jobs", 1, "-o", tmp_path)
    benchmark(capsys, *arguments)
    plain = json.loads((tmp_path / "robots.json").read_text())["figures"]["cases"][0]
    shown = benchmark(capsys, *arguments, "--parameters", path)
    told = json.loads((tmp_path / "robots.json").read_text())["figures"]["cases"][0]
    # One contact: how far it is off says little, but it is another estimate.
    assert told["median_error"] != plain["median_error"]
    (line,) = [line for line in shown.splitlines() if "compliance 0.5 mm/N" in line]
    assert line.strip().startswith("|") and line.strip().endswith("|")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--cases", "frictio"), "there is no case 'frictio'"),
        (("--cases", ","), "no case is named"),
        (("--contacts", "0"), "at least 1"),
        (("--parameters", "nowhere.yaml"), "cannot read the parameter file"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", "robots", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
