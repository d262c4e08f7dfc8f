# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is stated of the rig and of places, and contacts judged by air and by the way aside."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pipeline_helpers import (
    FORCE,
    identified,
    items_of,
    off,
    parameters_of,
    states_of,
    summaries_of,
)
from property_helpers import counts, first
from scipy.signal import lfilter
from scipy.special import gamma

from benchmark.robots import CASES, scenario_of, trial_of
from benchmark.robots import parameters_of as parameters_of_rig
from benchmark.trial import last_summaries, outcome_of, through
from fden_ros import fit
from fden_ros.core.outputs import ContactSummary, Flag, Status
from simulation.scenario import (
    DisplacementSensor,
    Disturbances,
    ForceSensor,
    Site,
    Tissue,
    ramp_scenario,
)
from simulation.simulate import EXACT, simulate
from simulation.trajectory import Approach, Palpation

# What is stated of the rig


@pytest.mark.parametrize("numbers", counts(1, 3))
@pytest.mark.parametrize(
    ("case", "contradicts"),
    [
        (CASES["undisturbed"], False),
        (replace(CASES["friction_20mN"], disturbances=Disturbances(friction_n=0.04)), True),
    ],
    ids=["as stated", "friction"],
)
def test_unloading_beyond_what_is_stated_of_the_rig_is_flagged_and_counts(
    case, contradicts, numbers
):
    for number in range(numbers):
        (contact,) = trial_of(case, number, {}).contacts
        is_said = bool(contact.flags & Flag.RIG_PRIOR_CONFLICT) or not contact.converged
        assert is_said == contradicts
        assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)


#: Play, and the deviation that is stated of it; None: an arm's.
PLAYS = [*first((3e-4, 5e-4), (3e-4, None), (6e-4, 5e-4)), (6e-4, None)]


@pytest.mark.parametrize("play", PLAYS, ids=str)
@pytest.mark.parametrize("numbers", counts(3, 8))
def test_tip_that_follows_behind_the_play_of_its_drive_is_not_wrong_under_a_good_status(
    play, numbers
):
    size, stated = play
    case = replace(CASES["backlash_50um"], disturbances=Disturbances(backlash_m=size))
    parameters = {"displacement.backlash_sd": stated} if stated else {}
    claimed = 0
    for number in range(numbers):
        (contact,) = trial_of(case, number, parameters).contacts
        if contact.converged and not contact.flags:
            assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)
            claimed += 1
    assert not stated or claimed >= 0.6 * numbers


@pytest.mark.parametrize("compliance", [*first(5e-4), 2e-4])
@pytest.mark.parametrize("numbers", counts(1, 6))
def test_soft_tool_that_is_not_stated_is_not_wrong_under_a_good_status(compliance, numbers):
    case = CASES["compliance_0.5"]
    case = replace(case, disturbances=Disturbances(compliance_m_per_n=compliance))
    press = Palpation(0.2, 0.25, 1.0, 0.4, presses=3)
    for number in range(numbers):
        scenario = scenario_of(case, number)
        tissue = replace(scenario.sites[0].tissue, linear_stiffness=14_500.0)
        recording = simulate(replace(scenario, sites=(Site(tissue, (press,)),)))
        outputs = through(recording, parameters_of_rig(recording))[1]
        found = outcome_of(recording, outputs).contacts
        unit = 0.1**-tissue.fractional_order / gamma(1.0 - tissue.fractional_order)
        unit *= 14_500.0 * scenario.geometry.force_per_stress / scenario.geometry.length_m
        for contact, summary, true in zip(
            found, last_summaries(outputs).values(), recording.truth["contacts"], strict=True
        ):
            if contact.flags:
                continue
            assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)
            own = unit * np.exp(tissue.nonlinear_stiffness * true["max_strain"] - 1.0)
            series, stiffness = own / (1.0 + compliance * own), summary.apparent_stiffness
            assert stiffness is None or abs(stiffness.value - series) < 3.0 * stiffness.sd


