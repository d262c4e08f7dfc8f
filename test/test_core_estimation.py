# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The weighted nodes: Gaussian algebra against brute force, recursion, calibration."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from pipeline_helpers import off
from property_helpers import counts, first
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    NOTHING_UNKNOWN,
    Estimate,
    EstimatorConfig,
    GridEstimator,
    ParameterSet,
    Setting,
    Touch,
    Uncertainty,
    moments,
)
from fden_ros.core.estimation.cells import CREEP_RATES, Path, Place, Press, gathered
from fden_ros.core.estimation.covariance import Noise, scales_of
from fden_ros.core.estimation.discrepancy import RIG
from fden_ros.core.estimation.filter import Filter
from fden_ros.core.estimation.grid import (
    Cells,
    Grid,
    _stepped,
    laid,
    of_stiffness,
    rounds,
    table,
    whitened,
)
from fden_ros.core.estimation.law import Expansion, Law
from fden_ros.core.estimation.nuisance import rig_of, spot_of, with_tails
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.record import Block, Record
from fden_ros.core.law import LOWEST_ORDER, FlatPunch
from fden_ros.simulation import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain

GEOMETRY = FlatPunch(3.14e-4, 0.02)
EXACT = replace(NOTHING_UNKNOWN, characteristic_sd=0.2)
CONTACT_POINT_SD, RATE_HZ, NOISE = 0.01, 500.0, 0.005 * GEOMETRY.stress_per_force


class Samples(NamedTuple):
    """One simulated press: a ramp and a hold, from just before the touch."""

    times: Array
    indentations: Array
    stresses: Array
    tissue: tuple[float, float, float]  #: (G, Gn, alpha)
    clean: Array  #: stress without noise


@functools.lru_cache(maxsize=64)
def pressed(seed: int, hold: float = 1.0) -> Samples:
    """Simulate a press."""
    generator = np.random.default_rng(seed)
    tissue = math.exp(generator.uniform(6.0, 8.5)), generator.uniform(5.0, 11.0)
    tissue = *tissue, generator.uniform(0.1, 0.4)
    speed, depth = generator.uniform(0.2, 0.4), generator.uniform(0.2, 0.3)
    times = np.arange(0.0, 0.3 + depth / speed + hold, 1.0 / RATE_HZ)
    strains = np.minimum((times - 0.3) * speed, depth) + generator.uniform(-1.0, 1.0) * 1e-4
    knots = np.sort(np.append(times, np.interp(0.0, strains, times)))
    path = np.maximum(np.interp(knots, times, strains), 0.0)
    clean = stress_of_piecewise_linear_strain(knots, path, times, FdenModel(*tissue))
    stresses = clean + generator.normal(0.0, NOISE, times.size)
    first = int(np.searchsorted(times, 0.29))
    begin = times[first]
    return Samples(times[first:] - begin, strains[first:], stresses[first:], tissue, clean[first:])


def released(
    samples: Samples,
    uncertainty: Uncertainty = EXACT,
    size: int = 5,
    parts_after: int = 0,
    noise: float = NOISE,
) -> tuple[GridEstimator, Estimate]:
    """Return an estimator that took a press in parts, and its last estimate.

    `parts_after`: of its last work, how many are done before the release is asked for.
    """
    config = EstimatorConfig(uncertainty=uncertainty)
    estimator = GridEstimator(Setting(config, GEOMETRY, noise, CONTACT_POINT_SD))
    estimator.touch(Touch(0.3 * noise, 0.0, np.zeros((3, 0))), 0.0)
    for k in range(0, len(samples.times), size):
        parts = [column[k : k + size].tolist() for column in samples[:3]]
        estimator.add(*parts, [True] * len(parts[0]))
    for _ in range(parts_after):
        estimator.settle()
    return estimator, estimator.release()


def blocks_of(samples: Samples) -> list[Block]:
    """Return the blocks of a press."""
    record = Record(0.0, 6.0 * CONTACT_POINT_SD, is_at_rest=True)
    for time, u, stress in zip(*(v.tolist() for v in samples[:3]), strict=True):
        record.add(time, u, stress, is_observed=True)
    record.close()
    return record.blocks


def law_of(press: Press, uncertainty: Uncertainty) -> Law:
    """Return the law of a place with one press."""
    config = EstimatorConfig(uncertainty=uncertainty)
    place = Place((press,), np.zeros(CREEP_RATES.size), press.start)
    rig = rig_of(config, GEOMETRY, 0.3 * NOISE, 0.1 * NOISE)
    return Law(config, GEOMETRY, place, rig, CONTACT_POINT_SD)


