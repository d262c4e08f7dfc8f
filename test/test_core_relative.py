# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A place against its surroundings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fden_ros.core.classification.relative import (
    LEAST_SURROUNDINGS,
    compare,
    stack,
)
from fden_ros.core.law.apparent_stiffness import LogStiffness, log_stiffness


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


def test_lesions_among_the_surroundings_do_not_hide_a_lesion():
    rng = np.random.default_rng(4)
    healthy = rng.normal(0.0, 0.1, 24)
    lesions = rng.normal(math.log(4.0), 0.1, 8)
    compared = compare(place(math.log(4.0), 0.02), around([*healthy, *lesions], 0.02))
    assert compared.ratio == pytest.approx(4.0, rel=0.12)
    assert compared.count == pytest.approx(24.0, abs=4.0)
    assert compared.log_ratio > 6.0 * math.hypot(compared.log_ratio_sd, 0.1)


def test_too_few_surroundings_make_no_comparison():
    assert compare(place(0.0), around([0.0] * (LEAST_SURROUNDINGS - 1))) is None
    assert compare(place(0.0), stack([])) is None
    assert compare(place(0.0, 0.1), around([0.0] * LEAST_SURROUNDINGS)) is not None