def behind_a_filter(cutoff, **parameters):
    """Return what is found in a press whose force went through a low-pass [Hz]."""
    path = Path(__file__).parent.parent / "examples" / "press.csv"
    time, force, depth = np.loadtxt(path, delimiter=",", skiprows=1).T[:, :1150]
    noise = 2e-3 * np.random.default_rng(1).standard_normal(time.size)
    share = -np.expm1(-2.0 * np.pi * cutoff * np.diff(time).mean())
    force = lfilter([share], [1.0, share - 1.0], force + noise)
    probe = {"kind": "flat_punch", "area": 3.14e-4, "thickness": 0.02}
    found = fit(time, force, 1e-3 * depth, geometry=probe, **parameters)
    assert any("noise in the air is smooth" in words for words in found.warnings)
    (contact,) = found.contacts
    return contact


def test_behind_a_slow_filter_nothing_is_known_whatever_delay_is_stated():
    for delay in (0.0, -0.08):
        contact = behind_a_filter(2.0, **{"displacement.delay": delay})
        assert "MODEL_MISMATCH" in contact.flags
        assert np.isnan(contact.G.value) and np.isnan(contact.stiffness.value)


def test_a_filter_of_the_force_shows_in_its_noise_and_counts_as_a_delay():
    contact = behind_a_filter(5.0)
    assert "RIG_PRIOR_CONFLICT" in contact.flags
    true = 450.0 * np.exp(9.0 * 0.3 - 1.0) * 0.1**-0.131 / gamma(1.0 - 0.131) * 3.14e-4 / 0.02
    assert abs(contact.stiffness.value - true) < 3.0 * contact.stiffness.sd


# Contacts judged by the air after them


def pressed(change=lambda item, touch_ns, end_ns: item, axis=None, **disturbances):
    """Return the outputs of a press whose samples are changed."""
    own = Disturbances(**disturbances)
    recording = simulate(replace(ramp_scenario(rate_hz=250.0, seed=5), disturbances=own))
    touch = recording.truth["contacts"][0]
    items = [change(i, touch["start_ns"], touch["end_ns"]) for i in items_of(recording)]
    return identified(items, parameters_of(recording) | EXACT | (axis or {}))[1]


def test_contact_in_which_the_force_crept_is_flagged_and_widened():
    # With more, the tissue seems to have changed, and nothing is known to be widened.
    first, last = summaries_of(pressed(creep_n=0.005))
    assert last.flags & ~first.flags & Flag.FORCE_DRIFTED
    assert (last.contact_id, last.end_ns) == (first.contact_id, first.end_ns)
    assert last.stamp_ns > first.stamp_ns
    # alpha is given.
    assert np.all(last.estimate.deviations[:2] > 4.0 * first.estimate.deviations[:2])
    assert np.array_equal(last.estimate.mean, first.estimate.mean)
    stiffness = last.apparent_stiffness
    assert stiffness is None or stiffness.sd > 2.0 * first.apparent_stiffness.sd
    assert not last.converged


def test_first_contact_whose_air_was_none_is_withdrawn():
    def loaded(item, touch_ns, end_ns):
        """The force falls to where it is without any contact only after the press."""
        is_raised = item.stream == FORCE and item.stamp_ns < end_ns
        return item._replace(value=item.value + 0.2) if is_raised else item

    first, last = summaries_of(pressed(loaded))
    assert first.estimate is not None
    assert last.estimate is None and not last.converged
    assert last.flags & Flag.TOUCH_NOT_OBSERVED
    assert first.apparent_stiffness and not last.apparent_stiffness
    assert not any(slope and np.isfinite(slope.depth) for slope in last.measured)


# A probe that is dragged over the tissue after its touch


AXIS = {"displacement.message": "point", "displacement.axis": [0.0, 0.0, 1.0]}


def dragged(aside):
    """Return the outputs of a press to 6 mm, that goes `aside` of (time [s], depth [m]) [m]."""
    generator = np.random.default_rng(2)

    def placed(item, touch_ns, end_ns):
        if item.stream == FORCE:
            return item
        way = aside(1e-9 * (item.stamp_ns - touch_ns), max(item.value, 0.0))
        return item._replace(position=(way + generator.normal(0.0, 2e-4), 0.0, item.value))

    return pressed(placed, AXIS)


