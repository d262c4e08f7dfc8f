# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that is dragged over the tissue after its touch."""

from __future__ import annotations

import numpy as np
import pytest
from pipeline_helpers import FORCE, identified, items_of, parameters_of, summaries_of

from fden_ros.core.outputs import Flag, Status, TissueState
from simulation.scenario import ramp_scenario
from simulation.simulate import EXACT, simulate

AXIS = {"displacement.message": "point", "displacement.axis": [0.0, 0.0, 1.0]}


def pressed(aside):
    """Return the outputs of a press to 6 mm, that goes `aside` of (time [s], depth [m]) [m]."""
    recording = simulate(ramp_scenario(rate_hz=250.0, seed=5))
    touch_ns = recording.truth["contacts"][0]["start_ns"]
    generator = np.random.default_rng(2)

    def placed(item):
        way = aside(1e-9 * (item.stamp_ns - touch_ns), max(item.value, 0.0))
        return item._replace(position=(way + generator.normal(0.0, 2e-4), 0.0, item.value))

    items = [item if item.stream == FORCE else placed(item) for item in items_of(recording)]
    return identified(items, parameters_of(recording) | EXACT | AXIS)[1]


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_a_press_along_a_tilted_axis_is_none(tilt):
    (summary,) = summaries_of(pressed(lambda time, depth: tilt * depth))
    assert summary.converged
    assert not summary.flags & Flag.ORIGIN_UNCERTAIN


@pytest.mark.parametrize("begins", [0.0, 1.0])
def test_a_contact_in_which_the_probe_is_dragged_aside_claims_nothing(begins):
    outputs = pressed(lambda time, depth: 0.02 * max(time - begins, 0.0))
    (summary,) = summaries_of(outputs)
    assert summary.flags & Flag.ORIGIN_UNCERTAIN
    assert summary.estimate is None and not summary.converged
    # By then it has gone as far as it is deep.
    late = summary.start_ns + int((begins + 0.4) * 1e9)
    states = [s for s in outputs if isinstance(s, TissueState)]
    states = [state for state in states if late < state.stamp_ns < summary.end_ns]
    assert states and all(state.status is not Status.CONVERGED for state in states)
