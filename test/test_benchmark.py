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

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from fden_ros.benchmarks import BENCHMARKS, Goal, Report, within
from fden_ros.benchmarks.accuracy import CASES, METHODS, measure
from fden_ros.benchmarks.appendix_d import identify
from fden_ros.benchmarks.bound import PriorDeviations, bounds, contact_bounds, slope
from fden_ros.benchmarks.simulated import MODEL_ERROR_LEARNED, STRESS, Outcome, Trial, run_trial
from fden_ros.cli import main
from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.simulation.closed_form import FdenModel, LinearMove

# The framework


def test_every_benchmark_is_listed_and_explains_itself(capsys):
    for name in BENCHMARKS:
        with pytest.raises(SystemExit) as ended:
            main(["benchmark", name, "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        assert "--quick" in shown and "--json" in shown and f"fden benchmark {name}" in shown


def test_unknown_benchmark_is_wrong_usage_and_names_the_right_ones(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "speed_of_light"])
    assert ended.value.code == 2
    assert "accuracy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "limits", "interval", "met"),
    [
        (1.05, (-math.inf, 1.1), None, True),
        (1.15, (-math.inf, 1.1), None, False),
        (1.05, (-math.inf, 1.1), (0.9, 1.2), None),
        (1.05, (-math.inf, 1.1), (1.0, 1.09), True),
        (0.7, (0.9, 1.1), (0.6, 0.8), False),
        (0.95, (0.9, math.inf), (0.91, 0.99), True),
        (math.nan, (0.9, 1.1), None, None),
    ],
)
def test_goal_is_met_missed_or_undecided_by_its_interval(value, limits, interval, met):
    goal = within("figure", value, limits, interval)
    assert goal.met is met
    assert goal.value is None if math.isnan(value) else goal.value == value


def test_report_becomes_plain_json_without_numbers_that_json_lacks():
    report = Report(
        goals=[Goal("speed", 1.5, "<= 2", True)],
        figures={"array": np.array([1.0, np.nan]), "inf": math.inf, "whole": np.int64(3)},
        draw=lambda figure: None,
    )
    text = json.dumps(report.json_object("speed", True), allow_nan=False)
    assert json.loads(text) == {
        "benchmark": "speed",
        "quick": True,
        "goals": [{"name": "speed", "value": 1.5, "goal": "<= 2", "met": True}],
        "figures": {"array": [1.0, None], "inf": None, "whole": 3},
    }


# The bound


def test_slope_of_a_response_is_its_derivative():
    times = np.linspace(0.0, 1.0, 11)

    def response(parameters):
        return parameters[0] * times ** parameters[1]

    found = slope(response, np.array([3.0, 2.0]), 1, 1e-4)
    logarithm = np.log(np.maximum(times, 1e-300))
    np.testing.assert_allclose(found, 3.0 * times**2 * logarithm, atol=1e-7)


def test_bound_joins_data_and_prior_and_leaves_out_what_is_known():
    data = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 1.0], [0.0, 1.0, 3.0]])
    found = bounds(data, np.array([0.5, math.inf, 0.0]))
    total = np.array([[8.0, 1.0], [1.0, 2.0]])
    expected = np.sqrt(np.linalg.inv(total).diagonal())
    np.testing.assert_allclose(found, [*expected, 0.0], rtol=1e-12)


def test_bound_of_a_ramp_below_the_boundary_strain_is_the_analytic_one():
    # f = G v t^(1-alpha) / Gamma(2-alpha), df/dorigin = -G t^-alpha / Gamma(1-alpha).
    g, alpha, rate, noise, start = 500.0, 0.3, 0.05, 0.2, 1.0
    moves = [LinearMove(0.0, 2.5, -start * rate, 1.5 * rate)]
    stamps = np.arange(0.0025, 2.5, 5e-3)
    prior = PriorDeviations(log_g=0.3, log_gn=0.0, alpha=0.0, origin=math.inf, bias=0.01)
    found = contact_bounds(moves, FdenModel(g, 5.0, alpha), stamps, noise, prior)

    elapsed = stamps[stamps > start] - start
    rows = np.array(
        [
            g * rate * elapsed ** (1.0 - alpha) / math.gamma(2.0 - alpha),
            -g * elapsed**-alpha / math.gamma(1.0 - alpha),
            np.ones_like(elapsed),
        ]
    )
    total = rows @ rows.T / noise**2 + np.diag([0.3**-2, 0.0, 0.01**-2])
    expected = np.sqrt(np.linalg.inv(total).diagonal())
    # The derivative by the origin is singular at the touch: differences see it blunted.
    np.testing.assert_allclose(found[[0, 3, 4]], expected, rtol=0.01)
    assert found[1] == found[2] == 0.0


# Figures