def test_a_contact_in_which_the_probe_is_dragged_aside_claims_nothing_and_a_tilted_press_does():
    (summary,) = summaries_of(dragged(lambda time, depth: 0.3 * depth))
    assert summary.converged and not summary.flags & Flag.TOUCH_NOT_OBSERVED
    outputs = dragged(lambda time, depth: 0.02 * max(time - 1.0, 0.0))
    (summary,) = summaries_of(outputs)
    assert summary.flags & Flag.TOUCH_NOT_OBSERVED
    assert summary.estimate is None and not summary.converged
    # By then it has gone as far as it is deep.
    late = summary.start_ns + 1_400_000_000
    states = [state for state in states_of(outputs) if late < state.stamp_ns < summary.end_ns]
    assert states and all(state.status is not Status.CONVERGED for state in states)


# Touches without positions, of which nothing says whether they are of the same place
# The truth comes from the simulation, which shares nothing with the core.


@functools.cache
def contacts(seed: int, places: int) -> tuple[tuple[ContactSummary, np.ndarray], ...]:
    """Return three contacts, later than `site.timeout`, and their errors over deviations.

    They are of one place, or of three of which the second's ln G differs, by a deviation of 0.3.
    """
    drawn = np.random.default_rng([seed, 99])
    g, gn = float(np.exp(drawn.normal(7.5, 0.6))), float(np.exp(drawn.normal(2.2, 0.25)))
    alpha = float(drawn.uniform(0.1, 0.35))
    tissue, other = ((size, gn, alpha) for size in (g, g * float(np.exp(drawn.normal(0.0, 0.3)))))
    pause_s = float(drawn.uniform(2.2, 8.0))
    rate, depth, hold = (float(drawn.uniform(*of)) for of in ((0.1, 0.5), (0.2, 0.3), (0.5, 3.0)))
    press = Palpation(rate, depth, hold, presses=3 // places, lift_m=0.002, pause_s=pause_s)
    rate = float(drawn.choice([100.0, 200.0, 500.0]))
    pressed = (tissue, other, tissue)[:places]
    recording = simulate(
        replace(
            ramp_scenario(rate_hz=rate, seed=seed),
            approach=Approach(distance_m=0.005, start_pause_s=2.0, site_pause_s=pause_s),
            sites=tuple(
                Site(Tissue(*own), (press,), (0.02 * k, 0.0)) for k, own in enumerate(pressed)
            ),
            force=ForceSensor(rate_hz=rate, noise_stress_pa=float(drawn.uniform(2.0, 20.0))),
            displacement=DisplacementSensor(rate_hz=rate, message="joint_state", noise_m=1e-6),
        )
    )
    left_out = (*EXACT, "alpha.learn", "prior.alpha", "prior.alpha_sd")
    stated = {k: v for k, v in parameters_of(recording).items() if k not in left_out}
    found = summaries_of(identified(items_of(recording), stated)[1])
    truths = pressed * (3 // places)
    return tuple((one, off(one.estimate, t)) for one, t in zip(found, truths, strict=True))


def is_claimed(contact: ContactSummary) -> bool:
    return contact.converged and not contact.flags


@pytest.mark.parametrize("places", [1, 3])
def test_a_late_touch_of_the_same_place_or_another_is_not_wrong_under_a_good_status(places):
    assert all(np.all(np.abs(error) < 4.0) for _, error in contacts(22, places))
    assert sum(is_claimed(one) for one, _ in contacts(22, places)) >= 2
    # Nothing says that it is not another site.
    assert [one.site_id for one, _ in contacts(22, places)] == [1, 2, 3]


def test_what_the_last_contact_told_sharpens_the_next_of_the_same_place():
    first, *_, last = (one.estimate.deviations for one, _ in contacts(22, 1))
    assert np.all(last < 0.8 * first)


@pytest.mark.statistics
@pytest.mark.parametrize("places", [1, 3])
def test_errors_of_late_touches_are_as_large_as_is_said(places):
    found = [contacts(seed, places) for seed in range(20, 50)]
    errors = np.array([[error for _, error in three] for three in found])
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) <= 1.3)
    claimed = np.array([[is_claimed(one) for one, _ in three] for three in found])
    assert not np.any(np.abs(errors[claimed]) > 5.0)
    assert np.mean(claimed) > 0.6
