# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which press to make: what is planned is what the identifier states, within what is allowed."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from pipeline_helpers import identified, items_of, summaries_of

import fden_ros.planning.forecast as forecasting
from benchmark.plan import PARAMETERS, RADIUS_M, THICKNESS_M
from fden_ros.cli import main
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.estimate import Member
from fden_ros.parameters import check, pipeline_config
from fden_ros.planning.forecast import Forecast
from fden_ros.planning.motion import Motion, Sensors, record
from fden_ros.planning.plan import Limits, Search, Target, plan
from fden_ros.planning.tissue import TissueBelief
from simulation.scenario import (
    Approach,
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import simulate
from simulation.trajectory import RampHold

SENSORS = Sensors(rate=500.0, force_sd=0.005, displacement_sd=5e-6)
PRESS = Motion(depth=5e-3, speed=0.02, hold=1.0, release=0.02)
TARGET = Target((0.1, 0.1, math.inf))


def config_of(**more: float) -> PipelineConfig:
    named = {name.replace("__", "."): value for name, value in more.items()}
    return pipeline_config(check({**PARAMETERS, **named}))


CONFIG = config_of()
LIVER = TissueBelief.stated(CONFIG.estimator.prior)


def test_the_expected_deviations_are_those_that_the_identifier_states() -> None:
    tissue = LIVER.draws(1)
    press = RampHold(PRESS.speed / THICKNESS_M, PRESS.depth / THICKNESS_M, PRESS.hold, 1.0)
    g, gn, alpha = math.exp(tissue[0, 0]), math.exp(tissue[0, 1]), float(tissue[0, 2])
    scenario = Scenario(
        seed=1,
        geometry=Geometry(radius_m=RADIUS_M, thickness_m=THICKNESS_M),
        sites=(Site(tissue=Tissue(g, gn, alpha), presses=(press,)),),
        approach=Approach(slow_distance_m=0.005),
        force=ForceSensor(rate_hz=500.0, noise_n=SENSORS.force_sd),
        displacement=DisplacementSensor(rate_hz=500.0, noise_m=5e-6),
    )
    (contact,) = summaries_of(identified(items_of(simulate(scenario)), PARAMETERS)[1])
    assert contact.estimate is not None
    (expected,) = Forecast(CONFIG, SENSORS, LIVER).stated(PRESS, tissue)
    np.testing.assert_allclose(expected.deviations, contact.estimate.deviations, rtol=0.25)


def test_a_part_of_the_scales_stands_for_all(monkeypatch) -> None:
    forecast = Forecast(CONFIG, SENSORS, LIVER)
    tissues = LIVER.draws(3)
    few = np.array([one.deviations for one in forecast.stated(PRESS, tissues)])
    middle = forecasting._thinned

    def whole(grid):
        # The likeliest place first, so that all beside the others are weighed at once.
        return grid, middle(grid)[1]

    monkeypatch.setattr(forecasting, "_thinned", whole)
    every = np.array([one.deviations for one in forecast.stated(PRESS, tissues)])
    np.testing.assert_allclose(few, every, rtol=0.15)


def test_a_press_is_as_short_as_five_percent_allow() -> None:
    search = Search(CONFIG, SENSORS, TARGET)
    chosen = search.plan().motion
    scores = {motion: score for motion, (score, _) in search._found.items()}
    best = min(scores.values())
    assert scores[chosen] <= 1.05 * best
    assert chosen.seconds == min(m.seconds for m, s in scores.items() if s <= 1.05 * best)


def test_no_more_than_five_percent_of_the_tissues_exceed_the_force() -> None:
    limits = replace(Limits.usual(CONFIG), force=0.2)
    found = plan(CONFIG, SENSORS, TARGET, limits)
    assert found.force <= 0.2 * 1.1
    assert found.motion.depth < 0.9 * plan(CONFIG, SENSORS, TARGET).motion.depth


def test_a_swing_in_which_the_tissue_leaves_the_probe_is_excluded() -> None:
    search = Search(CONFIG, SENSORS, TARGET)
    swing = Motion(4e-3, 0.02, 2.0, 0.02, amplitude=0.4, cycles=2)
    assert math.isfinite(search.score(replace(swing, amplitude=0.02)))
    assert search.score(swing) == math.inf


def test_a_motion_that_takes_longer_than_allowed_is_excluded() -> None:
    limits = replace(Limits.usual(CONFIG), time=1.0)
    assert plan(CONFIG, SENSORS, TARGET, limits).motion.seconds <= 1.0


def test_what_is_not_possible_says_what_limits_it() -> None:
    found = plan(CONFIG, SENSORS, Target((0.015, 0.1, math.inf)))
    assert not found.is_possible and found.probability == 0.0
    assert "geometry.thickness_sd" in found.line()
    loud = plan(CONFIG, replace(SENSORS, force_sd=0.2), Target((0.1, 0.06, math.inf)))
    assert not loud.is_possible and "noise" in loud.cause


def test_a_record_of_few_samples_has_the_counts_of_all() -> None:
    points = record(PRESS, CONFIG.geometry, SENSORS, 0.0)
    assert points.counts.sum() == pytest.approx(PRESS.seconds * SENSORS.rate, rel=0.05)


def test_an_order_that_is_given_is_planned_with() -> None:
    known = Member(1.0, LIVER.mean, np.diag([0.09, 0.04, 0.0]))
    given = config_of(alpha__learn=False)
    found = plan(given, SENSORS, TARGET, tissue=TissueBelief((known,)))
    assert found.deviations[2] == pytest.approx(0.03)


def test_sensors_of_any_rate_are_simulated_at_one_that_tells_as_much() -> None:
    fast = Sensors(rate=1e11, force_sd=50.0, displacement_sd=0.05)
    slow = Sensors(rate=1000.0, force_sd=0.005, displacement_sd=5e-6)
    for a, b in ((fast.slower(), slow), (slow.slower(), slow)):
        assert a.rate == b.rate and a.force_sd == pytest.approx(b.force_sd)


def test_draws_have_the_moments_of_all_modes() -> None:
    shallow = Member(0.4, np.array([6.0, 1.0, 0.1]), np.diag([0.01, 0.2, 1e-4]))
    deep = Member(0.6, np.array([6.3, 2.5, 0.2]), np.diag([0.02, 0.01, 1e-4]))
    known = TissueBelief((shallow, deep))
    draws = known.draws(4000)
    np.testing.assert_allclose(draws.mean(axis=0), known.mean, atol=0.01)
    np.testing.assert_allclose(np.cov(draws.T), known.covariance, atol=0.01)


def test_what_a_press_has_told_narrows_the_next_plan() -> None:
    narrow = Member(1.0, LIVER.mean, 0.05 * LIVER.covariance)
    first = plan(CONFIG, SENSORS, TARGET)
    second = plan(CONFIG, SENSORS, TARGET, tissue=TissueBelief((narrow,)))
    assert np.all(second.deviations < first.deviations)


@pytest.fixture
def probe(tmp_path):
    path = tmp_path / "probe.yaml"
    path.write_text(
        "# force noise: 0.002 ± 3.2e-05 N; at rest\n# force rate: 200 Hz; jitter\n"
        "/**:\n  ros__parameters:\n    geometry: {kind: flat_punch, area: 1.26e-3, "
        "thickness: 0.02}\n",
        encoding="utf-8",
    )
    return path


def test_the_command_plans_from_what_configure_has_written(probe, tmp_path, capsys) -> None:
    picture = tmp_path / "plan.png"
    arguments = ["plan", "--config", str(probe), "--config", "config/priors/liver.yaml"]
    assert main([*arguments, "--target", "G=0.2,Gn=0.2", "--json", "--plot", str(picture)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["possible"] and found["presses"] == 1
    assert found["line"].startswith("press to ")
    assert picture.stat().st_size > 10_000
    assert main([*arguments, "--target", "G=0.001"]) == 3
    assert capsys.readouterr().out.startswith("not possible: ")


def test_the_command_goes_on_from_results(probe, tmp_path, capsys) -> None:
    results = tmp_path / "press.json"
    replayed = ["replay", "examples/press.csv", "--config", "examples/probe.yaml", "--json"]
    assert main(replayed) == 0
    results.write_text(capsys.readouterr().out, encoding="utf-8")
    modes = json.loads(results.read_text(encoding="utf-8"))["contacts"][-1]["modes"]
    assert sum(mode["weight"] for mode in modes) == pytest.approx(1.0)
    assert main(["plan", "--config", str(probe), "--after", str(results), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["deviations"]["g_n"] < 0.1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--config", "examples/probe.yaml"], "state --noise"),
        (["--noise", "0.01", "--rate", "100"], "state probe and tissue"),
        (["--config", "examples/probe.yaml", "--after", "nothing.json"], "cannot be read"),
    ],
)
def test_what_is_missing_is_said_in_a_line(arguments, words, capsys) -> None:
    assert main(["plan", *arguments]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_a_target_that_is_none_is_wrong_usage(capsys) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["plan", "--target", "stiffness=0.1"])
    assert exit_.value.code == 2
