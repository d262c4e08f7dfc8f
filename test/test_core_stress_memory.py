# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The memory of the stress, against the full memory."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from scipy.special import gamma

from fden_ros.core.law.relaxation import memory_weights
from fden_ros.core.law.stress_memory import StressMemory

ORDERS = (0.02, 0.131, 0.25, 0.32, 0.5, 0.6)

orders = st.floats(0.02, 0.65)
steps = st.lists(
    st.floats(math.log(1e-3), math.log(10.0)).map(math.exp),
    min_size=1,
    max_size=30,
)


def values_at(times):
    return st.lists(st.floats(-1e3, 1e3), min_size=len(times), max_size=len(times)).map(np.array)


def integrated(order, times, values):
    """Every output of the memory, from the second time on."""
    memory, results = StressMemory(), []
    for step, value in zip(np.diff(times), values[1:], strict=True):
        memory.press(float(step), float(value))
        results.append(memory_weights(order) @ memory.means(1))
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
    values = np.concatenate([[0.0], data.draw(values_at(times[1:]))])
    result = integrated(order, times, values)[-1]
    # A thousandth of a second is some 20 times the fastest memory: of its last step 1 % is lost.
    bound = 1e-5 * magnitude(order, times, values) + 0.01 * magnitude(
        order, np.array([step_list[-1]]), values
    )
    assert abs(result - product_integral(order, times, values)) <= bound


def test_a_smooth_stress_is_integrated_to_1e_5():
    times = np.linspace(0.0, 2.0, 2001)
    for order in ORDERS:
        found = integrated(order, times, times)
        exact = times[1:] ** (1.0 + order) / gamma(order + 2.0)
        assert np.all(np.abs(found - exact) <= 2e-5 * exact[-1])


@examples(50)
@given(data=st.data(), step_list=steps, repeats=st.integers(1, 4))
def test_samples_taken_together_are_what_they_are_one_by_one(data, step_list, repeats):
    step_list = step_list * repeats
    times = np.concatenate([[0.0], np.cumsum(step_list)])
    values = np.concatenate([[0.0], data.draw(values_at(times[1:]))])
    together = StressMemory()
    for step, value in zip(step_list, values[1:], strict=True):
        together.press(step, float(value))
    means, nothing = together.means(len(step_list)), together.means(1)
    for order in ORDERS:
        bound = 1e-11 * magnitude(order, times, values)
        one_by_one = integrated(order, times, values).mean()
        assert abs(memory_weights(order) @ means - one_by_one) <= bound
    assert not np.any(nothing)


def test_a_rest_is_a_stress_of_0_for_its_time():
    pressed, rested = StressMemory(), StressMemory()
    for memory in (pressed, rested):
        memory.press(1.0, 100.0)
    rested.rest(3.0)
    pressed.press(1e-3, 0.0)
    pressed.press(2.999, 0.0)
    for order in ORDERS:
        free = pressed.free_response(0.1, order)
        assert abs(rested.free_response(0.1, order) / free - 1.0) < 1e-12
