# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Online fractional integral: against closed forms, and against the full memory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from scipy.special import gamma

from fden_ros.core.law.fractional_integral import FractionalIntegral
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


@pytest.mark.parametrize("order", [*ORDERS, 1.0])
def test_sum_of_exponentials_is_the_kernel_to_1e_10(order):
    from fden_ros.core.law.kernel import relaxation_rates

    times = np.geomspace(SHORTEST_STEP, LONGEST_MEMORY, 4321)
    kernel = times ** (order - 1.0) / gamma(order)
    sum_of_exponentials = np.exp(-np.outer(times, relaxation_rates())) @ kernel_weights(order)
    assert np.max(np.abs(sum_of_exponentials / kernel - 1.0)) < 1e-10
