# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Computations in parts: what a block of samples may cost, and that nothing else depends on it."""

from __future__ import annotations

import math
import pickle
from functools import partial

import numpy as np
import pytest
from pipeline_helpers import identified, items_of, parameters_of, summaries_of

from fden_ros.core.estimation import search
from fden_ros.core.estimation.parts import Advanced, Parts
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.oscillation import palpation_frequency
from simulation.scenario import ramp_scenario
from simulation.simulate import simulate


def counted(costs: tuple[int, ...]) -> Parts[int]:
    """A computation of parts with costs, which returns their sum."""
    yield from costs
    return sum(costs)


def test_what_a_part_costs_more_than_the_budget_is_taken_off_the_next():
    computation = Advanced(partial(counted, (10, 10, 10, 10)))
    assert not computation.advance(15)  # two parts, five too many
    assert not computation.advance(5)  # which is all of this
    assert not computation.advance(15)  # the other two
    assert computation.advance(6) and computation.result() == 40


def test_a_computation_that_is_copied_goes_on_from_where_it_was():
    computation = Advanced(partial(counted, (10, 10, 10)))
    computation.advance(15)
    copy = pickle.loads(pickle.dumps(computation))
    assert [copy.advance(5), copy.advance(10), copy.advance(1)] == [False, False, True]
    assert copy.result() == 30


RECORDING = simulate(ramp_scenario(strain_rate=0.2, hold_s=1.0, rate_hz=500.0, seed=1))


def blocks_of_solutions(monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], bool]:
    """Over how many blocks each solution of a press went on, and whether it has converged."""
    update, lengths = PressPosterior.update, [0]

    def watched(press, *args, **named):
        was_solving = press.is_solving
        found = update(press, *args, **named)
        if was_solving:
            lengths[-1] += 1
        if was_solving and not press.is_solving:
            lengths.append(0)
        return found

    monkeypatch.setattr(PressPosterior, "update", watched)
    _, outputs = identified(items_of(RECORDING), parameters_of(RECORDING))
    (summary,) = summaries_of(outputs)
    return lengths, summary.converged


def test_a_solution_ends_within_half_a_second_of_samples(monkeypatch):
    lengths, has_converged = blocks_of_solutions(monkeypatch)
    assert len(lengths) > 5 and 1 < max(lengths) <= 50
    assert has_converged


def test_a_search_that_may_cost_nothing_claims_nothing(monkeypatch):
    monkeypatch.setattr(search, "_MOST_EVALUATIONS", 2)
    lengths, has_converged = blocks_of_solutions(monkeypatch)
    assert len(lengths) > 3 and not has_converged


@pytest.mark.parametrize("gap", [9.0, 1e9])
def test_a_palpation_is_found_anew_after_a_gap_which_itself_is_not_looked_at(gap, monkeypatch):
    looks: list[int] = []
    look = palpation_frequency.dominant_frequency

    def noted(values, rate):
        looks.append(values.size)
        return look(values, rate)

    monkeypatch.setattr(palpation_frequency, "dominant_frequency", noted)
    finder = palpation_frequency.PalpationFrequency()
    found = []
    for begin, frequency in ((0.0, 1.0), (10.0 + gap, 2.0)):
        for time in np.arange(0.0, 10.0, 0.02):
            finder.add(begin + time, math.sin(2.0 * math.pi * frequency * time))
        found.append(finder.value)
    assert found == [pytest.approx(1.0, rel=0.02), pytest.approx(2.0, rel=0.02)]
    # Twice a second, from 3 s on.
    assert len(looks) <= 2 * 16
