# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Online fractional integral: against closed forms, and against the full memory."""

from __future__ import annotations

import math
import pickle
import sys
import tracemalloc

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from scipy.special import gamma

from fden_ros.core.law.fractional_integral import FractionalIntegral, _falling_rates
from fden_ros.core.law.kernel import LONGEST_MEMORY, SHORTEST_STEP, kernel_weights

ORDERS = (0.02, 0.131, 0.25, 0.32, 0.5, 0.6)

# A grid of orders, because fitting the weights of a new one takes 20 ms.
orders = st.integers(2, 100).map(lambda n: n / 100)
steps = st.lists(
    st.floats(math.log(2.0 * SHORTEST_STEP), math.log(10.0)).map(math.exp),
    min_size=1,
    max_size=30,
)


def values_at(times):
    return st.lists(st.floats(-1e3, 1e3), min_size=len(times), max_size=len(times)).map(np.array)


def integrated(order_list, times, values):
    """Every output of the online integral, shape (times, orders)."""
    integral = FractionalIntegral(order_list)
    results = [integral.start(float(values[0]))]
    for step, value in zip(np.diff(times), values[1:], strict=True):
        results.append(integral.advance(float(step), float(value)))
    return np.array(results)


def product_integral(order, times, values):
    """D^-order at the last time of linear pieces, with the full memory.

    Differences of powers are formed without cancellation, since a step may be 1e-6 of its age.
    """
    age, step = times[-1] - times[:-1], np.diff(times)
    slope = np.diff(values) / step
    younger = np.append(times[-1] - times[1:-1], 0.0)
    shrink = np.append(np.log1p(-step[:-1] / age[:-1]), -np.inf)
    zeroth = -(age**order) * np.expm1(order * shrink) / gamma(order + 1.0)
    first = -(age ** (order + 1.0)) * np.expm1((order + 1.0) * shrink) / gamma(order + 2.0)
    first -= step * younger**order / gamma(order + 1.0)
    return math.fsum(values[:-1] * zeroth + slope * first)


def magnitude(order, times, values):
    """What an error is measured against: the integral of |f|'s bound."""
    return np.max(np.abs(values)) * times[-1] ** order / gamma(order + 1.0) + 1e-300


def test_reference_itself_agrees_with_adaptive_quadrature():
    times = np.array([0.0, 0.3, 0.31, 2.0])
    values = np.array([1.0, -2.0, 5.0, 4.0])
    order = 0.131
    # With v = (t - xi)^order the kernel's singularity is gone.
    corners = [(times[-1] - t) ** order for t in times[::-1]]
    exact = mpmath.quad(
        lambda v: float(np.interp(float(times[-1] - v ** (1 / order)), times, values)), corners
    ) / mpmath.gamma(1.0 + order)
    assert product_integral(order, times, values) == pytest.approx(float(exact), rel=1e-9)


@examples(200)
@given(data=st.data(), order=orders, step_list=steps)
def test_any_data_on_any_steps_equals_the_full_memory(data, order, step_list):
    times = np.concatenate([[0.0], np.cumsum(step_list)])
    values = data.draw(values_at(times))
    result = integrated([order], times, values)[-1, 0]
    # The kernel is good to 3e-11; rounding of the least squares' large weights adds to it.
    assert abs(result - product_integral(order, times, values)) <= 1e-9 * magnitude(
        order, times, values
    )


@pytest.mark.parametrize("order", ORDERS)
def test_sine_becomes_its_phase_shifted_self(order):
    # D^-b sin(t) = t^(1+b) E_{2,2+b}(-t^2), its transient included; the series in 40 digits.
    times = np.linspace(0.0, 12.0, 6001)
    result = integrated([order], times, np.sin(times))[:, 0]
    with mpmath.workdps(40):
        for index in (1, 40, 1500, 3000, 6000):
            t = mpmath.mpf(float(times[index]))
            exact = mpmath.nsum(
                lambda k, t=t: (
                    (-1) ** int(k) * t ** (2 * k + 1 + order) / mpmath.gamma(2 * k + 2 + order)
                ),
                [0, 60],
            )
            # Interpolation of the sine: h^2/8 = 5e-7, times t^b/Gamma(1+b) < 3.6.
            assert abs(result[index] - float(exact)) < 2e-6


def test_step_at_the_start_counts_in_full():
    integral = FractionalIntegral([0.131])
    integral.start(2.0)
    result = integral.advance(0.5, 2.0)[0]
    assert result == pytest.approx(2.0 * 0.5**0.131 / gamma(1.131), rel=1e-12)


def test_start_forgets_the_past():
    rng = np.random.default_rng(1)
    integral, fresh = FractionalIntegral([0.131]), FractionalIntegral([0.131])
    integral.start(5.0)
    for step in rng.uniform(1e-4, 1.0, 50):
        integral.advance(float(step), float(rng.normal()))
    integral.start(1.0)
    fresh.start(1.0)
    for step in rng.uniform(1e-4, 1.0, 20):
        value = float(rng.normal())
        assert np.array_equal(integral.advance(step, value), fresh.advance(step, value))


