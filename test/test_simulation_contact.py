# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact that cannot pull: against the law itself, and against time stepping on a fine grid."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import gamma, roots_jacobi

from fden_ros.simulation.model import FdenModel
from simulation.closed_form import pieces_of
from simulation.contact import Stiffening, contacts_of_moves
from simulation.trajectory import Approach, Palpation, Path, RampHold

TISSUES = [(0.02, 6.0), (0.131, 8.5), (0.6, 10.0)]
QUICK_PALPATION = Palpation(
    strain_rate=0.5, max_strain=0.25, hold_s=0.3, presses=3, pause_s=0.2, lift_m=0.002
)


def moves_over_fresh_tissue(trajectory):
    path = Path(strain=-0.1, length_m=0.02)
    path.rest(0.1)
    trajectory.press(path, Approach(distance_m=0.002, slow_distance_m=0.001))
    path.rest(0.2)
    return path.moves


def strain_at(moves, times):
    strain = np.empty_like(times)
    for move in moves:
        during = (times >= move.start) & (times <= move.stop)
        strain[during] = move.strain_at(times[during])
    return strain


def fractional_stress(history, time):
    """D^-alpha of the stress at `time`: Gauss-Jacobi last, else tanh-sinh."""
    model = history.model
    order = model.fractional_order
    k = 0.025 * np.arange(-160, 161)
    from_end = 1.0 / (1.0 + np.exp(np.pi * np.sinh(k)))
    weights = 0.025 * np.pi / 4.0 * np.cosh(k) / np.cosh(0.5 * np.pi * np.sinh(k)) ** 2
    end_nodes, end_weights = roots_jacobi(40, order - 1.0, 0.0)
    total = 0.0
    for contact in history.contacts:
        for piece in (p for move in contact.moves for p in pieces_of(move, model)):
            start, stop = piece.start, piece.stop
            if start >= time:
                continue
            if time <= stop:
                stop = 0.5 * (start + time)
                nodes = stop + (time - stop) * 0.5 * (1.0 + end_nodes)
                half = 0.5 * (time - stop)
                total += half**order * end_weights @ contact.stress(nodes, model)
            length = stop - start
            nodes = start + length * (1.0 - from_end)
            inside = (nodes > start) & (nodes < stop)
            age = (time - stop) + length * from_end[inside]
            stress = contact.stress(nodes[inside], model)
            total += length * np.sum(weights[inside] * stress * age ** (order - 1.0))
    return total / gamma(order)


@pytest.mark.parametrize("order, nonlinear", TISSUES)
def test_contact_obeys_the_law_and_the_free_surface_lies_below_the_probe(order, nonlinear):
    model = FdenModel(520.0, nonlinear, order)
    moves = moves_over_fresh_tissue(QUICK_PALPATION)
    history = contacts_of_moves(moves, model)
    assert len(history.contacts) == 3
    peak = model.phi(0.25)
    for contact in history.contacts:
        shares = np.array([0.003, 0.05, 0.3, 0.55, 0.8, 0.97])
        times = contact.start + (contact.stop - contact.start) * shares
        law = model.phi(strain_at(moves, times))
        integral = [fractional_stress(history, time) for time in times]
        np.testing.assert_allclose(integral, law, rtol=0.0, atol=1e-9 * peak)
    assert history.contacts[0].max_strain(model) == pytest.approx(0.25)
    contacts = history.contacts
    for before, after in itertools.pairwise(contacts):
        flight = np.linspace(before.stop, after.start, 100)[1:]
        surface = after.memory.free_phi(flight, model)
        probe = model.phi(strain_at(moves, flight))
        assert np.all(probe[:-1] < surface[:-1])
        assert np.all(np.diff(surface) < 0.0)
        assert probe[-1] == pytest.approx(surface[-1], rel=1e-9)


@pytest.mark.parametrize("ratio", [1.5, 4.0])
def test_stress_in_a_stiffer_tissue_on_the_way_agrees_with_time_stepping(ratio):
    model = FdenModel(520.0, 8.5, 0.131)
    moves = moves_over_fresh_tissue(RampHold(strain_rate=0.2, max_strain=0.25, hold_s=0.5))
    step = 2.5e-4
    times = np.arange(0.0, moves[-1].stop, step)
    strain = strain_at(moves, times)
    met = times[int(np.argmax(strain >= 0.14))]
    weights = np.diff(np.arange(times.size + 1.0) ** (1.0 - 0.131))
    weights *= step**-0.131 / gamma(2.0 - 0.131)
    phi = np.maximum(model.phi(strain), 0.0) * np.where(times >= met, ratio, 1.0)
    stepped = np.convolve(np.diff(phi, prepend=0.0), weights)[: times.size]
    history = contacts_of_moves(moves, model, Stiffening(0.14, ratio))
    (contact,) = history.contacts
    # Just after the step the stress itself is singular, and stepping is none.
    pressed = (times < contact.stop - 0.01) & (np.abs(times - met - 0.01) > 0.011)
    error = (history.stress(times) - stepped)[pressed]
    assert np.abs(error).max() < 2e-3 * stepped.max()
