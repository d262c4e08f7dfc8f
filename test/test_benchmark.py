# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What all benchmarks share: command, arguments, goals, tables, picture, scores, the bound."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmark import BENCHMARKS
from benchmark.accuracy import Trial, ratio_of
from benchmark.bound import bounds, contact_bounds, slope
from benchmark.harness import Goal, Report, Table, by_case, few, within, words_of
from benchmark.peers import PEERS, Samples
from benchmark.picture import Curve, draw
from benchmark.score import Judged, Outcome, Share, figures_of
from fden_ros.cli import main
from fden_ros.core.estimation.estimate import Estimate, ParameterSet
from fden_ros.core.outputs import Flag
from fden_ros.simulation.closed_form import FdenModel, LinearMove

DEVIATION = np.array([0.01, 0.01, 0.002])


def judged(error=(0.0, 0.0, 0.0), *, flags=Flag.NONE, converged=True, number=0, sd=DEVIATION):
    everything = ParameterSet.ALL
    spread = np.diag(np.square(sd))
    estimate = Estimate(0.0, 2.0, 0.2, spread, 0, 0, 1, everything, everything, 100)
    return Judged(converged, flags, np.array(error), np.array(sd), number, estimate)


def outcome(*contacts, presses=1, wrong=0, live=Flag.NONE):
    return Outcome(presses, contacts, Share(wrong, 10), live, DEVIATION)


# The command


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


def test_without_a_checkout_one_line_says_that_it_needs_one(tmp_path):
    code = (
        "import fden_ros; fden_ros.__file__ = '/nowhere/fden_ros/__init__.py'; "
        "from fden_ros.cli import main; raise SystemExit(main(['benchmark', 'real', '--quick']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "need a checkout" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("robots", "--cases", "frictio"), "there is no case 'frictio'"),
        (("laws", "--cases", ","), "no case is named"),
        (("changes", "--contacts", "0"), "at least 1"),
        (("exact", "--first", "-1"), "not negative"),
        (("accuracy", "--cases", "magic"), "there is no case 'magic'"),
        (("robots", "--parameters", "nowhere.yaml"), "cannot read the parameter file"),
        (("robots", "--ratio", "-1"), "must be positive"),
        (("real", "nowhere"), "no such folder"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


# Goals, tables, picture


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


def test_small_share_is_shown_by_many_and_not_by_few():
    assert few("silent", Share(0, 100), 1e-3).met is None
    assert few("silent", Share(0, 10_000), 1e-3).met is True
    assert few("silent", Share(30, 100), 1e-3).met is False
    assert few("silent", Share(0, 0), 1e-3).met is None


def test_report_becomes_plain_json_without_numbers_that_json_lacks():
    rows = {"row": {"array": np.array([1.0, np.nan]), "inf": math.inf, "share": Share(1, 3)}}
    report = Report([Goal("speed", 1.5, "<= 2", True)], {"table": Table("words", rows)})
    text = json.dumps(report.json_object("speed", True), allow_nan=False)
    assert json.loads(text) == {
        "benchmark": "speed",
        "quick": True,
        "goals": [{"name": "speed", "value": 1.5, "goal": "<= 2", "met": True}],
        "figures": {"table": {"row": {"array": [1.0, None], "inf": None, "share": [1, 3]}}},
    }


def test_cells_are_short_words():
    cells = (Share(1, 3), np.array([0.12345, np.nan]), None, 7, "as it is", [1.0, 2.0])
    assert [words_of(cell) for cell in cells] == ["1 of 3", "0.123 –", "–", "7", "as it is", "1 2"]


def test_picture_holds_rows_without_anything(tmp_path):
    rows = {
        "none": {"three": np.full(3, np.nan), "share": Share(0, 0)},
        "some": {
            "three": np.array([1.0, 50.0, 2.0]),
            "share": Share(1, 2),
            "many": list(range(9)),
        },
    }
    times = np.arange(3.0)
    figure = Figure(layout="constrained")
    draw(
        figure,
        [(rows, {"three": (0.6, 1.3), "share": None, "many": None})],
        {"a curve": [Curve("label", times, times, 0.1 * times)]},
    )
    figure.savefig(tmp_path / "some.png")
    assert len(figure.axes) == 6
    assert figure.axes[3].lines and figure.axes[3].get_title() == "a curve"


def _sum(name, number, more):
    return f"{name}{number + more}"


def test_trials_come_in_their_order_whatever_the_number_of_processes():
    tasks = [(name, number) for name in "ab" for number in range(3)]
    expected = {"a": ["a1", "a2", "a3"], "b": ["b1", "b2", "b3"]}
    assert by_case(_sum, tasks, 1, jobs=1) == by_case(_sum, tasks, 1, jobs=2) == expected


# Scores


@pytest.mark.parametrize(
    ("error", "is_off"),
    [
        ((0.04, 0.0, 0.0), False),
        ((0.06, 0.0, 0.0), True),
        ((0.0, -0.06, 0.0), True),
        ((0.0, 0.0, 0.011), True),
        ((0.0, 0.0, 0.009), False),
        ((math.nan,) * 3, False),
    ],
)
def test_error_counts_beyond_five_deviations_and_the_least_size(error, is_off):
    assert judged(error).is_off == is_off
    assert not judged((0.02, 0.0, 0.0), sd=DEVIATION / 10.0).is_off


def test_error_is_silent_unless_something_tells_of_it():
    off = (0.1, 0.0, 0.0)
    assert judged(off).is_silent
    assert judged(off, flags=Flag.INPUT_REJECTED).is_silent
    assert not judged(off, converged=False).is_silent
    for flag in (Flag.MODEL_MISMATCH, Flag.TISSUE_CHANGED, Flag.ORIGIN_UNCERTAIN, Flag.GAP):
        assert not judged(off, flags=flag).is_silent


def test_row_counts_presses_claims_and_contacts():
    off = (0.1, 0.0, 0.0)
    row = figures_of(
        [
            outcome(judged(off), wrong=4),
            outcome(judged((0.01, 0.02, 0.002)), live=Flag.MODEL_MISMATCH),
            outcome(judged(off, flags=Flag.MODEL_MISMATCH), judged(number=-1)),
            outcome(judged(flags=Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED)),
            outcome(),
        ]
    )
    assert (row["silent"], row["live"]) == (Share(1, 5), Share(4, 50))
    assert (row["mismatch"], row["changed"]) == (Share(2, 4), Share(1, 4))
    assert (row["told live"], row["unflagged"]) == (Share(1, 5), Share(2, 4))
    np.testing.assert_allclose(row["error over sd"], np.sqrt([201 / 4, 4 / 4, 1 / 4]))
    np.testing.assert_allclose(row["in 95 %"], [0.5, 0.75, 1.0])
    np.testing.assert_allclose(row["sd"], DEVIATION)


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_error_over_the_bound_is_measured_with_its_interval(scale):
    generator = np.random.default_rng(1)
    bound = np.array([0.005, 0.004, 0.0, 0.0005, 0.1])
    trials = [
        Trial(bound, judged(scale * bound[:3] * generator.standard_normal(3)), 0.0)
        for _ in range(4000)
    ]
    ratio, low, high = ratio_of([*trials, Trial(bound, None, 0.0)], 0)
    assert ratio == pytest.approx(scale, rel=0.05)
    assert low < scale < high
    assert math.isnan(ratio_of(trials, 2)[0])


# The bound


def test_slope_of_a_response_is_its_derivative():
    times = np.linspace(0.0, 1.0, 11)
    found = slope(lambda p: p[0] * times ** p[1], np.array([3.0, 2.0]), 1, 1e-4)
    logarithm = np.log(np.maximum(times, 1e-300))
    np.testing.assert_allclose(found, 3.0 * times**2 * logarithm, atol=1e-7)


def test_bound_joins_data_and_prior_and_leaves_out_what_is_known():
    data = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 1.0], [0.0, 1.0, 3.0]])
    found = bounds(data, np.array([0.5, math.inf, 0.0]))
    expected = np.sqrt(np.linalg.inv(np.array([[8.0, 1.0], [1.0, 2.0]])).diagonal())
    np.testing.assert_allclose(found, [*expected, 0.0], rtol=1e-12)


