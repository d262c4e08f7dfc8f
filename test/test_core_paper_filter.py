# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The Gaussian sum of Kalman filters on the fractional stress."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from pipeline_helpers import LIVER
from scipy.special import gamma

from fden_ros.core.estimation import NOTHING_UNKNOWN, Block, EstimatorConfig
from fden_ros.core.law import PassThrough, Sphere, memory_weights
from fden_ros.core.paper_filter import FractionalStressEstimator

PRIOR = replace(LIVER, fractional_order_sd=0.0)
ORDER = PRIOR.fractional_order
#: Of a memory whose fractional stress is 1.
UNIT_MEMORY = memory_weights(ORDER) / (memory_weights(ORDER) @ memory_weights(ORDER))


def phi(x, G, Gn):
    x = np.asarray(x, dtype=float)
    beyond = np.sign(x) * G / Gn * np.exp(np.minimum(Gn * np.abs(x), 700.0) - 1.0)
    return np.where(np.abs(x) <= 1.0 / Gn, G * x, beyond)


def noise_sd(time, sigma, size, order=ORDER):
    """Standard deviation of a block's fractional stress as the estimator takes it."""
    return math.sqrt(0.9 / (1 + 2 * order) / size) * sigma * time**order / gamma(1 + order)


def ramp_blocks(
    rng, G, Gn, *, sigma=3.0, size=10, count=300, max_strain=0.3, bias=0.0, origin=0.0
):
    """Blocks of a ramp at 100 a second whose noise is exactly what the filter assumes."""
    blocks = []
    for n in range(1, count + 1):
        time = 0.01 * n
        u = max_strain * n / count
        value = float(phi(u - origin, G, Gn)) + bias * time**ORDER / gamma(1 + ORDER)
        value += noise_sd(time, sigma, size) * rng.standard_normal()
        blocks.append(Block(u, value, time, size, 0.01, value * UNIT_MEMORY))
    return blocks


def fed(estimator, blocks):
    for block in blocks:
        estimator.update(block)
    return estimator.estimate()


def estimator_of(prior=PRIOR, geometry=None, sigma=3.0, bias_sd=0.0, origin_sd=0.0):
    config = EstimatorConfig(prior, uncertainty=NOTHING_UNKNOWN)
    geometry = geometry or PassThrough()
    estimator = FractionalStressEstimator(config, geometry, sigma, origin_sd)
    estimator.begin_contact(bias_sd, 0.0)
    return estimator


@pytest.mark.parametrize("geometry", [PassThrough(), Sphere(0.005)], ids=["flat", "sphere"])
def test_one_member_is_the_plain_extended_kalman_filter(geometry):
    # A spread of 0 leaves one member; this filter is written out from the equations alone.
    prior = replace(PRIOR, nonlinear_stiffness_log_sd=0.0)
    sigma, origin_sd, bias_sd = 3.0, 0.005, 0.4
    estimator = estimator_of(prior, geometry, sigma, origin_sd=origin_sd, bias_sd=bias_sd)
    plain = ExtendedKalmanFilter(dim_x=4, dim_z=1)
    plain.x = np.array([math.log(520.0), math.log(8.4), 0.0, 0.0])
    plain.P = np.diag([0.3**2, 0.06**2, origin_sd**2, bias_sd**2])
    blocks = ramp_blocks(np.random.default_rng(0), 600.0, 9.0, max_strain=0.4)
    for block in blocks:
        growth = block.memory_time**ORDER / gamma(1 + ORDER)

        def strain(u):
            return geometry.strain(u)

        def h(x, block=block, growth=growth):
            return phi(strain(block.compression - x[2]), math.exp(x[0]), math.exp(x[1])) + (
                growth * x[3]
            )

        def jacobian(x, h=h):
            columns = []
            for i, step in enumerate((1e-5, 1e-5, 1e-7, 1e-3)):
                e = np.zeros(4)
                e[i] = step
                columns.append((h(x + e) - h(x - e)) / (2 * step))
            return np.array([columns])

        plain.update(
            np.array([block.stress]),
            jacobian,
            lambda x, h=h: np.array([h(x)]),
            R=noise_sd(block.memory_time, sigma, block.size) ** 2,
        )
        estimator.update(block)
    estimate = estimator.estimate()
    # The written-out filter differentiates numerically, where the law has a kink in its slope's
    # slope: 1e-6 of the value, and as much of a standard deviation.
    assert estimate.log_linear_stiffness == pytest.approx(plain.x[0], rel=1e-6)
    assert estimate.log_nonlinear_stiffness == pytest.approx(plain.x[1], rel=1e-6)
    assert estimate.contact_point == pytest.approx(plain.x[2], abs=1e-7)
    assert estimate.covariance[:2, :2] == pytest.approx(plain.P[:2, :2], rel=1e-4)


@pytest.mark.parametrize(
    ("options", "origin_sd", "bias_sd"),
    [({}, 0.0, 0.0), ({"origin_sd": 0.003, "bias_sd": 0.3}, 0.003, 0.3)],
    ids=["known", "nuisances"],
)
def test_stated_covariance_is_that_of_the_errors(options, origin_sd, bias_sd):
    # Truth drawn from the prior, blocks as the filter assumes them: error' P^-1 error / 2 has mean
    # 1 and, over 60 runs, a standard deviation of sqrt(1 / 60) = 0.13; four of them.
    scores, converged = [], 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        log_g = math.log(520.0) + 0.3 * rng.standard_normal()
        log_gn = math.log(8.4) + 0.2 * rng.standard_normal()
        blocks = ramp_blocks(
            rng,
            math.exp(log_g),
            math.exp(log_gn),
            bias=bias_sd * rng.standard_normal(),
            origin=origin_sd * rng.standard_normal(),
            count=100,
        )
        estimate = fed(estimator_of(**options), blocks)
        error = np.array(
            [
                estimate.log_linear_stiffness - log_g,
                estimate.log_nonlinear_stiffness - log_gn,
            ]
        )
        scores.append(0.5 * error @ np.linalg.solve(estimate.covariance[:2, :2], error))
        converged += estimate.converged
    assert 0.48 < np.mean(scores) < 1.52
    assert converged == 60