def trials_with_errors(scale, *, claimed=1.0, count=4000):
    """Trials whose errors are `scale` times the bound, with deviations `claimed` times it."""
    generator = np.random.default_rng(1)
    bound = np.array([0.005, 0.004, 0.0, 0.0005, 0.1])
    outcomes = [
        Outcome(
            found=True,
            converged=True,
            learned=False,
            time_to_converge=0.2,
            error=scale * bound[:4] * generator.standard_normal(4),
            covariance=np.diag((claimed * bound[:3]) ** 2),
            origin_sd=claimed * bound[3],
        )
        for _ in range(count)
    ]
    model = FdenModel(500.0, 8.0, 0.13)
    return [Trial(seed, model, bound, {STRESS: o}) for seed, o in enumerate(outcomes)]


def test_efficient_and_honest_estimator_measures_as_such():
    measured = measure(CASES[0], trials_with_errors(1.0), STRESS)
    for name in ("log_g", "log_gn", "origin"):
        assert measured.ratio[name].value == pytest.approx(1.0, abs=0.05)
        assert measured.coverage[name].value == pytest.approx(0.95, abs=0.015)
        assert measured.ratio[name].low < 1.0 < measured.ratio[name].high
    assert measured.nees.value == pytest.approx(1.0, abs=0.06)
    assert (measured.failures, measured.wild) == (0.0, 0)


def test_estimator_that_claims_too_much_is_found_out():
    measured = measure(CASES[0], trials_with_errors(3.0, claimed=0.75), STRESS)
    assert measured.ratio["log_g"].value == pytest.approx(3.0, rel=0.05)
    assert measured.nees.value == pytest.approx(16.0, rel=0.1)
    assert measured.coverage["log_g"].value < 0.5
    assert measured.wild > 100


def test_contacts_without_an_estimate_count_as_failures():
    trials = trials_with_errors(1.0, count=10)
    lost = trials[0].outcomes[STRESS]._replace(found=False, converged=False)
    trials[0] = trials[0]._replace(outcomes={STRESS: lost})
    measured = measure(CASES[0], trials, STRESS)
    assert measured.failures == pytest.approx(0.1)
    assert measured.converged == pytest.approx(0.9)


# The paper's filter


def test_a_site_pressed_before_goes_on_where_noise_hides_the_surface():
    # In the tenth press of this recording the detector does not see the touch.
    (case,) = (c for c in CASES if c.name == "ten_palpations")
    outcome = run_trial(case, 8, (STRESS,)).outcomes[STRESS]
    assert outcome.found and outcome.converged
    assert np.all(np.abs(outcome.error[:2]) < 0.02)


def test_appendix_d_identifies_a_clean_ramp():
    model = FdenModel(500.0, 8.0, 0.13)
    strain = np.linspace(0.005, 0.25, 50)
    found = identify(strain, model.phi(strain), np.full(50, 0.1), Prior())
    assert found is not None
    np.testing.assert_allclose(found[0], np.log([500.0, 8.0]), atol=0.01)


def test_appendix_d_breaks_down_where_the_start_is_lost_in_noise():
    model = FdenModel(500.0, 8.0, 0.13)
    generator = np.random.default_rng(3)
    strain = np.linspace(0.001, 0.25, 250)
    found = 0
    for _ in range(40):
        noisy = model.phi(strain) + 2.0 * generator.standard_normal(250)
        state = identify(strain, noisy, np.full(250, 2.0), Prior())
        found += state is not None and bool(np.all(np.abs(state[0] - np.log([500, 8])) < 0.05))
    assert found < 20


# The whole benchmark


