# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior on the stress: honest, alpha learned, changes followed, wrong models told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pipeline_helpers import LIVER, identified, items_of, parameters_of, summaries_of
from property_helpers import counts, first
from scipy.signal import lfilter

from fden_ros.core.estimation import NOTHING_UNKNOWN, Block, EstimatorConfig, PosteriorEstimator
from fden_ros.core.estimation.whiteness import contradicts
from fden_ros.core.law import PassThrough
from fden_ros.core.outputs import Flag
from fden_ros.simulation import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain
from simulation.scenario import load_scenario
from simulation.simulate import simulate

RATE, PER_BLOCK, NOISE = 500.0, 5, 3.0
ORDER, ORDER_SD = 0.2, 0.05
NO_INTEGRALS = np.zeros(0)
STATISTICS = pytest.mark.statistics


def drawn(rng):
    """Return G, Gn, alpha drawn from the prior, which ends at three standard deviations."""
    log_g, log_gn, order = np.clip(rng.standard_normal(3), -2.9, 2.9).tolist()
    return (
        520.0 * math.exp(0.3 * log_g),
        8.4 * math.exp(0.2 * log_gn),
        float(np.clip(ORDER + ORDER_SD * order, 0.03, 0.55)),
    )


def estimator_of(origin_sd=0.0, bias_sd=0.0):
    prior = replace(LIVER, fractional_order=ORDER, fractional_order_sd=ORDER_SD)
    config = EstimatorConfig(prior, uncertainty=NOTHING_UNKNOWN)
    estimator = PosteriorEstimator(config, PassThrough(), NOISE, origin_sd)
    estimator.begin_contact(bias_sd, 0.0)
    return estimator


def fed(estimator, motion, stress):
    """Feed samples in blocks; return whether a mismatch was told."""
    step = 1.0 / RATE
    for begin in range(0, len(motion) - PER_BLOCK + 1, PER_BLOCK):
        block = slice(begin, begin + PER_BLOCK)
        for index in range(begin, begin + PER_BLOCK):
            estimator.take(
                step if index else 0.0, float(motion[index]), float(stress[index]), is_free=False
            )
        time = (begin + PER_BLOCK / 2) * step
        estimator.update(
            Block(
                float(motion[block].mean()),
                float(stress[block].mean()),
                time,
                PER_BLOCK,
                PER_BLOCK * step,
                NO_INTEGRALS,
            )
        )
    return estimator.is_mismatch


def ramp_and_hold(rate=0.3, max_strain=0.3, hold=1.0):
    time = np.arange(0.0, max_strain / rate + hold, 1.0 / RATE)
    return time, np.minimum(rate * time, max_strain), rate, max_strain


def exact_stress(time, rate, max_strain, model):
    knots = [0.0, max_strain / rate, max_strain / rate + 100.0]
    return stress_of_piecewise_linear_strain(
        knots, [0.0, max_strain, max_strain], np.maximum(time, 1e-9), model
    )


def error_of(estimate, truth):
    return np.array(
        [
            estimate.log_linear_stiffness - math.log(truth[0]),
            estimate.log_nonlinear_stiffness - math.log(truth[1]),
            estimate.fractional_order - truth[2],
        ]
    )


@pytest.mark.parametrize("seeds", counts(6, 40))
def test_alpha_is_learned_from_a_hold_and_the_covariance_is_that_of_the_errors(seeds):
    # error' P^-1 error / 3 has mean 1 and, over 40 contacts, a deviation of sqrt(2 / 120) = 0.13:
    # four of them. The bias of alpha is known to 0.0006 / sqrt(40) = 0.0001.
    scores, errors, alarms = [], [], 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        truth = drawn(rng)
        time, motion, rate, top = ramp_and_hold()
        origin, bias = 0.002 * rng.standard_normal(), 0.3 * rng.standard_normal()
        stress = exact_stress(time, rate, top, FdenModel(*truth))
        stress += bias + NOISE * rng.standard_normal(time.size)
        estimator = estimator_of(origin_sd=0.002, bias_sd=0.3)
        alarms += fed(estimator, motion + origin, stress)
        estimator.begin_finish()
        estimator.finish()
        estimate = estimator.estimate()
        assert estimate.converged
        error = error_of(estimate, truth)
        errors.append(error)
        scores.append(error @ np.linalg.solve(estimate.covariance, error) / 3.0)
    assert abs(np.mean(scores) - 1.0) < 4.0 * math.sqrt(2.0 / (3.0 * seeds))
    assert alarms <= 1
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[0] < 0.02 and rms[1] < 0.01 and rms[2] < 0.002
    assert abs(np.mean(errors, axis=0)[2]) < 0.001