def test_bound_of_a_ramp_below_the_boundary_strain_is_the_analytic_one():
    # f = G v t^(1-alpha) / Gamma(2-alpha), df/dorigin = -G t^-alpha / Gamma(1-alpha).
    g, alpha, rate, noise, start = 500.0, 0.3, 0.05, 0.2, 1.0
    moves = [LinearMove(0.0, 2.5, -start * rate, 1.5 * rate)]
    stamps = np.arange(0.0025, 2.5, 5e-3)
    prior = np.array([0.3, 0.0, 0.0, math.inf, 0.01])
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


# Estimators of others


@pytest.mark.parametrize(
    ("name", "force"),
    [
        ("last value", lambda x, v: np.full(x.size, 2.0)),
        ("Kelvin-Voigt", lambda x, v: 300.0 * x + 20.0 * v),
        ("Hunt-Crossley", lambda x, v: 3e4 * x**1.5 * (1.0 + 2.0 * v)),
        ("linear fractional", lambda x, v: 250.0 * x),
    ],
)
def test_peer_predicts_what_is_its_own_model(name, force):
    times = np.arange(0.0, 12.0, 0.02)
    depths = 1e-3 + 5e-3 * np.sin(0.3 * times) ** 2 * np.minimum(times, 1.0)
    if name == "linear fractional":
        depths = depths - depths[0]
    nothing = Samples(times, depths, np.zeros_like(times))
    forces = force(depths, nothing.velocities)
    seen, ahead = slice(None, 500), slice(500, None)
    known = Samples(times[seen], depths[seen], forces[seen])
    found = PEERS[name](known, Samples(times[ahead], depths[ahead], forces[ahead]))
    np.testing.assert_allclose(found, forces[ahead], rtol=0.05, atol=0.05 * forces.max())
