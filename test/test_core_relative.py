# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A place against its surroundings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pipeline_helpers import identified, items_of, parameters_of, summaries_of

from fden_ros.core.classification.classifier import likelihood_of
from fden_ros.core.classification.relative import (
    LEAST_SURROUNDINGS,
    compare,
    stack,
    without_prior,
)
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.law.apparent_stiffness import LogStiffness, log_stiffness
from fden_ros.core.outputs import Classification as Answer
from fden_ros.core.outputs import Decision
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    RampHold,
    Scenario,
    Site,
    Tissue,
)
from fden_ros.simulation.simulate import simulate
from fden_ros.simulation.trajectory import Approach


def place(value, sd=0.0):
    return LogStiffness(np.array(value), np.array(sd**2))


def around(values, sd=0.0):
    values = np.asarray(values, dtype=float)
    return LogStiffness(values, np.full(values.size, sd**2))


def drawn(rng, *, natural=0.1, sd=0.05, count=30, ratio=1.0):
    own = rng.normal(0.0, natural, count) + rng.normal(0.0, sd, count)
    mine = math.log(ratio) + rng.normal(0.0, sd)
    return place(mine, sd), around(own, sd)


@pytest.mark.parametrize("strain", [0.05, 0.2])
def test_error_of_log_stiffness_is_that_of_drawn_parameters(strain):
    rng = np.random.default_rng(0)
    mean = np.array([6.0, 2.0, 0.2])
    covariance = np.array([[4e-4, -1e-4, 1e-5], [-1e-4, 4e-4, 0.0], [1e-5, 0.0, 1e-5]])
    draws = rng.multivariate_normal(mean, covariance, 100_000)
    scatter = np.std(log_stiffness(draws, np.zeros((100_000, 3, 3)), strain, 0.1).value)
    found = math.sqrt(float(log_stiffness(mean, covariance, strain, 0.1).variance))
    assert found == pytest.approx(scatter, rel=0.02)


def test_ratio_and_interval_hold_the_truth():
    rng = np.random.default_rng(1)
    inside, ratios = 0, []
    for _ in range(600):
        compared = compare(*drawn(rng, ratio=2.0))
        low, high = compared.interval()
        inside += low <= 2.0 <= high
        ratios.append(compared.log_ratio)
    assert math.exp(np.mean(ratios)) == pytest.approx(2.0, rel=0.02)
    # Of 95 %: four standard deviations of 600 trials, and a share taken for something else.
    assert 0.91 < inside / 600 < 0.98


def test_probability_of_being_stiffer_is_calibrated():
    rng = np.random.default_rng(2)
    said, right = [], []
    for _ in range(1000):
        ratio = math.exp(rng.normal(math.log(1.5), 0.15))
        compared = compare(*drawn(rng, sd=0.1, natural=0.05, ratio=ratio))
        # The prior of the ratio is not flat: only its own width times wider errors see that.
        said.append(compared.probability_stiffer(1.5))
        right.append(ratio > 1.5)
    said, right = np.array(said), np.array(right)
    sure = said > 0.9
    assert np.mean(right[sure]) > 0.85
    assert np.mean(right[said < 0.1]) < 0.15
    assert abs(np.mean(said) - np.mean(right)) < 0.03


def test_lesions_among_the_surroundings_do_not_hide_a_lesion():
    rng = np.random.default_rng(4)
    healthy = rng.normal(0.0, 0.1, 24)
    lesions = rng.normal(math.log(4.0), 0.1, 8)
    compared = compare(place(math.log(4.0), 0.02), around([*healthy, *lesions], 0.02))
    assert compared.ratio == pytest.approx(4.0, rel=0.12)
    assert compared.count == pytest.approx(24.0, abs=4.0)
    assert compared.deviations > 6.0


def test_too_few_surroundings_make_no_comparison():
    assert compare(place(0.0), around([0.0] * (LEAST_SURROUNDINGS - 1))) is None
    assert compare(place(0.0), stack([])) is None
    assert compare(place(0.0, 0.1), around([0.0] * LEAST_SURROUNDINGS)) is not None


def test_answers_are_probabilities_of_softer_alike_stiffer():
    compared = compare(place(math.log(0.5), 0.05), around([0.0, 0.05, -0.05, 0.02, -0.02], 0.02))
    answer = compared.classes(1.5)
    assert answer.label == "softer"
    assert math.fsum(answer.probabilities) == pytest.approx(1.0)
    assert answer.names == ("softer", "alike", "stiffer")


def test_prior_of_the_estimator_does_not_draw_the_ratio_to_one():
    prior = Prior(500.0, 0.3, 8.0, 0.2, 0.15, 0.02)
    before = np.diag(np.square([0.3, 0.2, 0.02]))
    data = np.diag(np.square([0.3, 0.2, 0.02]))
    truth = np.array([math.log(2000.0), math.log(8.0), 0.15])
    centre = np.array([math.log(500.0), math.log(8.0), 0.15])
    covariance = np.linalg.inv(np.linalg.inv(before) + np.linalg.inv(data))
    mean = covariance @ (np.linalg.solve(before, centre) + np.linalg.solve(data, truth))
    own = without_prior(likelihood_of(mean, covariance, prior))
    assert own is not None
    np.testing.assert_allclose(own[0], truth, atol=1e-9)
    assert without_prior(likelihood_of(centre, before, prior)) is None


def six_sites(last):
    press = RampHold(strain_rate=0.4, max_strain=0.22, hold_s=0.3)
    stiffness = [500.0, 540.0, 460.0, 520.0, 490.0, last]
    return Scenario(
        name="row",
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        approach=Approach(
            distance_m=0.002, slow_distance_m=0.001, start_pause_s=1.0, site_pause_s=0.5
        ),
        sites=tuple(
            Site(Tissue(g, 8.0, 0.13), (press,), position_m=(0.01 * i, 0.0))
            for i, g in enumerate(stiffness)
        ),
        force=ForceSensor(rate_hz=200.0, noise_stress_pa=3.0),
        displacement=DisplacementSensor(rate_hz=200.0, message="pose"),
    )


def test_pipeline_tells_the_stiff_site_from_those_before_it():
    recording = simulate(six_sites(1500.0), 1)
    own = {"classification.mode": "relative", "prior.linear_stiffness_log_sd": 1.0}
    _, outputs = identified(items_of(recording), parameters_of(recording) | own)
    summaries = summaries_of(outputs)
    assert len(summaries) == 6
    # The first four have too few before them.
    assert [summary.classes is None for summary in summaries] == [True] * 4 + [False] * 2
    assert summaries[4].classes.label == "alike"
    assert summaries[5].classes.label == "stiffer"
    low, high = summaries[5].comparison.interval()
    assert low < 3.0 < high and high / low < 2.0
    answers = [output for output in outputs if isinstance(output, Answer)]
    assert answers[-1].decision is Decision.CLASS
    assert answers[-1].library_name == ""
    assert answers[-1].decided.strain > 0.12
