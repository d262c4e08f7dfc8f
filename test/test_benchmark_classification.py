# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The classification benchmark: its parts, and the whole in little."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.special import ndtr

from benchmark import classification, populations
from benchmark.lesions import (
    CONTRASTS,
    comparisons,
    drawn_estimates,
    make_grid,
    rows_of,
)
from fden_ros.cli import main
from fden_ros.core.classification.classifier import Tissue, TissueLibrary

PRECISION = np.array([np.diag([1e3, 2e3, 5e4]), np.diag([200.0, 500.0, 1.0])])


def test_bayes_error_of_two_normals_is_the_analytic_one():
    spread, distance = np.diag([0.04, 0.04, 1e-4]), 0.6
    known = np.diag([100.0, 100.0, 1e5])[None]
    tissues = [Tissue(f"{m}", np.array([m, 0.0, 0.0]), spread) for m in (0.0, distance)]
    two = TissueLibrary("two", tuple(tissues), Tissue("unknown", np.zeros(3), np.eye(3)))
    drawn = populations.draw(two, known, 40_000, np.random.default_rng(3), with_unknown=False)
    doubts = 1.0 - populations.closed_set(two, drawn.likelihood).max(axis=1)
    expected = float(ndtr(-0.5 * distance / math.sqrt(0.04 + 0.01)))
    assert doubts.mean() == pytest.approx(expected, abs=4.0 * doubts.std() / 200.0)


def test_calibration_error_is_none_for_honest_and_found_for_boasting():
    rng = np.random.default_rng(0)
    p = rng.uniform(0.5, 1.0, 40_000)
    truth = (rng.random(40_000) > p).astype(int)
    honest = np.stack([p, 1.0 - p], axis=1)
    assert populations.calibration_error(honest, truth) < 0.01
    boast = np.stack([np.minimum(p + 0.2, 1.0), np.maximum(0.8 - p, 0.0)], axis=1)
    assert populations.calibration_error(boast, truth) == pytest.approx(0.16, abs=0.05)


def test_drawn_likelihoods_are_about_the_truth():
    rng = np.random.default_rng(1)
    value = np.broadcast_to([6.0, 2.0, 0.1], (20_000, 3))
    drawn = populations.draw_likelihood(value, PRECISION[:1], rng)
    peaks = drawn.centre + drawn.score @ np.linalg.inv(PRECISION[0])
    np.testing.assert_allclose(peaks.std(axis=0), np.diag(PRECISION[0]) ** -0.5, rtol=0.03)
    # The published estimate is drawn towards the prior where little is known.
    blind = populations.draw_likelihood(value, np.zeros((1, 3, 3)), rng)
    expected = populations.PRIOR.fractional_order
    assert populations.published(blind)[0, 2] == pytest.approx(expected)


def test_pipeline_and_drawn_contacts_agree_on_one_tissue():
    value = populations.population().tissues[1].mean
    for seed in range(4):
        one = populations.press(value, 1, seed, kind=1)
        assert one.estimate is not None
        error = one.estimate.mean - one.value
        assert np.all(np.abs(error) < 5.0 * one.estimate.deviations)


def test_population_draws_its_shares():
    drawn = populations.draw(populations.population(), PRECISION, 20_000, np.random.default_rng(2))
    assert np.mean(drawn.truth == 4) == pytest.approx(0.1, abs=0.01)


def test_grid_has_an_inclusion_of_every_contrast_and_size():
    grid = make_grid(np.random.default_rng(4))
    assert len(grid.values) == 400
    pytest.importorskip("sklearn")
    pairs = set(zip(grid.contrast.tolist(), grid.diameter.tolist(), strict=True))
    assert pairs == {(1.0, 0.0), *((c, d) for c in CONTRASTS for d in (8.0, 12.0, 20.0))}
    compared = comparisons(grid, drawn_estimates(grid, PRECISION[:1], np.random.default_rng(5)))
    hard = [c.ratio for c, g in zip(compared, grid.contrast, strict=True) if c and g == 4.0]
    assert 2.5 < np.median(hard) < 5.5
    rows = rows_of([(grid, compared)])
    assert rows["4 times stiffer"]["area under ROC"] > 0.95
    assert rows["healthy"]["alarms"].value < 0.3


def test_foreign_class_is_five_deviations_from_the_nearest():
    rng = np.random.default_rng(6)
    for number in range(8):
        one = classification.far_class(rng, number)
        distances = [
            math.sqrt((one.mean - t.mean) @ np.linalg.solve(t.covariance, one.mean - t.mean))
            for t in populations.population().tissues
        ]
        assert min(distances) == pytest.approx(5.0)


def test_tiny_run_measures_goals_and_leaves_figures_and_picture(tmp_path, capsys, monkeypatch):
    pytest.importorskip("sklearn")
    tiny = classification.Size(8, 3000, 1, 2, 1, 0)
    monkeypatch.setattr(classification, "QUICK", tiny)
    assert main(["benchmark", "classification", "--quick", "--json", "-o", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (tmp_path / "classification.png").read_bytes().startswith(b"\x89PNG")
    goals = {goal["name"]: goal for goal in shown["goals"]}
    assert goals["calibration error"]["value"] < 0.05
    assert set(shown["figures"]["peers"]) == {"fden_ros", "discriminant analysis"}
    assert set(shown["figures"]["lesions"]) >= {"healthy", "4 times stiffer"}