@functools.lru_cache(maxsize=4)
def laid_on(
    seed: int, left_out: int = 0, *, shift: float | None = None, spot: int = 1
) -> tuple[Grid, list[Block]]:
    """Return a settled grid of a press on an arm, and the blocks that were left out at its end.

    `shift`: a spot, whose contact point differs by this, was pressed 20 s before [1]: another
    one, or at `spot` 0 the same.
    """
    blocks = blocks_of(pressed(seed))
    count = len(blocks) - left_out
    law = law_of(gathered(blocks[:count], 0.0, 40), Uncertainty())
    if shift is not None:
        (press,) = law.place.presses
        early = replace(
            press, times=press.times - 20.0, middles=press.middles - 20.0, start=press.start - 20.0
        )
        later = replace(press, spot=spot, indentations=press.indentations + shift)
        place = replace(law.place, presses=(early, later), older_end=early.start)
        rig = law.rig._replace(spots={1: spot_of(CONTACT_POINT_SD)})
        law = replace(law, place=place, rig=rig)
    return list(rounds(law, Noise(NOISE)))[-1], blocks[count:]


def test_stiffness_is_integrated_as_by_brute_force() -> None:
    """Its log evidence is that of the integral over ln G, where the data are informative."""
    a, b = np.array([4e-4, 1e-3]), np.array([0.9, 0.5])
    found = of_stiffness(a, b, 7.0, 1.5)
    for k in range(2):

        def density(log_g: float, k: int = k) -> float:
            g = math.exp(log_g)
            prior = -0.5 * ((log_g - 7.0) / 1.5) ** 2 - math.log(1.5 * math.sqrt(2.0 * math.pi))
            return math.exp(b[k] * g - 0.5 * a[k] * g**2 + prior - float(found.log[k]))

        at = float(found.log_g[k])
        whole = quad(density, at - 3.0, at + 3.0, points=[at])[0]
        assert whole == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("by_data", "told"), [(0.0, 1.0), (0.0, 6.0), (3.0, 1.5), (5.0, 2.5)])
@pytest.mark.parametrize("before", [1.0, 5.0])
def test_prior_with_tails_leaves_the_interval_of_students(
    by_data: float, told: float, before: float
) -> None:
    def given(prior: float) -> tuple[float, float]:
        variance = 1.0 / (1.0 / prior + told**-2.0)
        return by_data * variance / told**2, variance

    places = np.linspace(-60.0, 60.0, 200001)
    share = np.cumsum(student.pdf(places, 2) * norm.pdf(places, by_data, told))
    low, high = np.interp(norm.cdf([-1.0, 1.0]), share / share[-1], places)
    _, variance = given(with_tails(*given(before), before))
    least = math.sqrt(given(1.0)[1])
    assert math.sqrt(variance) == pytest.approx(max(0.5 * (high - low), least), rel=0.01)


def test_nodes_at_all_scales_are_weighed_as_by_the_whole_covariance() -> None:
    grid, _ = laid_on(1)
    places = scales_of(grid.law.config.uncertainty)[::7]
    some = grid.cells.some(np.arange(0, len(grid.nodes), 20))
    found = table(grid.law, grid.covariance, places, some)
    for k, place in enumerate(places):
        covariance = grid.covariance.at(place)
        inverse = np.linalg.inv(covariance)
        r, y = some.responses, some.own
        a, b = np.einsum("im,ij,jm->m", r, inverse, r), np.einsum("im,ij,jm->m", y, inverse, r)
        rest = 0.5 * np.einsum("im,ij,jm->m", y, inverse, y)
        rest += 0.5 * np.linalg.slogdet(covariance)[1]
        prior = grid.law.config.prior
        own = of_stiffness(a, b, float(prior.mean[0]), prior.linear_stiffness_log_sd)
        np.testing.assert_allclose(
            found.log[k], own.log - rest + place.log_prior, rtol=1e-6, atol=1e-4
        )


def test_sources_add_up_to_the_covariance_at_any_scales() -> None:
    grid, _ = laid_on(1)
    for scales in scales_of(grid.law.config.uncertainty)[::7]:
        whole = sum(grid.covariance.parts(scales).values())
        np.testing.assert_allclose(whole, grid.covariance.at(scales), rtol=1e-6, atol=1e-6)


