# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The cases of the benchmarks: what is pressed is what is said, and small runs count it."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from property_helpers import counts

from benchmark import accuracy, changes, exact, invariance, laws, presses, real, robots
from benchmark.classification import told
from benchmark.measured import Test as Measured
from benchmark.measured import hold_order, read_tests
from benchmark.score import Share
from fden_ros.cli import main
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.simulation.simulate import EXACT, simulate

DRAWN = [exact.drawn(number) for number in range(48)]


def benchmark(capsys, tmp_path, name, *arguments):
    """Run a benchmark and return what it prints as JSON."""
    words = [*map(str, arguments), "--json", "-o", str(tmp_path)]
    assert main(["benchmark", name, *words]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads((tmp_path / f"{name}.json").read_text())
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    names = [goal["name"] for goal in shown["goals"]]
    assert len(set(names)) == len(names)
    return shown["figures"]


# Disturbed rigs


def test_tissue_is_as_thick_as_stated_within_two_percent_and_not_exactly():
    case = presses.CASES["undisturbed"]
    drawn = [presses.scenario_of(case, n).geometry.thickness_m for n in range(200)]
    off = np.array(drawn) / 0.02 - 1.0
    assert np.std(off) == pytest.approx(0.02, rel=0.15)
    assert abs(np.mean(off)) < 0.004
    assert np.all(np.abs(off) < 0.035)


@pytest.mark.parametrize(
    "case",
    [case for case in presses.CASES.values() if case.press_count <= 3],
    ids=lambda case: case.name,
)
def test_rig_makes_the_presses_that_it_plans(case):
    scenario = presses.scenario_of(case, 0)
    assert scenario == presses.scenario_of(case, 0)
    recording = simulate(scenario)
    assert case.liver or 0.1 < recording.force.value.max() < 10.0
    assert {c["site"] for c in recording.truth["contacts"]} == set(range(1, case.sites + 1))
    assert not set(EXACT) & set(presses.parameters_of(recording))
    assert case.held_s > 0.5


def test_rigs_are_judged_with_the_parameters_of_a_file(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("/**: {ros__parameters: {displacement: {compliance: 0.0005}}}\n")
    own = ("robots", "--cases", "compliance_0.5,undisturbed", "--contacts", 1, "--jobs", 1)
    plain = benchmark(capsys, tmp_path, *own)["cases"]
    told_of = benchmark(capsys, tmp_path, *own, "--parameters", path)["cases"]
    name = "compliance 0.5 mm/N"
    assert plain[name]["silent"] == told_of[name]["silent"] == [0, 1]
    assert plain[name]["error over sd"] != told_of[name]["error over sd"]
    assert plain["nothing; press and hold"]["invented"] == 0


FOOLING = [case for case in presses.CASES.values() if case.detection and case.sites == 1]


@pytest.mark.parametrize("numbers", counts(1, 2))
@pytest.mark.parametrize("case", FOOLING, ids=lambda case: case.name)
def test_presses_of_ten_times_the_noise_are_found_once_and_nothing_else_is(case, numbers):
    outcomes = [robots.run_trial(case.name, number, {}, 10.0) for number in range(numbers)]
    found = robots.row_of(case, outcomes, 10.0)
    assert [found[name] for name in ("invented", "split", "stuck")] == [0] * 3
    assert found["missed"] == Share(0, numbers)


def test_press_takes_as_many_times_the_noise_as_is_asked_for():
    case = presses.CASES["vibration_moving_50mN"]
    force = simulate(presses.scenario_of(case, 0, 40.0)).force.value.max()
    # The vibration itself and four deviations of the noise add to it.
    assert 2.0 < force < 2.0 + 0.05 + 0.04


# The law's own tissue


@pytest.mark.parametrize("drawn", DRAWN, ids=lambda drawn: str(drawn.number))
def test_what_is_drawn_is_within_what_is_stated(drawn):
    model = drawn.model
    for value, (low, high) in (
        (model.linear_stiffness, exact.LINEAR_STIFFNESS),
        (model.nonlinear_stiffness, exact.NONLINEAR_STIFFNESS),
        (model.fractional_order, exact.ORDER),
        (drawn.noise_pa, exact.NOISE_PA),
        (drawn.rate_hz, exact.RATE_HZ),
    ):
        assert low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9)
    assert exact.SIGNAL_TO_NOISE * drawn.noise_pa <= drawn.peak_pa <= exact.LARGEST_STRESS
    slowest = exact.RATE_HZ[0] * exact.HOLD_S[1]
    assert drawn.held_s * drawn.rate_hz <= max(exact.LARGEST_SAMPLES, slowest)
    if drawn.prior:
        off = math.log(drawn.prior["prior.linear_stiffness"] / model.linear_stiffness)
        assert abs(off) <= exact.PRIOR_OFF * drawn.prior["prior.linear_stiffness_log_sd"]
    assert drawn == exact.drawn(drawn.number)


def test_every_motion_meets_every_rig_and_both_kinds_of_prior():
    pairs = {(drawn.press.kind, drawn.rig) for drawn in DRAWN}
    assert pairs == {(m, rig) for m in exact.MOTIONS for rig in (exact.RIGID, exact.ARM)}
    assert {bool(drawn.prior) for drawn in DRAWN} == {True, False}


def test_identifier_is_told_the_rig_and_not_the_noise():
    rigid, arm = (next(d for d in DRAWN if d.rig == rig) for rig in (exact.RIGID, exact.ARM))
    own = exact.parameters_of(rigid, simulate(exact.scenario_of(rigid)))
    assert own["displacement.compliance_sd"] == 0.0 and "model_error.sd" not in own
    others = exact.parameters_of(arm, simulate(exact.scenario_of(arm)))
    assert not set(EXACT) & set(others)
    assert not {"force.noise", "alpha.learn"} & (set(own) | set(others))


def test_exact_counts_its_contacts_by_what_they_are(tmp_path, capsys):
    own = ("exact", "--contacts", 2, "--samples", 300, "--jobs", 1)
    rows = benchmark(capsys, tmp_path, *own)["rows"]
    assert rows["all"]["no estimate"][1] == rows["ramp"]["no estimate"][1] == 2
    assert rows["rig known"]["silent"] == [0, 2] and "palpation" not in rows


def test_accuracy_is_measured_with_the_parameters_of_a_file(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("/**: {ros__parameters: {model_error: {sd: 0.0}}}\n")
    own = ("accuracy", "--cases", "ten_samples", "--contacts", 3, "--jobs", 1)
    first = benchmark(capsys, tmp_path, *own)["cases"]["ten_samples"]
    second = benchmark(capsys, tmp_path, *own, "--parameters", path)["cases"]["ten_samples"]
    # The scale of the law's error is learned: ten samples do not rule it out.
    assert first["error over the bound"] != second["error over the bound"]
    assert second["silent"] == [0, 3] and first["error over the bound"][2] is None


def test_a_site_pressed_before_goes_on_where_noise_hides_the_surface():
    # In the tenth press of this recording the detector does not see the touch.
    found = accuracy.trial_of(accuracy.CASES["ten_palpations"], 8, {}).judged
    assert found is not None and found.converged
    assert np.all(np.abs(found.error[:2]) < 0.02)


# Other laws


@pytest.mark.parametrize("case", laws.CASES.values(), ids=lambda case: case.name)
def test_presses_are_recorded_with_their_moments_in_contact(case):
    recording = laws.recorded(case, 1)
    instants = [instant for _, instant in recording.moments]
    assert len(instants) == len(laws.MOMENTS) * case.presses
    assert instants == sorted(instants)
    forces = np.interp(instants, recording.times, recording.forces)
    assert forces.min() > 0.02 * recording.peak_n
    np.testing.assert_array_equal(laws.recorded(case, 1).forces, recording.forces)


def test_only_what_is_predicted_counts():
    none, one = Share(0, 1), Share(1, 1)
    refused = laws.Predicted(laws.MOMENTS[0], "REJECTED")
    ramp, hold = laws.MOMENTS[1:3]
    trials = [
        laws.Trial((refused, laws.Predicted(ramp, "", 1.0, 0.02, 0.01)), one, none),
        laws.Trial(
            (laws.Predicted(ramp, "", 0.6, 0.02, 0.01), laws.Predicted(hold, "", 0.8, 0.02, 0.01)),
            none,
            one,
        ),
    ]
    row = laws.row_of(trials)
    assert (row["refused"], row["mismatch"], row["changed"]) == (
        Share(1, 4),
        Share(1, 2),
        Share(1, 2),
    )
    assert row["in 95 %"] == pytest.approx(0.8) and row["at each moment"][1] == pytest.approx(0.8)
    nothing = laws.row_of([laws.Trial((refused,), one, none)])
    goals = laws.goals_of({"some": row, "none": nothing}, {})
    assert [goal.met for goal in goals[:2]] == [False, None]


def test_the_law_itself_is_predicted_within_its_interval(tmp_path, capsys):
    trial = laws.run_trial(("fden", laws.RIGID), 2)
    assert (trial.mismatch, trial.changed) == (Share(0, 1), Share(0, 1))
    used = [prediction for prediction in trial.predictions if not prediction.refusal]
    assert len(trial.predictions) == 4 and len(used) >= 2
    assert min(prediction.inside for prediction in used) > 0.9
    assert max(prediction.error for prediction in used) < 0.01
    own = ("laws", "--quick", "--cases", "linear_solid_1", "--jobs", 1)
    (row,) = benchmark(capsys, tmp_path, *own)["laws"].values()
    assert row["refused"][1] == 4


# The paper's study


def test_study_stands_beside_the_paper_without_and_with_noise(tmp_path, capsys):
    figures = benchmark(capsys, tmp_path, "study", "--contacts", 3, "--jobs", 1)
    rows = figures["tables"]
    assert rows["nonlinearity Gn, paper"]["average"] == 8.547
    assert 250.0 < rows["dynamic G, exact"]["average"] < 520.0
    assert rows["R² creep, noisy"]["minimum"] > 0.9
    assert figures["ratios"]["G, all curves, exact"]["average"] == pytest.approx(1.0, abs=1e-6)


# Changes

FLAT = changes.CASES["flat_30"]
SLIDE, INCLUSION = changes.CHANGES[:2]


@pytest.mark.parametrize("kind", ["slide", "inclusion", "body"])
def test_change_begins_where_it_is_said_to_and_not_before(kind):
    before = changes.press(FLAT.geometry, 1000.0, changes.NOTHING, 3)
    after = changes.press(FLAT.geometry, 1000.0, changes.Change(kind, 2.0), 3)
    added = after.forces - before.forces
    assert np.all(added[after.times < after.changed_at] == 0.0)
    during = (after.times > after.changed_at) & (after.times < after.changed_at + 0.3)
    assert np.all(added[during] >= 0.0)
    assert added[during].max() > 0.05 * before.forces[during].max()


def test_slide_onto_stiffer_tissue_multiplies_the_force():
    before = changes.press(FLAT.geometry, 100.0, changes.NOTHING, 3)
    after = changes.press(FLAT.geometry, 100.0, SLIDE, 3)
    noise = 3.0 * FLAT.geometry.force_per_stress
    later = (after.times > after.changed_at + 0.05) & (before.forces > 10.0 * noise)
    ratio = np.mean(after.forces[later]) / np.mean(before.forces[later])
    # The noise is the same in both.
    assert ratio == pytest.approx(1.3, abs=0.03) and later.sum() > 20


@pytest.mark.parametrize("numbers", counts(1, 4))
@pytest.mark.parametrize("row", ["flat_30", "sphere_30", "flat_100_arm"])
def test_changes_are_told_in_time_at_slow_rates_too(row, numbers):
    for change in (SLIDE, INCLUSION):
        delays = [changes.run_trial((row, change.name), number, {}) for number in range(numbers)]
        # With the open questions of an arm an inclusion of 1.5 is told in time in half of them.
        least = numbers // 2 if row.endswith("_arm") and change is INCLUSION else 0.75 * numbers
        assert changes.told_in(delays)["in time"].part >= least, change.name


@pytest.mark.parametrize("numbers", counts(1, 4))
def test_nothing_is_told_of_tissue_that_stays_what_it_is(numbers):
    narrow = {"prior.alpha_sd": 0.011, "prior.alpha": 0.05}
    for own in ({}, narrow, {**narrow, "alpha.learn": False}):
        delays = [changes.run_trial(("flat_30", "none"), number, own) for number in range(numbers)]
        assert delays == [math.inf] * numbers, own


def test_too_soon_and_too_late_are_not_in_time(tmp_path, capsys):
    found = changes.told_in([0.05, 0.2, -0.1, math.inf])
    assert (found["in time"], found["late"], found["false"]) == (Share(1, 4),) * 3
    assert changes.told_in([-math.inf])["false"] == Share(1, 1)
    own = ("changes", "--cases", "flat_30", "--contacts", 1, "--jobs", 1)
    (row,) = benchmark(capsys, tmp_path, *own)["rows"].values()
    assert set(row) == {change.name for change in changes.CHANGES}


# Measured tests


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A folder with a table of two materials: soft and slow, stiff and quick."""
    rng, lines = np.random.default_rng(7), []
    for index in range(12):
        name, g, order = (("beef_x", 2.0, 0.32), ("silicone", 6.0, 0.1))[index % 2]
        model = FdenModel(g * math.exp(rng.normal(0, 0.1)), 8.0, order + rng.normal(0, 0.01))
        times = 0.1 * np.arange(80)
        strains = np.minimum(0.01 * np.arange(80), 0.3)
        forces = stress_of_piecewise_linear_strain(times, strains, times, model)
        forces += rng.normal(0.0, 1e-3, 80)
        lines += [
            (f"d/P{index} 1", name, t, f, 10.0 * x, 10.0)
            for t, f, x in zip(times, forces, strains, strict=True)
        ]
    folder = tmp_path_factory.mktemp("measured")
    with (folder / "tests.csv").open("w", newline="") as file:
        header = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
        csv.writer(file).writerows([header, *lines])
    return folder


def test_measured_tests_of_two_materials_are_told_apart(tables):
    assert told(read_tests(tables))["beef | silicone: errors"] == Share(0, 12)


def test_rest_of_a_hold_is_predicted_beside_the_peers(tables, tmp_path, capsys):
    figures = benchmark(capsys, tmp_path, "real", tables, "--quick")
    beef = figures["materials"]["beef"]
    assert beef["error, median"] < 1.0 and beef["in 95 %"] > 0.8
    assert next(iter(figures["others, beef"])) == "FDEN"


def test_interval_score_is_the_width_and_what_lies_beyond():
    times = np.linspace(0.0, 5.0, 501)
    depth = 1e-3 * np.minimum(times, 1.0)
    test = Measured("1 a", "beef_x", times, np.full(501, 2.0), depth, 0.02)
    count = 501 - test.seen
    sd = np.full(count, 0.1 / 1.959964)
    near = real.Outcome(test, np.full(count, 2.05), sd, None, None, None, 0.3)
    far = replace(near, predicted=np.full(count, 2.2))
    assert near.inside.all() and not far.inside.any()
    assert near.score == pytest.approx(100.0 * 0.2 / 2.0)
    assert far.score == pytest.approx(100.0 * (0.2 + 40.0 * 0.1) / 2.0)
    assert near.inside_at(0.5) == 1.0 and math.isnan(near.inside_at(60.0))


def test_a_hold_shows_its_order_whatever_the_curve():
    times = np.arange(0.0, 12.0, 0.1)
    strain = 0.08 * np.minimum(times, 4.0)
    for characteristic in (np.square, np.sin, lambda x: np.expm1(9.0 * x)):
        steps = np.diff(characteristic(strain)) / np.diff(times)
        since = np.maximum(times[:, None] - times, 0.0) ** 0.7
        forces = (since[:, :-1] - since[:, 1:]) @ steps
        test = Measured("a", "b", times, forces, 0.02 * strain, 0.02)
        assert hold_order(test) == pytest.approx(0.3, abs=0.005)


# Invariance


def test_records_are_changed_in_what_should_not_matter_and_in_nothing_else():
    record = invariance.simulated(0)
    force, moved = record.recording.force, record.recording.displacement
    changed = {name: one.change(record) for name, one in invariance.CHANGES.items()}
    noise = changed["noise of 1 nm"].recording.displacement.value - moved.value
    assert 0.8e-9 < noise.std() < 1.2e-9
    shifted = changed["stamps shifted"].recording
    by = shifted.force.stamp_ns - force.stamp_ns
    assert np.ptp(by) == 0 and by[0] > 0
    assert set(shifted.displacement.stamp_ns - moved.stamp_ns) == {by[0]}
    halved = changed["every second sample left out"].recording
    assert halved.force.value.size == -(-force.value.size // 2)
    assert changed["period of 50 ms"].parameters["estimate.period"] == 0.05
    names = {invariance.simulated(number).recording.truth["scenario"] for number in range(8)}
    assert len(names) == 8


def test_moves_are_in_the_deviations_that_the_record_states():
    none = {name: np.zeros(3) for name in (*invariance.CHANGES, invariance.LIVE)}
    far = none | {"noise of 1 nm": np.array([0.0, 3.0, 0.0])}
    goals = {goal.name: goal.met for goal in invariance.goals_of([none, none, far])}
    assert goals["noise of 1 nm: largest move"] is False
    assert goals["stamps shifted: largest move"] is True
    row = invariance.row_of([moves["noise of 1 nm"] for moves in (none, none, far)])
    assert row["largest"][1] == 3.0 and row["beyond 1"] == Share(1, 3)


def test_shifted_stamps_move_nothing(tmp_path, capsys):
    figures = benchmark(capsys, tmp_path, "invariance", "--contacts", 1, "--jobs", 1)
    rows = figures["changes"]
    assert max(rows["stamps shifted"]["largest"]) < 1e-3
    assert rows["noise of 1 nm"]["records"] == 1