@pytest.mark.parametrize(("seeds", "least"), [(5, 12), pytest.param(40, 106, marks=STATISTICS)])
def test_below_the_boundary_strain_the_interval_is_honest_and_nothing_converges(seeds, least):
    held = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        truth = drawn(rng)
        time, motion, rate, top = ramp_and_hold(max_strain=0.05, hold=0.5)
        stress = exact_stress(time, rate, top, FdenModel(*truth))
        estimator = estimator_of()
        fed(estimator, motion, stress + NOISE * rng.standard_normal(time.size))
        estimator.begin_finish()
        estimator.finish()
        estimate = estimator.estimate()
        assert not estimate.converged
        error = np.abs(error_of(estimate, truth))
        held += np.count_nonzero(error < 2.0 * np.sqrt(estimate.covariance.diagonal()))
    # Of 120 intervals of 95 % fewer would hold by chance in 1 of 500 runs, of 15 in 1 of 200.
    assert held >= least


def test_a_spring_and_dashpot_is_a_mismatch_and_does_not_converge_on_a_narrow_lie():
    rng = np.random.default_rng(0)
    time, motion, *_ = ramp_and_hold(hold=2.0)
    velocity = np.gradient(motion, time)
    stress = 2000.0 * motion + 300.0 * velocity
    estimator = estimator_of()
    assert fed(estimator, motion, stress + NOISE * rng.standard_normal(time.size))
    estimator.begin_finish()
    estimator.finish()
    estimate = estimator.estimate()
    assert not estimate.converged
    # The parameters of a wrong model are known no better than before the touch.
    assert np.all(np.sqrt(estimate.covariance.diagonal()) >= [0.3, 0.2, ORDER_SD])


def test_a_relaxation_that_ends_is_told_of_a_law_that_may_be_off():
    """A spring beside a Maxwell element of 0.5 s, each half of the stress."""
    time, motion, *_ = ramp_and_hold(hold=2.0)
    decay = math.exp(-1.0 / RATE / 0.5)
    relaxing = lfilter([1.0], [1.0, -decay], np.diff(motion, prepend=0.0))
    stress = 1000.0 * (motion + relaxing)
    stress += NOISE * np.random.default_rng(0).standard_normal(time.size)
    uncertainty = replace(NOTHING_UNKNOWN, characteristic_sd=0.2)
    estimator = PosteriorEstimator(
        EstimatorConfig(LIVER, uncertainty=uncertainty), PassThrough(), NOISE, 0.0
    )
    estimator.begin_contact(0.0, 0.0)
    fed(estimator, motion, stress)
    estimator.begin_finish()
    estimator.finish()
    assert estimator.is_mismatch


@pytest.mark.parametrize("seed", first(0, 1))
def test_of_an_inclusion_met_on_the_way_nothing_is_known_until_the_next_touch(seed):
    scenario = load_scenario("inclusion")
    recording = simulate(scenario, seed)
    _, outputs = identified(items_of(recording), parameters_of(recording))
    found = summaries_of(outputs)
    assert len(found) == len(recording.truth["contacts"])
    for summary in found:
        assert summary.flags & Flag.TISSUE_CHANGED
        assert not summary.converged and summary.estimate is None
        assert summary.apparent_stiffness is None


# Whitened residuals


def test_white_residuals_contradict_the_model_in_less_than_one_contact_of_a_thousand():
    # More than 4 of 1,000 would come by chance in 1 of 270 runs only.
    rng = np.random.default_rng(5)
    assert sum(contradicts(rng.standard_normal(1000)) for _ in range(1000)) <= 4


def test_underestimated_noise_and_slow_deviations_below_the_noise_do():
    rng = np.random.default_rng(1)
    assert contradicts(1.3 * rng.standard_normal(2000))
    slow = 0.5 * np.sin(2.0 * np.pi * np.arange(4000) / 1000)
    assert contradicts(slow + rng.standard_normal(4000))
    assert not contradicts(rng.standard_normal(0))