def nowhere(law: Law, node: Array, log_g: float) -> Expansion:
    """Return an expansion about no errors of law or rig."""
    n, size = law.place.presses[0].times.size, law.size
    rig = np.ones(size - RIG)
    return Expansion(node, log_g, np.zeros(size), np.zeros((size, 3)), np.zeros(n), rig)


@pytest.mark.parametrize("seed", range(3))
def test_response_is_that_of_the_closed_form(seed: int) -> None:
    """Cells of two points have the mean stress of their samples to 5e-4 of the peak."""
    samples = pressed(seed)
    blocks = blocks_of(samples._replace(stresses=samples.clean))
    law = law_of(gathered(blocks, 0.0, 60), NOTHING_UNKNOWN)
    g, gn, order = samples.tissue
    node = np.array([[order, math.log(gn), 0.0]])
    found = g * law.responses(node, nowhere(law, node[0], math.log(g)))[0][:, 0]
    off = found - law.place.presses[0].stresses
    assert np.max(np.abs(off)) < 1e-3 * samples.clean.max()


def test_columns_are_the_derivatives_of_the_response() -> None:
    """Of the law's errors and of what moves the points, by differences."""
    grid, _ = laid_on(2)
    law, about, g = grid.law, grid.about, math.exp(grid.about.log_g)
    moving = [k for k, (one, _) in enumerate(law.slots, law.size - len(law.slots)) if one.moves]
    for k in [*range(0, law.size - len(law.slots), 3), *moving]:
        step = 1e-4 * np.eye(law.size)[k]
        more = law.response(replace(about, state=about.state + step))
        less = law.response(replace(about, state=about.state - step))
        by = g * (more - less) / 2e-4
        own = grid.linear.columns[:, k]
        assert np.max(np.abs(by - own)) < 5e-3 * np.max(np.abs(own)) + 1e-6 * g


