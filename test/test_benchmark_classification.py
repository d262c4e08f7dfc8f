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

"""The classification benchmark: its parts, and the whole in little."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from scipy.special import ndtr

from fden_ros.benchmarks import classification, tissue_classes
from fden_ros.benchmarks.lesions import (
    CONTRASTS,
    comparisons,
    drawn_estimates,
    make_grid,
    roc,
)
from fden_ros.benchmarks.measured_tests import Test as MeasuredTest
from fden_ros.benchmarks.populations import (
    PRIOR,
    bayes_error,
    calibration_error,
    classwise_error,
    draw,
    draw_likelihood,
    population,
    press,
    published,
)
from fden_ros.benchmarks.real_classes import specimen_of
from fden_ros.cli import main
from fden_ros.core.classification.classifier import Tissue, TissueLibrary

PRECISION = np.array([np.diag([1e3, 2e3, 5e4]), np.diag([200.0, 500.0, 1.0])])


def test_bayes_error_of_two_normals_is_the_analytic_one():
    spread = np.diag([0.04, 0.04, 1e-4])
    known = np.diag([100.0, 100.0, 1e5])[None]
    distance = 0.6
    two = TissueLibrary(
        "two",
        tuple(
            Tissue(name, np.array([m, 0.0, 0.0]), spread)
            for name, m in (("a", 0.0), ("b", distance))
        ),
        Tissue("unknown", np.zeros(3), np.eye(3)),
    )
    value, error = bayes_error(two, known, 2048, 8)
    expected = float(ndtr(-0.5 * distance / math.sqrt(0.04 + 0.01)))
    assert error < 1e-3
    assert value == pytest.approx(expected, abs=4.0 * error + 1e-4)


def test_calibration_error_is_none_for_honest_and_found_for_boasting():
    rng = np.random.default_rng(0)
    p = rng.uniform(0.5, 1.0, 40_000)
    truth = (rng.random(40_000) > p).astype(int)
    honest = np.stack([p, 1.0 - p], axis=1)
    assert calibration_error(honest, truth)[0] < 0.01
    assert classwise_error(honest, truth) < 0.01
    boast = np.stack([np.minimum(p + 0.2, 1.0), np.maximum(0.8 - p, 0.0)], axis=1)
    assert calibration_error(boast, truth)[0] == pytest.approx(0.16, abs=0.05)


def test_drawn_likelihoods_are_about_the_truth():
    rng = np.random.default_rng(1)
    value = np.broadcast_to([6.0, 2.0, 0.1], (20_000, 3))
    information = np.broadcast_to(PRECISION[0], (20_000, 3, 3))
    drawn = draw_likelihood(value, information, rng)
    peaks = drawn.centre + drawn.score @ np.linalg.inv(PRECISION[0])
    np.testing.assert_allclose(peaks.std(axis=0), np.diag(PRECISION[0]) ** -0.5, rtol=0.03)
    # The published estimate is drawn towards the prior where little is known.
    blind = draw_likelihood(value, np.zeros((20_000, 3, 3)), rng)
    assert published(blind)[0, 2] == pytest.approx(PRIOR.fractional_order)


def test_pipeline_and_drawn_contacts_agree_on_one_tissue():
    library = population()
    pressed = [press(library, library.tissues[1].mean, 1, seed, kind=1) for seed in range(4)]
    assert all(one.estimate is not None for one in pressed)
    assert any(one.track for one in pressed)
    for one in pressed:
        error = np.array([one.estimate[i] for i in range(3)]) - one.value
        assert np.all(np.abs(error) < 5.0 * np.sqrt(np.diag(one.estimate.covariance)))


def test_population_draws_its_shares():
    rng = np.random.default_rng(2)
    drawn = draw(population(), PRECISION, 20_000, rng)
    assert np.mean(drawn.truth == 4) == pytest.approx(0.1, abs=0.01)


def test_area_under_the_curve_is_the_probability_of_the_right_order():
    rng = np.random.default_rng(3)
    positive = np.arange(600) < 200
    scores = rng.normal(size=600) + positive
    false, true, area = roc(scores, positive)
    pairs = scores[positive][:, None] > scores[~positive]
    assert area == pytest.approx(np.mean(pairs))
    assert (false[0], true[0], false[-1], true[-1]) == (0.0, 0.0, 1.0, 1.0)


def test_grid_has_an_inclusion_of_every_contrast_and_size():
    grid = make_grid(np.random.default_rng(4))
    assert len(grid.positions) == 400
    assert sorted({one.contrast for one in grid.inclusions}) == list(CONTRASTS)
    assert len(grid.inclusions) == 9
    assert np.all(grid.log_ratio[grid.inside < 0] == 0.0)
    compared = comparisons(grid, drawn_estimates(grid, PRECISION[:1], np.random.default_rng(5)))
    hard = [c.ratio for c, g in zip(compared, grid.log_ratio, strict=True) if g == math.log(4.0)]
    assert 2.5 < np.median(hard) < 5.5


def test_foreign_class_is_five_deviations_from_the_nearest():
    truth, rng = population(), np.random.default_rng(6)
    for number in range(8):
        one = tissue_classes.far_class(truth, rng, number)
        distances = [
            math.sqrt((one.mean - t.mean) @ np.linalg.solve(t.covariance, one.mean - t.mean))
            for t in truth.tissues
        ]
        assert min(distances) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("name", "piece"),
    [("day/FF1 2C", "day/FF1"), ("day/P002-laser-3", "day/P002-laser")],
)
def test_specimen_is_the_piece_of_material(name, piece):
    test = MeasuredTest(name, "beef", np.zeros(1), np.zeros(1), np.zeros(1), 0.01)
    assert specimen_of(test) == piece


TINY = classification._Size(8, 3000, 1, (5,), 64, 2, 2, 1, False)


def test_tiny_run_measures_goals_and_leaves_figures_and_picture(tmp_path, capsys, monkeypatch):
    pytest.importorskip("sklearn")
    monkeypatch.setattr(classification, "_QUICK", TINY)
    assert main(["benchmark", "classification", "--quick", "--json", "-o", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads((tmp_path / "classification.json").read_text())
    assert (tmp_path / "classification.png").read_bytes().startswith(b"\x89PNG")
    goals = {goal["name"]: goal for goal in shown["goals"]}
    assert goals["expected calibration error, worst library"]["value"] < 0.05
    assert set(shown["figures"]["peers"]) == {
        "fden_ros",
        "discriminant analysis",
        "Gaussian mixtures",
    }
    assert set(shown["figures"]["lesions"]["roc_area"]) == {"1.5", "2.0", "4.0"}
    assert shown["figures"]["real"] == {}


def test_measured_tests_of_two_materials_are_told_apart(tmp_path):
    # Two materials like those that were measured: soft and slow, stiff and quick.
    from fden_ros.benchmarks.measured_tests import read_tests
    from fden_ros.benchmarks.real_classes import ONLINE, tell
    from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain

    rng = np.random.default_rng(7)
    lines = []
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
    with (tmp_path / "tests.csv").open("w", newline="") as file:
        header = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
        csv.writer(file).writerows([header, *lines])
    told = tell(read_tests(tmp_path), lambda: None)
    assert len(told) == 5
    assert told[ONLINE].kinds.errors.sum() == 0
    assert told[ONLINE].kinds.confusion()[:, :2].sum() >= 10
