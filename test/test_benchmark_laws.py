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

"""The benchmark of other laws: the tissue it presses, and what it counts."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from fden_ros.benchmarks.law_presses import (
    CASES,
    MOMENTS,
    RIGID,
    Predicted,
    Trial,
    recorded,
    run_trial,
)
from fden_ros.benchmarks.laws import _draw, goals_of, measure
from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.simulation.other_laws import (
    Law,
    Relaxation,
    poroelastic,
    quasi_linear,
    springpot,
    standard_linear_solid,
    stress_of_law,
)

BY_NAME = {case.name: case for case in CASES}
MODEL = FdenModel(1000.0, 8.0, 0.2)
LINEAR = FdenModel(1000.0, 0.5, 0.2)
STEP = 0.002

# The tissue


def ramp_and_hold(strain=0.25, ramp=1.0, stop=5.0):
    times = STEP * np.arange(1, round(stop / STEP) + 1)
    return times, np.interp(times, [0.0, ramp], [0.0, strain])


def test_a_springpot_is_the_closed_form():
    times, strains = ramp_and_hold()
    exact = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.25], times, MODEL)
    found = stress_of_law(Law(MODEL, springpot(0.2)), strains, STEP)
    np.testing.assert_allclose(found, exact, atol=1e-4 * exact.max())


@pytest.mark.parametrize(
    "relaxation",
    [
        standard_linear_solid(2.0),
        poroelastic(3.0),
        quasi_linear(0.15, 0.01, 100.0),
        Relaxation(springpots=((0.5, 0.1), (0.5, 0.4)), exponentials=((0.3, 0.0),)),
    ],
)
def test_a_ramp_leaves_the_integral_of_the_relaxation(relaxation):
    # Linear tissue: f(t) = G v int_0^t g.
    times, strains = ramp_and_hold(strain=0.1, ramp=2.0, stop=2.0)
    found = stress_of_law(Law(LINEAR, relaxation), strains, STEP)
    # u^5 takes the singularity at 0 away.
    nodes = (np.arange(20_000) + 0.5) / 20_000
    end = times[-1]
    integral = float(np.mean(relaxation.at(end * nodes**5) * 5.0 * nodes**4)) * end
    assert found[-1] == pytest.approx(1000.0 * 0.05 * integral, rel=1e-3)


def test_relaxations_begin_and_end_where_they_should():
    ends = np.array([1e-6, 1e6])
    np.testing.assert_allclose(standard_linear_solid(3.0).at(ends), [1.0, 0.5], rtol=1e-5)
    np.testing.assert_allclose(poroelastic(3.0).at(ends), [2.0, 1.0], rtol=5e-3)
    np.testing.assert_allclose(
        quasi_linear(0.15, 0.01, 100.0).at(ends),
        [1.0, 1.0 / (1.0 + 0.15 * math.log(1e4))],
        rtol=1e-3,
    )


def test_contact_pushes_and_the_tissue_wears_with_each_press():
    knots = np.cumsum([0.0, 0.5, 0.5, 0.7, 60.0, 0.2, 0.5, 0.5, 0.7])
    strains = [0.0, 0.2, 0.2, -0.05, -0.05, 0.0, 0.2, 0.2, -0.05]
    times = STEP * np.arange(1, round(float(knots[-1]) / STEP) + 1)
    motion = np.interp(times, knots, strains)
    halves = times < 30.0

    def peaks(**wear):
        stress = stress_of_law(Law(LINEAR, standard_linear_solid(0.5), **wear), motion, STEP)
        assert stress.min() == 0.0
        return stress[halves].max(), stress[~halves].max()

    first, second = peaks()
    assert second == pytest.approx(first, rel=1e-3)
    first, second = peaks(softening=0.1)
    assert second == pytest.approx(0.9 * first, rel=2e-3)
    first, second = peaks(set_strain=0.02)
    assert second == pytest.approx(0.9 * first, rel=0.02)


def test_no_relaxation_is_none():
    with pytest.raises(InputError, match="neither"):
        Relaxation()


# The benchmark


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_presses_are_recorded_with_their_moments_in_contact(case):
    recording = recorded(case, 1)
    assert len(recording.moments) == len(MOMENTS) * case.presses
    instants = [instant for _, _, instant in recording.moments]
    assert instants == sorted(instants)
    forces = np.interp(instants, recording.times, recording.forces)
    assert forces.min() > 0.02 * recording.peak_n
    np.testing.assert_array_equal(recorded(case, 1).forces, recording.forces)


def test_the_law_itself_is_predicted_within_its_interval():
    trial = run_trial(BY_NAME["fden"], 2, RIGID)
    assert (trial.contacts, trial.mismatch, trial.changed) == (1, 0, 0)
    used = [prediction for prediction in trial.predictions if not prediction.refusal]
    assert len(trial.predictions) == 4 and len(used) >= 2
    assert min(prediction.inside for prediction in used) > 0.9
    assert max(prediction.error for prediction in used) < 0.01


def predicted(moment, inside, refusal=""):
    numbers = (math.nan,) * 3 if refusal else (inside, 0.02, 0.01)
    return Predicted(0, moment, refusal, *numbers)


def test_only_what_is_predicted_counts():
    trials = [
        Trial((predicted(MOMENTS[0], 0.0, "REJECTED"), predicted(MOMENTS[1], 1.0)), 1, 1, 0, 0),
        Trial((predicted(MOMENTS[1], 0.6), predicted(MOMENTS[2], 0.8)), 1, 0, 1, 1),
    ]
    row = measure(BY_NAME["cubic"], RIGID, trials)
    assert (row.moments, row.predicted, row.refused) == (4, 3, 0.25)
    assert row.inside == pytest.approx(0.8)
    assert row.inside_at[MOMENTS[1]] == pytest.approx(0.8)
    assert math.isnan(row.inside_at[MOMENTS[3]])
    assert (row.contacts, row.mismatch, row.changed) == (2, 1, 1)
    (goal,) = goals_of([row])
    assert goal.met is False


def test_a_law_of_which_nothing_is_predicted_is_undecided(tmp_path):
    refused = Trial((predicted(MOMENTS[0], 0.0, "REJECTED"),), 1, 1, 0, 0)
    row = measure(BY_NAME["cubic"], RIGID, [refused])
    assert math.isnan(row.inside) and row.refused == 1.0
    assert [goal.met for goal in goals_of([row])] == [None]
    figure = Figure(layout="constrained")
    _draw(figure, [row])
    figure.savefig(tmp_path / "empty.png")


def benchmark(capsys, *arguments):
    assert main(["benchmark", "laws", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_command_measures_and_draws(tmp_path, capsys):
    arguments = ("--quick", "--laws", "linear_solid_1", "--jobs", 1, "-o", tmp_path)
    shown = json.loads(benchmark(capsys, *arguments, "--json"))
    (row,) = shown["figures"]["rows"]
    assert (row["law"], row["moments"], row["contacts"]) == ("linear_solid_1", 4, 1)
    assert (tmp_path / "laws.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--laws", "qubic"), "there is no law 'qubic'"),
        (("--laws", ","), "no law is named"),
        (("--seeds", "0"), "at least 1"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", "laws", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