@examples(50)
@given(data=st.data(), step_list=steps, repeats=st.integers(1, 4))
def test_samples_added_together_are_what_they_are_one_by_one(data, step_list, repeats):
    step_list = step_list * repeats
    times = np.concatenate([[0.0], np.cumsum(step_list)])
    values = data.draw(values_at(times))
    one_by_one = integrated(ORDERS, times, values)
    together = FractionalIntegral(ORDERS)
    together.start(float(values[0]))
    for step, value in zip(step_list, values[1:], strict=True):
        together.add(step, float(value))
    total, nothing = together.take_sum(), together.take_sum()
    for column, order in enumerate(ORDERS):
        bound = 1e-11 * len(step_list) * magnitude(order, times, values)
        assert abs(total[column] - one_by_one[:, column].sum()) <= bound
    assert not np.any(nothing)


def jittered_times(rng, duration, mean_step, knots):
    steps = rng.uniform(0.2 * mean_step, 1.8 * mean_step, int(duration / mean_step))
    free = np.cumsum(steps)
    free = free[free < duration]
    clear = np.min(np.abs(np.subtract.outer(free, knots)), axis=1) > 2.0 * SHORTEST_STEP
    return np.sort(np.concatenate([[0.0], free[clear], knots]))


def test_ramp_and_hold_of_1000_s_on_jittered_steps_is_within_1e_9_of_the_peak():
    # The promise: full-memory product integration, jittered steps, every order.
    rng = np.random.default_rng(5)
    times = jittered_times(rng, 1000.0, 0.01, [100.0, 1000.0])
    values = np.interp(times, [0.0, 100.0, 1000.0], [0.0, 2.0, 2.0])
    result = integrated(ORDERS, times, values)
    peaks = np.max(np.abs(result), axis=0)
    instants = np.unique(np.geomspace(1, times.size - 1, 60).astype(int))
    for column, order in enumerate(ORDERS):
        for index in instants:
            exact = product_integral(order, times[: index + 1], values[: index + 1])
            assert abs(result[index, column] - exact) <= 1e-9 * peaks[column], (order, index)
        # And the closed form of a ramp and hold, which needs no sum at all.
        t, corner = times[-1], 100.0
        closed = 0.02 * (t ** (1 + order) - (t - corner) ** (1 + order)) / gamma(2 + order)
        assert abs(result[-1, column] - closed) <= 1e-9 * peaks[column]


@pytest.mark.parametrize("order", [*ORDERS, 1.0])
def test_sum_of_exponentials_is_the_kernel_to_1e_10(order):
    from fden_ros.core.law.kernel import relaxation_rates

    times = np.geomspace(SHORTEST_STEP, LONGEST_MEMORY, 4321)
    kernel = times ** (order - 1.0) / gamma(order)
    sum_of_exponentials = np.exp(-np.outer(times, relaxation_rates())) @ kernel_weights(order)
    assert np.max(np.abs(sum_of_exponentials / kernel - 1.0)) < 1e-10


@pytest.mark.parametrize("order", [0.0, -0.1, 1.5, math.nan])
def test_order_outside_the_kernel_is_refused(order):
    with pytest.raises(ValueError, match="must be in"):
        kernel_weights(order)


def calls_made(integral, step_list):
    """How many functions, Python's and C's, are called for these samples."""
    count = 0

    def profile(_frame, event, _argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(profile)
    try:
        for step in step_list:
            integral.advance(step, step)
    finally:
        sys.setprofile(None)
    return count


def test_work_and_memory_per_sample_do_not_grow_with_the_history():
    rng = np.random.default_rng(7)
    tenths = [rng.uniform(1e-4, 2e-3, 2000).tolist() for _ in range(10)]
    integral = FractionalIntegral([0.131, 0.32])
    integral.start(0.0)
    tracemalloc.start()
    try:
        calls, sizes, peaks = [], [], []
        for tenth in tenths:
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            calls.append(calls_made(integral, tenth))
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
            sizes.append(len(pickle.dumps(integral)))
    finally:
        tracemalloc.stop()
    # The same calls, on arrays of the same size, from the first tenth to the last.
    assert calls[0] == calls[-1]
    assert max(sizes) - min(sizes) <= 32  # a float may pickle into a few bytes more
    # What one sample needs beside the state: far below 8 bytes a sample of history (16 kB).
    assert max(peaks) < 8_000


def test_no_factor_of_the_recursion_is_near_where_numbers_are_flushed_to_zero() -> None:
    # A library built with -ffast-math lets the whole process flush subnormal numbers to zero.
    standing = -float(_falling_rates()[0]) * SHORTEST_STEP
    assert standing > 1e200 * sys.float_info.min
    assert math.exp(-standing * 1e18) == 1.0
