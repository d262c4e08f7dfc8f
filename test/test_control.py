# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force controller: its law, and in closed loop with simulated tissue and the pipeline."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from property_helpers import first

from benchmark.closed_loop import Program, Run, close_loop, tissues
from fden_ros.control.force_control import ForceControlConfig, ForceController, Gains
from fden_ros.control.live_tissue import Reading
from fden_ros.core.estimation.estimate import Estimate, ParameterSet
from fden_ros.core.outputs import ApparentStiffness, Flag, Phase, Status, TissueState

ALL = ParameterSet.ALL
#: Shorter than that of the benchmark, which runs all ten.
PROGRAM = Program(rest=2.5, work=1.5, back=1.0)
CONFIG = ForceControlConfig(safe_stiffness=100.0, force_limit=1.0, bandwidth=10.0)


def reading(stiffness: float, sd: float = 0.0) -> Reading:
    estimate = Estimate(6.3, 2.1, 0.0, np.zeros((3, 3)), 0.0, 0.0, 1.0, ALL, ALL, 1000)
    state = TissueState(
        stamp_ns=0,
        status=Status.CONVERGED,
        flags=Flag.NONE,
        site_id=1,
        contact_id=1,
        phase=Phase.LOADING,
        estimate=estimate,
        apparent_stiffness=ApparentStiffness(stiffness, sd, 0.1),
    )
    return Reading(state, estimate, 0.0)


def test_the_velocity_is_the_wanted_rate_of_force_over_the_live_stiffness() -> None:
    controller = ForceController(CONFIG)
    velocity = controller.step(0.0, 0.30, 0.0, 0.35, reading(40.0, 10.0))
    assert velocity == pytest.approx(10.0 * 0.05 / 50.0)
    assert controller.gains is Gains.LIVE


def test_without_an_estimate_the_safe_gains_are_used_at_once() -> None:
    controller = ForceController(CONFIG)
    controller.step(0.0, 0.30, 0.0, 0.35, reading(40.0))
    velocity = controller.step(0.005, 0.30, 0.0, 0.35, None)
    assert controller.gains is Gains.SAFE
    assert velocity == pytest.approx(10.0 * 0.05 / 100.0)


def test_on_tissue_stiffer_than_the_safe_one_a_loss_makes_nothing_faster() -> None:
    controller = ForceController(CONFIG)
    before = controller.step(0.0, 0.30, 0.0, 0.35, reading(300.0))
    assert controller.step(0.005, 0.30, 0.0, 0.35, None) == pytest.approx(before)


def test_the_rate_leaves_room_below_the_limit() -> None:
    controller = ForceController(CONFIG)
    velocity = controller.step(0.0, 0.9, 0.0, 5.0, reading(100.0))
    guard = CONFIG.guarded_stiffening * CONFIG.reaction_time
    assert velocity == pytest.approx((1.0 - 0.9) / guard / 100.0)


def test_a_measured_stiffening_counts_at_once_and_noise_does_not() -> None:
    controller = ForceController(CONFIG)
    generator = np.random.default_rng(1)
    stiffness = []
    for n in range(60):
        depth = 1e-5 * n
        force = 0.2 + 40.0 * depth + (360.0 * (depth - 4e-4) if n > 40 else 0.0)
        force += 1e-3 * generator.standard_normal()
        controller.step(0.005 * n, force, depth, 0.5, reading(40.0))
        stiffness.append(controller.stiffness)
    assert stiffness[:41] == pytest.approx([40.0] * 41)
    assert max(stiffness[41:]) > 120.0


@functools.cache
def closed(number: int, scheduled: bool) -> Run:
    """Close the loop over one of ten tissues."""
    return close_loop(tissues(10)[number], scheduled=scheduled, program=PROGRAM)


@pytest.mark.parametrize("number", first(4, 9))
def test_scheduled_gains_keep_their_promises(number: int) -> None:
    """The stiffest of the soft half, and of all ten."""
    fixed, scheduled = (closed(number, is_scheduled) for is_scheduled in (False, True))
    assert scheduled.force.max() <= PROGRAM.limit
    assert max(scheduled.overshoot) <= 0.05
    assert scheduled.settling < fixed.settling
    if number == 4:
        assert scheduled.settling <= 0.5 * fixed.settling


def test_fixed_gains_pass_the_limit_on_the_stiffest() -> None:
    assert PROGRAM.limit < closed(9, False).force.max()


def test_an_inclusion_takes_the_estimate_back() -> None:
    scheduled = closed(4, True)
    after = scheduled.times > PROGRAM.steps[-1][0] + 1.0
    assert scheduled.live[~after].any()
    assert set(scheduled.refusals) & {"CONTRADICTED", "REJECTED"}


def test_a_loss_in_the_middle_of_a_motion_leads_to_safe_gains_within_a_deadline() -> None:
    lost = PROGRAM.steps[2][0] + 0.1
    result = close_loop(tissues(10)[4], scheduled=True, program=PROGRAM, lose_estimate_at=lost)
    assert result.live[(result.times > lost - 0.1) & (result.times < lost)].all()
    assert not result.live[result.times > lost + 0.1].any()
    assert result.force.max() <= PROGRAM.limit and result.overshoot[0] <= 0.05
