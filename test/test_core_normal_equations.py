# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The sums against the blocks themselves, at any state and added in any groups."""

from __future__ import annotations

import numpy as np
import pytest

from fden_ros.core.estimation.gauss_newton import _inverse_roots
from fden_ros.core.estimation.normal_equations import NormalEquations
from fden_ros.core.estimation.response_sums import MOST_BEHIND
from fden_ros.core.law.interpolation import LogStiffnessGrid
from fden_ros.core.law.kernel import order_nodes

GRID = LogStiffnessGrid(2.0, 0.8)
ORIGINS = np.array([-0.01, 0.0, 0.01])
LINEAR = ("first", "scaled", "third")
STATE = np.array([0.4, 2.13, 0.21, 0.004, 0.3, -0.4, 0.7])
PRECISION = 0.3


def blocks(count, seed=5, given_order=None):
    rng = np.random.default_rng(seed)
    equations = NormalEquations(GRID, ORIGINS, LINEAR, ("scaled",), given_order)
    inner = ORIGINS.size * len(order_nodes())
    return equations, [
        (
            equations.respond(
                rng.normal(size=(GRID.nodes.size, inner)),
                rng.normal(size=len(order_nodes())),
                rng.normal(size=len(LINEAR)),
                rng.normal(),
            ),
            rng.uniform(0.5, 2.0),
        )
        for _ in range(count)
    ]


def products(equations, taken, state):
    rows = np.array([np.hstack(equations.residual(response, state)) for response, _ in taken])
    weights = np.array([1.0 / noise for _, noise in taken])
    return (rows * weights[:, None]).T @ rows


@pytest.mark.parametrize("group", [1, 7, 5 * MOST_BEHIND])
def test_sums_give_the_products_of_residuals_and_derivatives(group):
    equations, taken = blocks(2 * MOST_BEHIND + 9)
    for k, (response, noise) in enumerate(taken):
        equations.add(response, noise, 10)
        if k % group == group - 1:
            equations.at_state(STATE)
    assert equations.at_state(STATE) == pytest.approx(products(equations, taken, STATE), rel=1e-9)
    node = 9
    states = np.tile(STATE, (GRID.nodes.size, 1))
    states[:, 1] = GRID.nodes
    expected = products(equations, taken, states[node])
    expected[2, :] = expected[:, 2] = 0.0
    assert equations.at_nodes(states)[node] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_sums_for_a_given_order_are_those_for_any():
    states = np.tile(STATE, (GRID.nodes.size, 1))
    states[:, 1] = GRID.nodes
    found = []
    for given_order in (None, float(STATE[2])):
        equations, taken = blocks(2 * MOST_BEHIND + 9, given_order=given_order)
        for response, noise in taken:
            equations.add(response, noise, 10)
        found.append((equations.at_state(STATE), equations.at_nodes(states)))
    for given, learned in zip(found[1], found[0], strict=True):
        assert given == pytest.approx(learned, rel=1e-9, abs=1e-9 * np.abs(learned).max())


def test_derivatives_are_those_of_the_residual():
    equations, [(response, _)] = blocks(1)
    _, gradient = equations.residual(response, STATE)
    for index in range(STATE.size):
        step = np.zeros(STATE.size)
        step[index] = 1e-6
        above, below = (
            equations.residual(response, state)[0] for state in (STATE + step, STATE - step)
        )
        assert gradient[index] == pytest.approx((above - below) / 2e-6, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("between", [False, True])
def test_a_column_that_is_taken_out_leaves_what_its_parameter_cannot_explain(between):
    equations, taken = blocks(MOST_BEHIND + 5)
    for response, noise in taken:
        equations.add(response, noise, 10)
    if between:
        equations.at_state(STATE)
    index = equations.index("third")
    equations.marginalise(index, PRECISION)
    state = STATE.copy()
    state[index] = 0.0
    before = products(equations, taken, state)
    by_column, own = before[:, 1 + index], before[1 + index, 1 + index] + PRECISION
    expected = before - np.outer(by_column, by_column) / own
    expected[1 + index, :] = expected[:, 1 + index] = 0.0
    assert equations.at_state(state) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_inverses_are_bounded_where_rounding_has_left_a_singular_matrix():
    rng = np.random.default_rng(2)
    roots = rng.normal(size=(3, 20, 4))
    roots[1, :, 3] = roots[1, :, 2]
    matrices = roots.transpose(0, 2, 1) @ roots
    roots, log_determinants = _inverse_roots(matrices, np.full(4, 1e-3))
    inverses = roots.transpose(0, 2, 1) @ roots
    for k in (0, 2):
        assert inverses[k] @ matrices[k] == pytest.approx(np.eye(4), abs=1e-10)
        assert log_determinants[k] == pytest.approx(np.linalg.slogdet(matrices[k])[1])
    assert np.all(np.isfinite(inverses[1])) and np.all(np.linalg.eigvalsh(inverses[1]) > 0.0)
    assert inverses[1].max() < 1e12