@pytest.mark.parametrize(
    ("shift", "spot"),
    [(None, 0), (0.0, 1), (0.0, 0)],
    ids=["first", "another spot", "same spot"],
)
def test_block_by_block_is_the_batch_sum_on_the_same_nodes(shift: float | None, spot: int) -> None:
    """Factor and sums of 25 appended cells are those of the whole record to 1e-9."""
    grid, later = laid_on(2, 25, shift=shift, spot=spot)
    state = Filter(grid)
    points, tails = [], []
    for block in later:
        tails.append(state.path.tail(block, 0.0))
        points.append(state.stress_ahead(tails[-1].times))
        state.append(tails[-1])
    press = grid.law.place.presses[-1].appended(tails)
    presses = (*grid.law.place.presses[:-1], press.remembered())
    law = replace(grid.law, place=replace(grid.law.place, presses=presses))
    about = replace(grid.about, stresses=np.concatenate([grid.about.stresses, *points]))
    responses, linear = law.responses(grid.nodes, about)
    covariance = type(grid.covariance)(law, about, linear, grid.noise)
    y = covariance.shifts()
    y[:, 0] += law.place.joined("stresses")
    lower, white = whitened(
        law, covariance, grid.start.scales, Cells(y, grid.cells.off, responses)
    )
    n = state.count
    largest = np.abs(linear.columns).max(axis=0) + 1e-12
    np.testing.assert_allclose(state.columns[:n] / largest, linear.columns / largest, atol=1e-9)
    assert n == len(lower) == grid.cells.y.shape[0] + 25
    rows, tolerance = state.lower[: n * (n + 1) // 2], 1e-8 * lower.max()
    np.testing.assert_allclose(rows, lower[np.tril_indices(n)], rtol=0.0, atol=tolerance)
    rows, own = white[:, y.shape[1] + law.size :], white[:, :1]
    own = own + white[:, 1 : y.shape[1]] @ grid.cells.off.T
    a, b = state.sums
    np.testing.assert_allclose(a, (rows**2).sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(b, (rows * own).sum(axis=0), rtol=1e-9)


@pytest.mark.parametrize("size", [-1.0, math.nan])
def test_a_step_out_of_the_orders_ends_at_its_node(size: float) -> None:
    """From an alpha at the least one there is; neither it nor a step of no number hangs."""
    grid, _ = laid_on(1)
    law, box = grid.law, grid.start.box
    middle = np.array([LOWEST_ORDER, *box.mean[1:]])
    base, by_order = np.ones(4), np.linspace(0.01, 0.04, 4)
    responses = np.column_stack([base, base + by_order, base, base])
    case = law, box, middle, base + 100.0 * size * by_order, responses, np.zeros((4, 3))
    assert _stepped(*case).mean[0] == LOWEST_ORDER


def test_a_tool_that_bends_the_wrong_way_does_not_run_away_between_two_rounds() -> None:
    """The stress bends it further in, which makes the stress larger, block by block."""
    grid, _ = laid_on(1)
    law, start, (press,) = grid.law, grid.start, grid.law.place.presses
    state = start.about.state.copy()
    (compliance,) = (k for k, (one, _) in enumerate(law.slots, RIG) if one.name == "compliance")
    state[compliance] = -8.0
    bent = laid(law, grid.noise, start._replace(about=replace(start.about, state=state)))
    steps = np.arange(1, 41)
    times, depths = press.times[-1] + 0.01 * steps, press.indentations[-1] + 2e-3 * steps
    _, variance = Filter(bent).ahead(times, depths)
    assert np.sqrt(variance.max()) < 100.0 * press.stresses.max()


def test_another_spot_has_a_contact_point_of_its_own() -> None:
    mean, covariance = Posterior.of(Filter(laid_on(1, shift=0.015)[0])).tissue
    assert abs(mean[3] - 0.015) < 3.0 * math.sqrt(covariance[3, 3]) < 0.015


def test_tip_lags_behind_the_play_of_its_drive_block_by_block_as_in_the_whole_motion() -> None:
    samples = pressed(2)
    back = samples.indentations[::-1]
    turned = samples._replace(indentations=np.append(back[:-1:2], back[::-2])[: back.size])
    press = gathered(blocks_of(turned), 0.0, 40)
    law = law_of(press, replace(NOTHING_UNKNOWN, backlash_sd=5e-4))
    about = nowhere(law, law.coordinates[0], 0.0)
    whole = law.moves(press, about.stresses, about)[:, 0]
    # It turns twice: the tip is behind by the whole play, and where the drive is again.
    ends = [whole[0], whole.max(), whole[-1]]
    assert ends == pytest.approx([0.0, 5e-4 / GEOMETRY.length, 0.0], abs=1e-12)
    for points in range(1, whole.size, 7):
        own = {name: getattr(press, name)[points:] for name in ("times", "indentations", "speeds")}
        path = Path(press.times[:points], press.indentations[:points], press.start).needed
        tail = replace(press, earlier=path.indentations, **own)
        found = law.moves(tail, about.stresses[points:], about)[:, 0]
        np.testing.assert_array_equal(found, whole[points:])


@pytest.mark.parametrize("rate", [100.0, 200.0, 300.0, 400.0, 500.0, 1000.0])
def test_cells_follow_the_turns_of_a_motion_at_any_rate(rate: float) -> None:
    """Of three or four samples two points changed their order, and no cell at a turn counted."""
    times = np.arange(0.0, 3.0, 1.0 / rate)
    strains = np.interp(times, [0.0, 1.003, 2.003, 2.5], [0.0, 0.25, 0.25, 0.0])
    record = Record(0.0)
    for time, strain in zip(times.tolist(), strains.tolist(), strict=True):
        record.add(time, strain, 1e3 * strain, is_observed=True)
    record.close()
    press = gathered(record.blocks, 0.0, 40)
    assert press.missed.max() < 2e-3
    np.testing.assert_allclose(
        press.indentations, np.interp(press.times, times, strains), atol=2e-3
    )


def test_press_with_many_corners_has_few_cells() -> None:
    samples = pressed(2)
    # Stamps of a busy computer: each tenth sample seems to come late.
    stamps = samples.times + np.where(np.arange(samples.times.size) % 10 == 0, 0.8 / RATE_HZ, 0.0)
    press = gathered(blocks_of(samples._replace(times=stamps)), 0.0, 40)
    assert press.middles.size <= 40 + 2 * 6


def moved_in_steps(seed: int) -> Samples:
    """Simulate a press for 5 s whose depth changes each 0.2 s: more corners than cells."""
    generator = np.random.default_rng(seed)
    starts, depths = 0.3 + 0.2 * np.arange(24), generator.uniform(0.1, 0.2, 24)
    knots = np.append([0.0, 0.3], np.stack([starts + 0.06, starts + 0.2]).T)
    path, times = np.append([0.0, 0.0], np.repeat(depths, 2)), np.arange(0.29, 5.1, 0.005)
    tissue = 600.0, 8.0, 0.13
    clean = stress_of_piecewise_linear_strain(knots, path, times, FdenModel(*tissue))
    stresses = clean + generator.normal(0.0, 0.1 * NOISE, times.size)
    return Samples(times - times[0], np.interp(times, knots, path), stresses, tissue, clean)


@pytest.mark.parametrize("seed", first(0, 1, 2, 3, 4, 5, 6, 7))
def test_cells_that_the_motion_turns_in_are_no_better_than_they_are(seed: int) -> None:
    samples = moved_in_steps(seed)
    estimate = released(samples, NOTHING_UNKNOWN, noise=0.1 * NOISE)[1]
    assert np.abs(off(estimate, samples.tissue)).max() < 4.0


def test_same_samples_in_other_parts_give_the_same_bits() -> None:
    parts = (1, 0), (5, 2), (37, 20)
    found = [released(pressed(3), Uncertainty(), *each)[1] for each in parts]
    assert len({(one.mean.tobytes(), one.covariance.tobytes()) for one in found}) == 1


def test_rounds_of_several_places_are_apart_and_odds_wait_for_all_of_them() -> None:
    """A touch that may be of three places: all in one block would hold up a live estimate."""
    samples, before = pressed(2), released(pressed(1))[0]
    config = EstimatorConfig(uncertainty=EXACT)
    estimator = GridEstimator(Setting(config, GEOMETRY, NOISE, CONTACT_POINT_SD))
    estimator.may_continue(before, 0.0, 0.0)
    estimator.touch(Touch(0.3 * NOISE, 0.0, np.zeros((3, 0))), 1.0)
    places = estimator._hypotheses
    filters, weights = [one.place.filter for one in places], [one.log_weight for one in places]
    newest, gaps, held = 0.0, [], 0
    for time, u, stress in zip(*(column.tolist() for column in samples[:3]), strict=True):
        was_held, is_behind = places[0].held is not None, time < 0.2
        estimator.add([time], [u], [stress], [True], is_behind=is_behind)
        if not is_behind:
            estimator.work()
        laid = [one.place.filter for one in places]
        changed = sum(a is not b for a, b in zip(laid, filters, strict=True))
        assert changed <= (not is_behind)
        if changed:
            gaps.append(time - newest)
            newest = time
        if was_held and places[0].held is not None:
            held += 1
            assert [one.log_weight for one in places] == weights
        filters, weights = laid, [one.log_weight for one in places]
        if len(estimator._hypotheses) < len(places):
            break
    assert held
    assert len(gaps) >= 3
    assert min(gaps[1:]) > 0.037


@pytest.mark.parametrize("seed", first(0, 1, 2))
def test_another_laying_changes_little(seed: int) -> None:
    """A settled grid is laid anew: by less than .05 of a deviation in the mean."""
    estimator, before = released(pressed(seed), Uncertainty())
    own = estimator.best.filter
    assert own is not None
    again = laid(own.grid.law, own.grid.noise, own.grid.after)
    mean = Posterior.of(Filter(again)).tissue[0][:3]
    assert (np.abs(mean - before.mean) / before.deviations).max() < 0.05


def test_components_reproduce_mean_and_covariance_and_what_is_not_settled_is_not_claimed() -> None:
    estimator, found = released(pressed(4))
    assert 1 < len(found.components) <= 8
    mean, covariance = moments(found.components)
    np.testing.assert_allclose(mean, found.mean, atol=1e-9)
    np.testing.assert_allclose(covariance, found.covariance, atol=1e-9)
    assert found.known == ParameterSet.ALL
    estimator.best.filter.grid.is_settled = False
    assert estimator.estimate().known == ParameterSet.NONE


@pytest.mark.parametrize("count", counts(3, 12))
def test_errors_are_as_large_as_their_deviations(count: int) -> None:
    """Of presses of the exact law: rms of error over deviation .3 to 1.6, none beyond 3.5."""
    presses = [pressed(seed, hold=0.5) for seed in range(count)]
    errors = np.array([off(released(press)[1], press.tissue) for press in presses])
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all((rms > 0.3) & (rms < 1.6)), rms
    assert np.max(np.abs(errors)) < 3.5
