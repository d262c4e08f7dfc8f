# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One mixture of hypotheses: its weights, its moments, and where hypotheses come from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pipeline_helpers import DISPLACEMENT, FORCE, Item, identified, summaries_of
from scipy.optimize import minimize
from test_core_posterior import LAW_OFF, points_of, posterior_of, pressed

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    Block,
    Component,
    Estimate,
    EstimatorConfig,
    PosteriorEstimator,
    Reservations,
    ended,
    reserved,
)
from fden_ros.core.estimation.maxima import Solutions, combined, find_maxima
from fden_ros.core.estimation.mixture import (
    collapsed,
    moments,
    weights_of,
)
from fden_ros.core.estimation.proposals import linear
from fden_ros.core.estimation.unknowns import LOG_GN
from fden_ros.core.law import FlatPunch
from fden_ros.simulation import Column, FdenModel, Tissue

RATE, PER_BLOCK, NOISE = 250.0, 5, 3.0
GEOMETRY = FlatPunch(3.14e-4, 0.02)
TRUTH = FdenModel(700.0, 8.0, 0.15)
CONFIG = EstimatorConfig(uncertainty=replace(LAW_OFF, thickness_sd=0.05))


def estimator_of(config: EstimatorConfig = CONFIG, origin_sd: float = 0.005) -> PosteriorEstimator:
    return PosteriorEstimator(config, GEOMETRY, NOISE, origin_sd)


def motion(deepest: float = 0.25, hold: float = 0.6) -> Array:
    """Return the strains of a press, from 0 to `deepest` at 0.25/s, and a hold."""
    ramp = np.arange(0.0, deepest, 0.25 / RATE)
    return np.append(ramp, np.full(round(hold * RATE), deepest))


