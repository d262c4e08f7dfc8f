# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The response at the nodes, and between them."""

from __future__ import annotations

import numpy as np
import pytest

from fden_ros.core.law.geometry import PassThrough
from fden_ros.core.law.interpolation import LogStiffnessGrid
from fden_ros.core.law.kernel import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    order_interpolation,
    order_nodes,
)
from fden_ros.core.law.stress_response import StressBasis
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain

GRID = LogStiffnessGrid(np.log(8.4), 0.8)


def jittered_times(count, step, seed=0):
    rng = np.random.default_rng(seed)
    return np.arange(count) * step + rng.uniform(0.0, 0.4 * step, count)


def last_response(basis, times, compressions):
    """Response to the newest sample alone."""
    previous = 0.0
    for index, (time, compression) in enumerate(zip(times, compressions, strict=True)):
        if index == len(times) - 1:
            basis.discard_block()
        basis.press(time - previous, compression)
        previous = time
    return basis.take_block()[:3]


def interpolated(law, log_gn, order, origin_weights=(1.0,)):
    first, in_gn, _ = GRID.stencil(log_gn)
    in_order, _ = order_interpolation()(order)
    inner = np.outer(origin_weights, in_order).ravel()
    return float(in_gn @ law[first : first + in_gn.size] @ inner)


@pytest.mark.parametrize("order", [0.02, 0.131, 0.32, 0.6])
@pytest.mark.parametrize("gn", [5.3, 8.4, 13.1])
def test_stress_of_a_ramp_and_hold_is_the_closed_form_between_the_nodes(order, gn):
    times = jittered_times(3000, 1e-3)
    knots, strains = [0.0, 1.5, 10.0], [0.0, 0.3, 0.3]
    compressions = np.interp(times, knots, strains)
    compressions[0] = 0.0
    basis = StressBasis(PassThrough(), GRID.nodes, np.zeros(1))
    law, _, _ = last_response(basis, times, compressions)
    model = FdenModel(1.0, gn, order)
    exact = stress_of_piecewise_linear_strain(knots, strains, times[-1:], model)[0]
    assert interpolated(law, np.log(gn), order) == pytest.approx(exact, rel=2e-5)


def test_nodes_of_the_origin_shift_the_strain():
    times = jittered_times(500, 2e-3)
    motion = 0.3 * times
    shifted = last_response(
        StressBasis(PassThrough(), GRID.nodes, np.array([-0.01, 0.0, 0.01])), times, motion
    )[0].reshape(GRID.nodes.size, 3, -1)
    for index, origin in enumerate((-0.01, 0.0, 0.01)):
        alone = last_response(
            StressBasis(PassThrough(), GRID.nodes, np.zeros(1)), times, motion - origin
        )[0]
        np.testing.assert_allclose(shifted[:, index], alone, rtol=1e-12)


@pytest.mark.parametrize("order", [0.131, 0.32, 0.6])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_touch_between_two_samples_counts_from_when_it_was(order, share):
    # Coarse samples: the touch lies in the step before the first sample in contact.
    step, speed, gn = 0.01, 0.2, 8.4
    touch = (1.0 + share) * step
    times = np.arange(5) * step
    model = FdenModel(1.0, gn, order)
    knots = [touch, touch + 1.0]
    for size in (3, 5):
        basis = StressBasis(PassThrough(), GRID.nodes, np.zeros(1))
        law, _, _ = last_response(basis, times[:size], speed * (times[:size] - touch))
        last = times[size - 1 : size]
        exact = stress_of_piecewise_linear_strain(knots, [0.0, speed], last, model)
        assert interpolated(law, np.log(gn), order) == pytest.approx(exact[0], rel=1e-5)


@pytest.mark.parametrize("order", [0.131, 0.32])
def test_coarse_samples_of_a_ramp_are_as_exact_as_fine_ones(order):
    # In steps of 0.02 the elastic response is anything but straight.
    gn, rate, top = 13.1, 2.0, 0.3
    times = np.arange(0.0, top / rate + 1e-9, 0.01)
    law, _, _ = last_response(
        StressBasis(PassThrough(), GRID.nodes, np.zeros(1)), times, rate * times
    )
    model = FdenModel(1.0, gn, order)
    exact = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, rate], times[-1:], model)[0]
    assert interpolated(law, np.log(gn), order) == pytest.approx(exact, rel=1e-3)


def test_parts_of_a_step_do_not_count_as_samples():
    def block(rate):
        basis = StressBasis(PassThrough(), GRID.nodes, np.zeros(1))
        for index in range(21):
            if index == 11:
                basis.discard_block()
            basis.press(0.01 if index else 0.0, rate * 0.01 * index)
        return basis.take_block()[0][0, 5]

    # Node 0 is straight at these strains, so the response is proportional to the rate.
    assert block(0.4) == pytest.approx(20.0 * block(0.02), rel=1e-9)


def test_block_is_the_mean_of_its_samples():
    times = jittered_times(40, 5e-3)
    motion = 0.5 * times
    single, block = (StressBasis(PassThrough(), GRID.nodes, np.zeros(1)) for _ in range(2))
    responses, previous = [], 0.0
    for time, compression in zip(times, motion, strict=True):
        single.press(time - previous, compression)
        responses.append(single.take_block()[0])
        block.press(time - previous, compression)
        previous = time
    np.testing.assert_allclose(block.take_block()[0], np.mean(responses, axis=0), rtol=1e-10)


def test_what_was_pressed_is_remembered_unchanged_after_a_freeze():
    # A tissue that changes into itself: what is frozen and what follows add up to the whole.
    gn, order = 7.7, 0.2
    times = jittered_times(600, 2e-3)
    motion = 0.25 * times
    whole, cut = (StressBasis(PassThrough(), GRID.nodes, np.zeros(1)) for _ in range(2))
    previous = 0.0
    for index, (time, compression) in enumerate(zip(times, motion, strict=True)):
        if index == 300:
            first, in_gn, _ = GRID.stencil(np.log(gn))
            cut.freeze(first, in_gn[:, None], 0.02)
        if index == 599:
            whole.discard_block(), cut.discard_block()
        whole.press(time - previous, compression)
        cut.press(time - previous, compression)
        previous = time
    expected = interpolated(whole.take_block()[0], np.log(gn), order)
    law, free, *_ = cut.take_block()
    in_order, _ = order_interpolation()(order)
    total = interpolated(law, np.log(gn), order) + float(in_order @ free)
    assert total == pytest.approx(expected, rel=1e-5)


def test_order_interpolation_is_exact_on_the_nodes_and_close_between_them():
    interpolation = order_interpolation()
    nodes = np.array(order_nodes())
    weights, _ = interpolation(nodes)
    np.testing.assert_allclose(weights, np.eye(nodes.size), atol=1e-9)
    for time in (1e-3, 0.1, 30.0):
        for order in np.linspace(LOWEST_ORDER, HIGHEST_ORDER, 23):
            weights, slopes = interpolation(float(order))
            assert weights @ time**-nodes == pytest.approx(time**-order, rel=1e-5)
            assert slopes @ time**-nodes == pytest.approx(
                -np.log(time) * time**-order, rel=1e-3, abs=1e-4
            )
