# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force controller: its law, and in closed loop with simulated tissue and the pipeline."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from closed_loop import LAST, LIMIT, STEP, Run, close_loop, tissue
from output_helpers import ESTIMATE
from property_helpers import first

from fden_ros.control.force_control import ForceControlConfig, ForceController, Gains
from fden_ros.control.live_tissue import Reading
from fden_ros.core.outputs import ApparentStiffness, Flag, Phase, Status, TissueState

#: The fifth of ten tissues from the softest to the stiffest.
MIDDLE = 4.0 / 9.0
CONFIG = ForceControlConfig(safe_stiffness=100.0, force_limit=1.0, bandwidth=10.0)


def reading(stiffness: float, sd: float = 0.0) -> Reading:
    state = TissueState(
        stamp_ns=0,
        status=Status.CONVERGED,
        flags=Flag.NONE,
        site_id=1,
        contact_id=1,
        phase=Phase.LOADING,
        estimate=ESTIMATE,
        apparent_stiffness=ApparentStiffness(stiffness, sd, 0.1),
    )
    return Reading(state, ESTIMATE, 0.0)


def test_the_velocity_is_the_wanted_rate_of_force_over_the_live_stiffness():
    controller = ForceController(CONFIG)
    velocity = controller.step(0.0, 0.30, 0.0, 0.35, reading(40.0, 10.0))
    assert velocity == pytest.approx(10.0 * 0.05 / 50.0)
    assert controller.gains is Gains.LIVE


def test_without_an_estimate_the_safe_gains_are_used_at_once():
    controller = ForceController(CONFIG)
    controller.step(0.0, 0.30, 0.0, 0.35, reading(40.0))
    velocity = controller.step(0.005, 0.30, 0.0, 0.35, None)
    assert controller.gains is Gains.SAFE
    assert velocity == pytest.approx(10.0 * 0.05 / 100.0)


def test_on_tissue_stiffer_than_the_safe_one_a_loss_makes_nothing_faster():
    controller = ForceController(CONFIG)
    before = controller.step(0.0, 0.30, 0.0, 0.35, reading(300.0))
    assert controller.step(0.005, 0.30, 0.0, 0.35, None) == pytest.approx(before)


def test_the_rate_leaves_room_below_the_limit():
    controller = ForceController(CONFIG)
    velocity = controller.step(0.0, 0.9, 0.0, 5.0, reading(100.0))
    guard = CONFIG.guarded_stiffening * CONFIG.reaction_time
    assert velocity == pytest.approx((1.0 - 0.9) / guard / 100.0)


def test_a_measured_stiffening_counts_at_once_and_noise_does_not():
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
def closed(place: float, scheduled: bool) -> Run:
    return close_loop(tissue(place), scheduled=scheduled)


@pytest.mark.parametrize("place", first(MIDDLE, 1.0, 0.0, 0.25, 0.75))
def test_scheduled_gains_keep_their_promises(place):
    fixed, scheduled = (closed(place, is_scheduled) for is_scheduled in (False, True))
    assert scheduled.force.max() <= LIMIT
    assert max(scheduled.overshoot) <= 0.05
    assert scheduled.settling < fixed.settling
    if place <= MIDDLE:
        assert scheduled.settling <= 0.5 * fixed.settling


def test_fixed_gains_pass_the_limit_on_the_stiffest():
    assert closed(1.0, False).force.max() > LIMIT


def test_an_inclusion_takes_the_estimate_back():
    scheduled = closed(MIDDLE, True)
    assert scheduled.live[scheduled.times <= LAST + 1.0].any()
    assert set(scheduled.refusals) & {"CONTRADICTED", "REJECTED"}


def test_a_loss_in_the_middle_of_a_motion_leads_to_safe_gains_within_a_deadline():
    lost = STEP + 0.1
    result = close_loop(tissue(MIDDLE), scheduled=True, lost_at=lost)
    assert result.live[(result.times > lost - 0.1) & (result.times < lost)].all()
    assert not result.live[result.times > lost + 0.1].any()
    assert result.force.max() <= LIMIT and result.overshoot[0] <= 0.05