def press(
    estimator: PosteriorEstimator,
    tissue: Tissue,
    strains: Array,
    factor: float = 1.0,
    seed: int = 0,
) -> Iterator[Estimate]:
    """Press a tissue of which the stress is `factor` as large; give the estimate of each block."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, strains.size)
    stresses = [factor * tissue.press(float(strain)) for strain in strains] + noise
    yield from fed(estimator, strains, stresses)


def fed(estimator: PosteriorEstimator, strains: Array, stresses: Array) -> Iterator[Estimate]:
    """Feed stresses [Pa] in blocks; give the estimate of each."""
    step = 1.0 / RATE
    estimator.begin_contact(1.0, 0.0)
    for begin in range(0, strains.size - PER_BLOCK + 1, PER_BLOCK):
        part = slice(begin, begin + PER_BLOCK)
        for k in range(begin, begin + PER_BLOCK):
            elapsed = step if k else 0.0
            estimator.take(elapsed, float(strains[k]), float(stresses[k]), is_free=False)
        means = float(strains[part].mean()), float(stresses[part].mean())
        estimator.update(Block(*means, begin * step, PER_BLOCK, PER_BLOCK * step, np.zeros(0)))
        yield estimator.estimate()
    estimator.begin_finish()
    estimator.finish()
    yield estimator.estimate()


def rest(estimator: PosteriorEstimator, tissue: Tissue, seconds: float) -> None:
    for _ in range(round(seconds * RATE)):
        tissue.press(-0.1)
    estimator.rest(seconds)


def tissue_of(model: FdenModel = TRUTH) -> Tissue:
    return Tissue([Column(model)], 1.0 / RATE)


def of_two_places() -> tuple[PosteriorEstimator, Tissue]:
    """Return an estimator whose next touch may be of the tissue that was pressed, or of other."""
    before, tissue = estimator_of(), tissue_of()
    list(press(before, tissue, motion(0.15)))
    rest(before, tissue, 3.0)
    new = estimator_of()
    new.may_be_of(before, 0.0, 0.0)
    return new, tissue


def assert_moments(estimate: Estimate) -> None:
    assert math.isclose(sum(one.weight for one in estimate.components), 1.0, rel_tol=1e-12)
    mean = sum(one.weight * one.mean for one in estimate.components)
    squares = [one.covariance + np.outer(one.mean, one.mean) for one in estimate.components]
    second = sum(
        one.weight * square for one, square in zip(estimate.components, squares, strict=True)
    )
    covariance = second - np.outer(mean, mean)
    np.testing.assert_allclose(mean, estimate.mean, atol=1e-9)
    np.testing.assert_allclose(covariance, estimate.covariance, atol=1e-9)


def test_what_is_published_has_the_moments_of_the_published_components() -> None:
    found = [one for one in press(estimator_of(), tissue_of(), motion(0.15)) if one.components]
    for estimate in found:
        assert_moments(estimate)
        assert_moments(reserved(CONFIG, estimate, Reservations(variance_factor=3.0)))
    assert max(len(one.components) for one in found) > 1


def test_so_it_has_while_two_places_are_alive() -> None:
    estimator, tissue = of_two_places()
    alive = 0
    for estimate in press(estimator, tissue, motion()):
        if estimate.components:
            assert_moments(estimate)
        assert estimator.press is not None
        alive += len(estimator.press.weighed) > 1
    assert alive > 3


def log_posterior(posterior: Any, points: Any, errors: Any, scales: Any, state: Array) -> float:
    """Return minus twice the log posterior at a state, under the errors of another."""
    try:
        stress = posterior.model.response(points, state).stress
    except (FloatingPointError, OverflowError):
        return 1e12
    left = (points.stresses - stress)[:, None]
    white = posterior.error_model.whitened(left, errors, *scales[2:])[:, 0]
    off = state - posterior.belief.mean
    return float(white @ white + off @ posterior.precision(state, scales) @ off)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.statistics) for k in range(1, 20))]
)
def test_an_optimiser_with_many_starts_finds_no_better_maximum(seed: int) -> None:
    record = pressed(seed)
    posterior, points = posterior_of(record), points_of(record)
    starts = []
    for place in (-0.8, 0.8):
        start = posterior.belief.mean.copy()
        start[LOG_GN] += place * posterior.model.unknowns[LOG_GN].sd
        starts.append(start)
    strain = float(record.strains.max())
    scales = posterior.moderate_scales
    found = ended(find_maxima(posterior, points, starts, scales, (), strain)).best
    arguments = posterior, points, found.maximum.errors, found.maximum.scales
    own = log_posterior(*arguments, found.maximum.state)
    drawn = np.random.default_rng(seed)
    for _ in range(8):
        begin = posterior.belief.mean + drawn.normal(size=own_size(posterior)) * sizes(posterior)
        begin[2] = np.clip(begin[2], 0.05, 0.6)
        other = minimize(lambda s: log_posterior(*arguments, s), begin, method="Nelder-Mead")
        assert 0.5 * (own - other.fun) < 0.1


def own_size(posterior: Any) -> int:
    return int(posterior.model.size)


def sizes(posterior: Any) -> Array:
    return np.array([unknown.unit for unknown in posterior.model.unknowns])


# Proposals


def maxima_of(seed: int, deepest: float) -> tuple[Any, Any, Solutions]:
    record = pressed(seed, 0.005)
    shallow = record.strains < deepest
    record = record._replace(
        times=record.times[shallow],
        strains=record.strains[shallow],
        stresses=record.stresses[shallow],
    )
    posterior, points = posterior_of(record, LAW_OFF), points_of(record)
    start = posterior.belief.mean
    scales = posterior.moderate_scales
    found = ended(find_maxima(posterior, points, [start], scales, (), deepest))
    return posterior, points, found


def test_a_bend_keeps_its_weight_beside_a_likelier_linear_law() -> None:
    posterior, points, found = maxima_of(2, 0.04)
    below = found.best
    assert below.maximum.state[LOG_GN] < -math.log(0.04)
    above = replace(below.maximum, state=below.maximum.state.copy())
    above.state[LOG_GN] = 4.5
    mean = below.mean.copy()
    mean[LOG_GN] = 4.5
    covariance = below.covariance.copy()
    covariance[LOG_GN], covariance[:, LOG_GN] = 0.0, 0.0
    covariance[LOG_GN, LOG_GN] = 0.01
    bend = replace(below, maximum=above, mean=mean, covariance=covariance)
    both = Solutions((below, bend), (below.log_evidence, below.log_evidence - 1.0))
    whole = combined(both, [ended(linear.propose(posterior, points, both, 0.04))])
    weights = whole.weights
    # The maximum below the boundary is the linear law's own: that stands for it.
    assert weights[0] == 0.0 and weights[1] > 0.01 and weights[2] > 0.01
    assert whole.best.is_solved


@pytest.mark.parametrize("size", [1.0, 1e17, 1e300])
def test_weights_add_up_to_1_however_small_all_of_them_are(size: float) -> None:
    assert weights_of([-size, -2.0 * size]).sum() == pytest.approx(1.0)


# A second press


def of_presses(factors: Sequence[float], pause: float = 1.0) -> list[Estimate]:
    found: list[Estimate] = []
    config = EstimatorConfig(uncertainty=LAW_OFF)
    estimator, tissue = estimator_of(config), tissue_of()
    for k, factor in enumerate(factors):
        if k:
            rest(estimator, tissue, pause)
        *_, last = press(estimator, tissue, motion(), factor, seed=k)
        found.append(last)
    return found


def test_a_press_that_finds_the_same_tissue_pools_all_of_it() -> None:
    first, second = of_presses([1.0, 1.0])
    assert np.all(second.deviations[1:] < 0.9 * first.deviations[1:])
    assert second.deviations[0] < first.deviations[0]


# What is carried from press to press


def test_a_few_gaussians_have_the_moments_of_many_and_the_near_ones_are_one() -> None:
    places = np.array([[0.0, 0.0], [0.1, 0.0], [5.0, 5.0], [5.1, 5.0], [-5.0, 5.0]])
    shares = [0.4, 0.1, 0.2, 0.1, 0.2]
    many = [Component(w, at, np.eye(2)) for w, at in zip(shares, places, strict=True)]
    for most, alike, left in ((3, 0.0, 3), (5, 0.01, 3), (5, 0.0, 5), (2, 0.0, 2), (3, 9.0, 1)):
        few = collapsed(many, most, alike, [0, 1])
        assert len(few) == left
        for got, wanted in zip(moments(few), moments(many), strict=True):
            np.testing.assert_allclose(got, wanted, atol=1e-12)
    weights = sorted(one.weight for one in collapsed(many, 3, 0.0, [0, 1]))
    assert weights == pytest.approx([0.2, 0.3, 0.5])


# Places that are pressed again


def visits(places: Sequence[int], seed: int = 0) -> list[Item]:
    """Return samples of one press at each of some places, 30 mm apart, of the same kind."""
    columns = [Column(TRUTH)] * (max(places) + 1)
    tissue, noise = Tissue(columns, 1.0 / RATE), np.random.default_rng(seed)
    path = np.interp(
        np.arange(0.0, 5.0, 1.0 / RATE), [0.0, 2.0, 3.3, 4.0, 4.8], [-0.1, -0.1, 0.25, 0.25, -0.1]
    )
    items: list[Item] = []
    stamp = 0
    for place in [places[0], *places]:
        is_lead = not items
        for strain in np.full(path.size, -0.1) if is_lead else path:
            force = tissue.press(float(strain), place) * 3.14e-4 + noise.normal(0.0, 1e-3)
            position = (0.03 * place, 0.0, -0.02 * float(strain))
            items.append(Item(DISPLACEMENT, stamp, 0.02 * float(strain), position))
            items.append(Item(FORCE, stamp, force))
            stamp += round(1e9 / RATE)
    return items


def test_a_place_that_is_pressed_again_has_not_recovered_and_is_known() -> None:
    """As other tissue at rest Gn was 5 to 7 standard deviations off, with nothing said."""
    rigid = {
        name: 0.0
        for name in (
            "displacement.compliance_sd",
            "displacement.delay_sd",
            "force.friction_sd",
            "force.drift_sd",
            "surface.motion_sd",
            "geometry.thickness_sd",
        )
    }
    stated = {"geometry.area": 3.14e-4, "geometry.thickness": 0.02, **rigid}
    found = summaries_of(identified(visits([0, 1, 0, 1]), stated)[1])
    assert [one.site_id for one in found] == [1, 2, 1, 2]
    for summary in found:
        estimate = summary.estimate
        assert estimate is not None and summary.converged
        off = estimate.mean - [math.log(700.0), math.log(8.0), 0.15]
        assert np.all(np.abs(off) < 4.0 * estimate.deviations), summary.site_id
    first, again = found[0].estimate, found[2].estimate
    assert first is not None and again is not None
    assert np.all(again.deviations < first.deviations)


def _drawn(seed: int) -> tuple[np.random.Generator, Array, float]:
    """Return a generator, the strains of a press, and G [Pa s^alpha]."""
    random = np.random.default_rng([7, seed])
    deepest, hold = random.uniform([0.1, 0.3], [0.25, 1.5]).tolist()
    return random, motion(deepest, hold), math.exp(random.uniform(math.log(500), math.log(8000)))


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.statistics) for seed in range(2, 60))]
)
def test_tissue_of_the_law_is_not_told_as_another(seed: int) -> None:
    random, strains, stiffness = _drawn(seed)
    order, nonlinear = random.uniform([0.02, 4.0], [0.32, 10.0]).tolist()
    tissue = tissue_of(FdenModel(stiffness, nonlinear, order))
    estimator = estimator_of()
    for _ in press(estimator, tissue, strains, seed=seed):
        assert not estimator.is_mismatch
    assert estimator.press is not None and estimator.press.best.plateau_odds is not None
