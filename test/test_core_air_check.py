# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts judged by the air after them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pipeline_helpers import FORCE, identified, items_of, parameters_of, summaries_of

from fden_ros.core.outputs import Flag
from simulation.disturbance import Disturbances
from simulation.scenario import ramp_scenario
from simulation.simulate import EXACT, simulate


def recorded(**disturbances):
    scenario = replace(
        ramp_scenario(rate_hz=250.0, seed=5), disturbances=Disturbances(**disturbances)
    )
    recording = simulate(scenario)
    return items_of(recording), parameters_of(recording) | EXACT


def test_contact_in_which_the_force_crept_is_flagged_and_widened():
    items, parameters = recorded(creep_n=0.03)
    first, last = summaries_of(identified(items, parameters)[1])
    assert not first.flags & Flag.FORCE_DRIFTED
    assert last.flags & Flag.FORCE_DRIFTED
    assert (last.contact_id, last.end_ns) == (first.contact_id, first.end_ns)
    assert last.stamp_ns > first.stamp_ns
    # alpha is given.
    assert np.all(last.estimate.deviations[:2] > 4.0 * first.estimate.deviations[:2])
    assert np.array_equal(last.estimate.mean, first.estimate.mean)
    assert not last.converged


def test_first_contact_whose_air_was_none_is_withdrawn():
    items, parameters = recorded()
    # The force falls to where it is without any contact only after the press.
    (touched,) = summaries_of(identified(items, parameters)[1])
    pressed = [
        item._replace(value=item.value + 0.2)
        if item.stream == FORCE and item.stamp_ns < touched.end_ns
        else item
        for item in items
    ]
    first, last = summaries_of(identified(pressed, parameters)[1])
    assert first.estimate is not None
    assert last.estimate is None
    assert not last.converged
    assert last.flags & Flag.ORIGIN_UNCERTAIN