def benchmark(capsys, *arguments):
    assert main(["benchmark", "accuracy", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_tiny_run_measures_goals_and_leaves_figures_and_picture(tmp_path, capsys):
    tiny = ("--quick", "--cases", "ten_samples", "--contacts", 3, "--workers", 1)
    shown = json.loads(benchmark(capsys, *tiny, "--json", "-o", tmp_path))
    assert shown == json.loads((tmp_path / "accuracy.json").read_text())
    assert (tmp_path / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert all(set(goal) == {"name", "value", "goal", "met"} for goal in shown["goals"])
    names = [goal["name"] for goal in shown["goals"]]
    assert len(set(names)) == len(names)
    (case,) = shown["figures"]["cases"]
    assert set(case["methods"]) == set(METHODS)
    stress = case["methods"]["stress"]
    # The scale of the model's error is learned: ten samples do not rule it out.
    assert case["methods"][MODEL_ERROR_LEARNED]["ratio"]["log_g"] != stress["ratio"]["log_g"]
    assert stress["failures"] == 0.0
    assert stress["ratio"]["log_g"]["low"] <= stress["ratio"]["log_g"]["value"]
    # Nothing was pressed with alpha unknown.
    (learned,) = (goal for goal in shown["goals"] if goal["name"].endswith("|bias of alpha|"))
    assert learned["value"] is None and learned["met"] is None


def test_figures_do_not_depend_on_the_number_of_workers(tmp_path, capsys):
    tiny = ("--cases", "ten_samples", "--contacts", 4, "--methods", "stress", "--json")
    one = benchmark(capsys, *tiny, "--workers", 1, "-o", tmp_path / "one")
    two = benchmark(capsys, *tiny, "--workers", 2, "-o", tmp_path / "two")
    assert one == two


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--cases", "rampp"), "there is no case 'rampp'"),
        (("--methods", "magic"), "there is no method 'magic'"),
        (("--contacts", "1"), "at least 2"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", "accuracy", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_tables_and_pictures_hold_estimators_that_never_answer(tmp_path):
    from fden_ros.benchmarks.accuracy import CaseResult, _draw, _table

    trials = trials_with_errors(1.0, count=3)
    lost = [
        t._replace(outcomes={STRESS: t.outcomes[STRESS]._replace(found=False)}) for t in trials
    ]
    result = CaseResult(CASES[0], {STRESS: measure(CASES[0], lost, STRESS)}, 3)
    assert _table([result], STRESS).row_count == 1
    figure = Figure(layout="constrained")
    _draw(figure, [result])
    figure.savefig(tmp_path / "empty.png")


def test_a_hold_shows_its_order_whatever_the_curve():
    from fden_ros.benchmarks.hold_order import hold_order

    times = np.arange(0.0, 12.0, 0.1)
    strain = 0.08 * np.minimum(times, 4.0)
    for characteristic in (np.square, np.sin, lambda x: np.expm1(9.0 * x)):
        steps = np.diff(characteristic(strain)) / np.diff(times)
        since = np.maximum(times[:, None] - times, 0.0) ** 0.7
        forces = (since[:, :-1] - since[:, 1:]) @ steps
        found = hold_order(times, forces, 40)
        assert found.order == pytest.approx(0.3, abs=0.005) and found.misfit < 1e-3


def test_a_hold_beside_a_spring_shows_the_order_of_what_relaxes():
    from fden_ros.benchmarks.hold_order import hold_order, hold_order_beside_spring

    times = np.arange(0.0, 12.0, 0.1)
    response = np.expm1(9.0 * 0.08 * np.minimum(times, 4.0))
    since = np.maximum(times[:, None] - times, 0.0) ** 0.55
    relaxing = (since[:, :-1] - since[:, 1:]) @ (np.diff(response) / np.diff(times))
    forces = relaxing / math.gamma(1.55) + 0.2 * response
    found = hold_order_beside_spring(times, forces, 40)
    assert found.order == pytest.approx(0.45, abs=0.03)
    assert found.spring == pytest.approx(0.2, abs=0.04) and found.misfit < 1e-3
    alone = hold_order(times, forces, 40)
    assert alone.order < 0.4 and alone.misfit > 2.0 * found.misfit


def test_figures_of_measured_tissue_have_the_same_keys_for_every_method():
    from fden_ros.benchmarks import measured_tests, real
    from fden_ros.core.estimation.estimate import Estimate

    times = np.linspace(0.0, 5.0, 501)
    depth = np.minimum(times, 1.0) * 1e-3
    tests = [
        measured_tests.Test(f"{n} a", "beef_x", times, 1.0 + depth, depth, thickness=0.02)
        for n in "12"
    ]
    everything = ParameterSet.ALL
    covariance = np.diag([0.01, 0.01, 1e-4])
    estimate = Estimate(0.0, 2.0, 0.2, covariance, 0, 0, 1, everything, everything, 100)
    made = [
        real.Outcome(
            np.ones(2),
            np.ones(2),
            error,
            coverage,
            mismatch,
            False,
            True,
            5.0,
            np.ones(3),
            estimate,
            order_off=2.0,
            knows_order=True,
            relaxation_off=1.0,
            knows_relaxation=True,
        )
        for error, coverage, mismatch in ((1.0, 0.9, True), (3.0, 1.0, False))
    ]
    outcomes = {real.FREE: {t.name: o for t, o in zip(tests, made, strict=True)}}
    errors = {
        real.FREE: {t.name: o.error for t, o in zip(tests, made, strict=True)},
        "last value": {t.name: 4.0 for t in tests},
    }
    figures = real._figures(tests, outcomes, errors, (0, 20))
    report = Report(goals=(), figures=figures, draw=lambda figure: None)
    methods = report.json_object("real", True)["figures"]["methods"]["beef"]
    own, other = methods[real.FREE], methods["last value"]
    wanted = {"median": 2.0, "percentile_90": 2.8, "coverage": 0.95, "half_width": 5.0}
    wanted |= {"converged": 1.0, "changed": 0.0, "mismatch": 0.5}
    assert own["order_off"] == pytest.approx(2.0)
    assert own["relaxation_known"] == 1.0
    assert own["relaxation_off"] == pytest.approx(1.0)
    assert {key: own[key] for key in wanted} == pytest.approx(wanted)
    assert {key: other[key] for key in wanted} == dict.fromkeys(wanted) | {
        "median": 4.0,
        "percentile_90": 4.0,
    }
