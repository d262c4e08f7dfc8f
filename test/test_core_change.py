# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A change of the tissue under the probe, on presses in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from benchmark.changes import CASES, CHANGES, NOTHING, Change, Pressed, press, run_trial
from benchmark.trial import fed
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config

SLIDE = next(change for change in CHANGES if change.kind == "slide")
DOUBLED = next(change for change in CHANGES if change.name == "inclusion 2")


@pytest.mark.parametrize(
    ("case", "change", "number"),
    [
        ("flat_30", SLIDE, 4),
        ("flat_500", SLIDE, 2),
        ("flat_30", DOUBLED, 4),
        ("sphere_500", DOUBLED, 5),
    ],
)
def test_a_change_is_reported_after_it_began(case, change, number):
    assert 0.0 <= run_trial((case, change.name), number) < 2.0


def pressed(
    case: str,
    number: int,
    change: Change = NOTHING,
    forces: Callable[[Pressed], Array] = lambda own: own.forces,
) -> tuple[Pressed, list[Output]]:
    """Return a press, and the outputs of the pipeline."""
    row, outputs = CASES[case], list[Output]()
    parameters = check({**row.parameters, **row.geometry.parameters})
    pipeline = Pipeline(pipeline_config(parameters), outputs.append)
    own = press(row.geometry, row.rate_hz, change, number)
    for _ in fed(pipeline, own.times, forces(own), own.displacements):
        pass
    pipeline.finish()
    return own, outputs


@pytest.mark.parametrize(("seconds", "is_changed"), [(0.06, False), (0.2, True)])
def test_a_brief_jerk_of_the_force_is_no_change(seconds, is_changed):
    def jerked(own: Pressed) -> Array:
        middle = own.times[own.forces.argmax()] + 0.3
        is_during = (own.times > middle) & (own.times < middle + seconds)
        return own.forces + 0.2 * own.forces.max() * is_during

    states = [
        one for one in pressed("flat_500", 2, forces=jerked)[1] if isinstance(one, TissueState)
    ]
    assert any(state.flags & Flag.TISSUE_CHANGED for state in states) == is_changed


def test_nothing_is_known_once_the_tissue_has_changed():
    outputs = pressed("flat_500", 2, SLIDE)[1]
    states = [one for one in outputs if isinstance(one, TissueState)]
    changed = [bool(state.flags & Flag.TISSUE_CHANGED) for state in states]
    first = changed.index(True)
    assert any(state.estimate and state.estimate.known for state in states[:first])
    assert not any(state.estimate and state.estimate.known for state in states[first:])


@pytest.mark.parametrize(
    ("case", "number"),
    [
        ("flat_30", 4),
        ("flat_500", 2),
        # All weight was at one value of alpha: it was known to 3e-17.
        ("sphere_500", 43),
    ],
)
def test_the_same_tissue_is_known_and_right(case, number):
    own, outputs = pressed(case, number)
    states = [one for one in outputs if isinstance(one, TissueState)]
    assert not any(state.flags & Flag.TISSUE_CHANGED for state in states)
    (summary,) = (one for one in outputs if isinstance(one, ContactSummary))
    estimate, tissue = summary.estimate, own.tissue
    g, gn = math.log(tissue.linear_stiffness), math.log(tissue.nonlinear_stiffness)
    assert estimate is not None and estimate.known == ParameterSet.ALL
    off = (
        abs(estimate.mean - [g, gn, tissue.fractional_order])
        / estimate.covariance.diagonal() ** 0.5
    )
    assert (off < 4.5).all()
