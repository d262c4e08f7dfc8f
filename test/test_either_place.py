# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Touches without positions, of which nothing says whether they are of the same place.

The truth comes from the simulation, which shares nothing with the core.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fault_helpers import outcome_of
from pipeline_helpers import items_of, parameters_of

from fden_ros.core.outputs import ContactSummary
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Site,
    Tissue,
    ramp_scenario,
)
from simulation.simulate import EXACT, simulate
from simulation.trajectory import Approach, Palpation

#: ln G differs by this between places [1], or not at all.
_APART = 0.3


@functools.cache
def contacts(seed: int, places: int) -> tuple[tuple[ContactSummary, Any], ...]:
    """Return three contacts, of one place or of as many, later than `site.timeout`, and truths."""
    drawn = np.random.default_rng([seed, 99])
    tissue = Tissue(
        float(np.exp(drawn.normal(7.5, 0.6))),
        float(np.exp(drawn.normal(2.2, 0.25))),
        float(drawn.uniform(0.1, 0.35)),
    )
    stiffer = float(np.exp(drawn.normal(0.0, _APART)))
    other = replace(tissue, linear_stiffness=stiffer * tissue.linear_stiffness)
    pause_s = float(drawn.uniform(2.2, 8.0))
    press = Palpation(
        float(drawn.uniform(0.1, 0.5)),
        float(drawn.uniform(0.2, 0.3)),
        float(drawn.uniform(0.5, 3.0)),
        presses=3 // places,
        lift_m=0.002,
        pause_s=pause_s,
    )
    tissues = (tissue, other, tissue)[:places]
    rate = float(drawn.choice([100.0, 200.0, 500.0]))
    recording = simulate(
        replace(
            ramp_scenario(rate_hz=rate, seed=seed),
            approach=Approach(distance_m=0.005, start_pause_s=2.0, site_pause_s=pause_s),
            sites=tuple(Site(t, (press,), (0.02 * k, 0.0)) for k, t in enumerate(tissues)),
            force=ForceSensor(rate_hz=rate, noise_stress_pa=float(drawn.uniform(2.0, 20.0))),
            displacement=DisplacementSensor(rate_hz=rate, message="joint_state", noise_m=1e-6),
        )
    )
    left_out = (*EXACT, "alpha.learn", "prior.alpha", "prior.alpha_sd")
    stated = {k: v for k, v in parameters_of(recording).items() if k not in left_out}
    found = outcome_of(items_of(recording), stated).summaries
    truths = [tissues[k % places] for k in range(3)]
    return tuple(zip(found, truths, strict=True))


def errors(seed: int, places: int) -> list[list[float]]:
    """Return the errors of ln G, ln Gn and alpha of each contact, in standard deviations."""
    result = []
    for summary, tissue in contacts(seed, places):
        estimate = summary.estimate
        assert estimate is not None
        truth = [np.log(tissue.linear_stiffness), np.log(tissue.nonlinear_stiffness)]
        off = estimate.mean - [*truth, tissue.fractional_order]
        result.append((off / estimate.deviations).tolist())
    return result


@pytest.mark.parametrize("places", [1, 3])
def test_a_late_touch_of_the_same_place_or_another_is_not_wrong_under_a_good_status(places):
    assert np.all(np.abs(errors(22, places)) < 4.0)
    assert all(one.converged and not one.flags for one, _ in contacts(22, places))
    # Nothing says that it is not another site.
    assert [one.site_id for one, _ in contacts(22, places)] == [1, 2, 3]


def test_what_the_last_contact_told_sharpens_the_next_of_the_same_place():
    first, *_, last = (one.estimate.deviations for one, _ in contacts(22, 1))
    assert np.all(last < 0.8 * first)


@pytest.mark.statistics
@pytest.mark.parametrize("places", [1, 3])
def test_errors_of_late_touches_are_as_large_as_is_said(places):
    found = np.array([errors(seed, places) for seed in range(20, 50)])
    assert np.all(np.sqrt(np.mean(found**2, axis=0)) <= 1.3)
    claimed = [
        one.converged and not one.flags for s in range(20, 50) for one, _ in contacts(s, places)
    ]
    silent = np.abs(found.reshape(-1, 3))[np.array(claimed)] > 5.0
    assert not silent.any()
    assert np.mean(claimed) > 0.6
