# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is learned of the rig and of places, and contacts judged by air and by the way aside."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fault_helpers import outcome_of
from pipeline_helpers import FORCE, begun, feed, identified, items_of, parameters_of, summaries_of
from property_helpers import counts, first

from benchmark import presses
from benchmark.presses import CASES, PRIOR, scenario_of, trial_of
from benchmark.trial import truth_of
from fden_ros.core.estimation import NOTHING_UNKNOWN, EstimatorConfig, RigKnowledge, drift_evidence
from fden_ros.core.estimation.proposals.place import Tissue as Belief
from fden_ros.core.estimation.proposals.place import log_ratio
from fden_ros.core.estimation.record import Record
from fden_ros.core.estimation.rig_knowledge import (
    LEAST_SHARE,
    NO_MOTION_EVIDENCE,
    motion_share,
    pooled,
)
from fden_ros.core.outputs import ContactSummary, Flag, Phase, Status, TissueState
from simulation.scenario import (
    DisplacementSensor,
    Disturbances,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
    ramp_scenario,
)
from simulation.simulate import EXACT, simulate
from simulation.trajectory import Approach, Palpation, RampHold

# What is learned of the rig, and what is not


ARM = replace(NOTHING_UNKNOWN, compliance_sd=1.5e-4, delay_sd=0.0025, friction_sd=0.007)
CONFIG = EstimatorConfig(uncertainty=ARM)


def test_a_long_hold_in_which_nothing_is_learned_does_not_move_alpha():
    """Noise spoke of the compliance: alpha went on by a deviation in 30 s."""
    tissue = Tissue(linear_stiffness=2234.0, nonlinear_stiffness=3.83, fractional_order=0.344)
    scenario = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=(Site(tissue, (RampHold(0.28, 0.25, 20.0, 0.6),)),),
        force=ForceSensor(rate_hz=20.0, noise_stress_pa=5.1),
        displacement=DisplacementSensor(rate_hz=20.0),
    )
    parameters = {
        "geometry.area": math.pi * 1e-4,
        "geometry.thickness": 0.02,
        "prior.linear_stiffness": 185.0,
        "prior.linear_stiffness_log_sd": 1.75,
        "prior.nonlinear_stiffness": 7.2,
        "prior.nonlinear_stiffness_log_sd": 0.6,
        "prior.alpha": 0.46,
        "prior.alpha_sd": 0.11,
    }
    _, outputs = identified(items_of(simulate(scenario, 1)), parameters)
    held = [o.estimate for o in outputs if isinstance(o, TissueState) and o.phase is Phase.HOLDING]
    early, late = held[120], held[-1]
    moved = (late.fractional_order - early.fractional_order) / early.deviations[2]
    assert abs(moved) < 0.3


def test_knowledge_narrows_to_half_of_what_is_stated_and_forgets_what_another_rig_contradicts():
    known = RigKnowledge.stated(CONFIG)
    for _ in range(9):
        mean, covariance = known.scaled(ARM)
        known = known.taught(mean, 0.5 * covariance, CONFIG)
    assert known.contacts == 9
    for value, stated in zip(known.values.values(), ARM.rig_sd, strict=True):
        assert value.sd == pytest.approx(0.5 * stated)
    mean, covariance = known.scaled(ARM)
    other = known.taught(mean + np.array([0.0, 2.0]), covariance, CONFIG)
    assert other == RigKnowledge.stated(CONFIG)


@functools.cache
def touches():
    """Return items and parameters of two sites on one rig, at 100 Hz."""
    case = CASES["ten_sites"]
    scenario = scenario_of(replace(case, sites=2), 3)
    scenario = replace(
        scenario,
        geometry=replace(scenario.geometry, thickness_m=0.02),
        force=replace(scenario.force, rate_hz=100.0),
        displacement=replace(scenario.displacement, rate_hz=100.0),
    )
    recording = simulate(scenario)
    own = recording.truth["identifier_parameters"]
    parameters = {name: own[name] for name in own if name.startswith("geometry.")}
    parameters.pop("geometry.thickness_sd", None)
    return items_of(recording), {**parameters, **PRIOR, "rig.learn": True}


@pytest.mark.parametrize("numbers", counts(1, 3))
@pytest.mark.parametrize(
    ("case", "contradicts"),
    [
        (CASES["undisturbed"], False),
        (replace(CASES["undisturbed"], delay_s=0.02), None),
        (replace(CASES["friction_20mN"], disturbances=Disturbances(friction_n=0.04)), True),
    ],
    ids=["as stated", "delay", "friction"],
)
def test_unloading_beyond_what_is_stated_of_the_rig_is_flagged_and_counts(
    case, contradicts, numbers
):
    """A delay of 20 ms may as well be an error of the law: then that is in the deviations."""
    for number in range(numbers):
        (contact,) = trial_of(case, number, {}).contacts
        is_said = bool(contact.flags & Flag.RIG_PRIOR_CONFLICT) or not contact.converged
        assert contradicts is None or is_said == contradicts
        assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)


def test_what_a_contact_tells_of_the_rig_the_next_site_knows_also_after_a_reset():
    items, parameters = touches()
    pipeline, outputs = begun(parameters)
    assert pipeline.rig.contacts == 0
    feed(pipeline, items)
    pipeline.finish()
    known = [summary.rig for summary in summaries_of(outputs)]
    assert [rig.contacts for rig in known] == [1, 2]
    frictions = [rig.values["friction"].sd for rig in known]
    assert frictions[0] < ARM.friction_sd
    for quantity in known[0].values:
        assert known[1].values[quantity].sd <= known[0].values[quantity].sd
    pipeline.reset()
    assert pipeline.rig == replace(known[-1], drift=pipeline.rig.drift)
    pipeline.forget_rig()
    assert pipeline.rig == RigKnowledge.stated(pipeline.config.estimator)


def test_a_contact_that_is_cut_short_or_not_to_be_learned_from_teaches_nothing():
    items, parameters = touches()
    half, first = items[: len(items) // 5], items[: len(items) // 2]
    for own, some in (({"rig.learn": False}, first), ({}, half)):
        _, outputs = identified(some, {**parameters, **own})
        summaries = summaries_of(outputs)
        assert summaries and all(summary.rig.contacts == 0 for summary in summaries)


def test_forgetting_the_rig_before_the_air_was_judged_lets_that_contact_teach_nothing():
    items, parameters = touches()
    pipeline, outputs = begun(parameters)
    stated = RigKnowledge.stated(pipeline.config.estimator)
    remaining = iter(items)
    while not summaries_of(outputs):
        feed(pipeline, [next(remaining)])
    pipeline.forget_rig()
    for item in remaining:
        feed(pipeline, [item])
        if pipeline.newest_ns > summaries_of(outputs)[0].end_ns + 1_800_000_000:
            break
    assert len(summaries_of(outputs)) == 1
    pipeline.finish()
    assert pipeline.rig == stated


# The scales of the surface's motion and of the force's drift, learned over contacts


AT_REST = (0.0, 9.0, 13.0, 15.0, 15.5)
BREATHES = (0.0, 8.0, 6.0, -6.0, -24.0)
NOISE, STATED = 1e-3**2, 10e-3**2
UNKNOWN = RigKnowledge((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)))


def after(changes):
    """Return what is known after changes of the air's force [N]."""
    known = UNKNOWN
    for change in changes:
        known = known.drifted(drift_evidence(change, NOISE, STATED))
    return known


def case_of(name):
    return CASES[name]


def test_contacts_at_rest_leave_a_quarter_of_the_stated_motion_and_no_less():
    known = NO_MOTION_EVIDENCE
    for _ in range(100):
        known = pooled(known, AT_REST)
    assert motion_share(known) == LEAST_SHARE


def test_two_contacts_that_breathe_outweigh_a_hundred_at_rest():
    known = NO_MOTION_EVIDENCE
    for _ in range(100):
        known = pooled(known, AT_REST)
    for _ in range(2):
        known = pooled(known, BREATHES)
    assert motion_share(known) == 1.0


def test_a_contact_that_moves_more_than_was_learned_is_widened():
    known = RigKnowledge((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)), motion=pooled(AT_REST, AT_REST))
    assert known.motion_factor(AT_REST) == 1.0
    assert known.motion_factor([0.0, 2.0, -20.0, -60.0, -90.0]) > 2.0


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_the_drift_that_there_is_is_hardly_ever_taken_for_less(scale):
    """Of 400 rigs, after ten contacts each; nor what is stated for more."""
    generator = np.random.default_rng(7)
    sd = np.hypot(scale * 10e-3, 1e-3)
    shares = np.array([after(generator.normal(0.0, sd, 10)).drift_share for _ in range(400)])
    assert np.mean(shares < min(scale, 1.0)) < 0.05
    assert np.mean(shares > max(scale, 1.0)) < 0.05


def test_one_contact_that_drifts_outweighs_a_hundred_that_did_not():
    calm = after([0.0] * 100)
    assert calm.drift_share == 0.25
    assert calm.drifted(drift_evidence(0.015, NOISE, STATED)).drift_share >= 1.0
    assert calm.drift_factor(drift_evidence(0.015, NOISE, STATED)) >= 4.0
    assert calm.drift_factor(drift_evidence(0.0, NOISE, STATED)) == 1.0


def of_three_sites(name, own):
    """Return the last contact of three sites whose places are told."""
    return trial_of(replace(case_of(name), sites=3, pitch_m=0.02), 0, own).contacts[-1]


@pytest.mark.parametrize("trial", first((100.0, 3), (100.0, 5), (250.0, 24)))
def test_places_that_nothing_tells_apart_are_weighed_by_the_same_blocks(trial, monkeypatch):
    """Rounding of the time since the first touch made other blocks of the second press of a place
    than of the first of another, whose evidence was then 30 lower: alpha was 6 to 11 deviations
    off without a flag.
    """
    rate, number = trial
    monkeypatch.setattr(presses, "RATE_HZ", rate)
    contacts = trial_of(replace(case_of("undisturbed"), sites=3), number, {}).contacts
    assert len(contacts) == 3
    for contact in contacts:
        assert contact.claims
        assert np.all(np.abs(contact.error) < 2.5 * contact.deviation)


@pytest.mark.parametrize(("name", "number"), [("breathing_0.3mm", 60)])
def test_a_touch_held_at_a_sample_leaves_equations_that_have_a_solution(name, number):
    """Beside the stiffest of all unknowns, a law that is next to exact, rounding left none."""
    contacts = trial_of(case_of(name), number, {}).contacts
    assert [contact.claims for contact in contacts] == [True]


@pytest.mark.parametrize(
    ("breathes", "is_learned"),
    [(False, True), pytest.param(True, False, marks=pytest.mark.statistics)],
)
def test_sites_that_rest_sharpen_the_next_and_sites_that_breathe_do_not(
    breathes, is_learned, monkeypatch
):
    monkeypatch.setattr(presses, "RATE_HZ", 100.0)
    name = "breathing_0.3mm" if breathes else "undisturbed"
    learned = of_three_sites(name, {})
    stated = of_three_sites(name, {"surface.learn_motion": False})
    assert bool(np.all(learned.deviation < 0.95 * stated.deviation)) == is_learned
    assert np.all(np.abs(learned.error) < 3.0 * learned.deviation)


@pytest.mark.statistics
def test_a_drift_that_was_learned_sharpens_the_next_site(monkeypatch):
    """Where the law is exact the drift is a larger part of what is uncertain."""
    monkeypatch.setattr(presses, "RATE_HZ", 100.0)
    exact = {"model_discrepancy.sd": 0.0}
    learned = of_three_sites("undisturbed", exact)
    stated = of_three_sites("undisturbed", {**exact, "force.learn_drift": False})
    assert learned.deviation[0] < 0.97 * stated.deviation[0]


def ratios(name, numbers):
    """Return errors over stated deviations, shape (contacts, 3)."""
    trials = [trial_of(case_of(name), number, {}) for number in numbers]
    contacts = [contact for trial in trials for contact in trial.contacts]
    return np.array([contact.error / contact.deviation for contact in contacts])


@pytest.mark.parametrize("numbers", counts(1, 8))
def test_a_surface_that_moves_far_more_than_is_stated_is_no_silent_error(numbers):
    """Breathing of 1 mm is smooth: the parameters follow it, 2.7 standard deviations off."""
    assert np.all(np.abs(ratios("breathing_1mm", range(numbers))) < 5.0)


# Contacts judged by the air after them


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
    assert last.flags & Flag.TOUCH_NOT_OBSERVED


# A probe that is dragged over the tissue after its touch


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
    assert not summary.flags & Flag.TOUCH_NOT_OBSERVED


@pytest.mark.parametrize("begins", [0.0, 1.0])
def test_a_contact_in_which_the_probe_is_dragged_aside_claims_nothing(begins):
    outputs = pressed(lambda time, depth: 0.02 * max(time - begins, 0.0))
    (summary,) = summaries_of(outputs)
    assert summary.flags & Flag.TOUCH_NOT_OBSERVED
    assert summary.estimate is None and not summary.converged
    # By then it has gone as far as it is deep.
    late = summary.start_ns + int((begins + 0.4) * 1e9)
    states = [s for s in outputs if isinstance(s, TissueState)]
    states = [state for state in states if late < state.stamp_ns < summary.end_ns]
    assert states and all(state.status is not Status.CONVERGED for state in states)


# Touches without positions, of which nothing says whether they are of the same place
# The truth comes from the simulation, which shares nothing with the core.


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


def test_the_evidence_under_another_prior_is_that_of_its_own_integral():
    drawn = np.random.default_rng(4)
    root = drawn.normal(size=(3, 3))
    told_alone = root @ root.T  # precision of what the press tells
    best = drawn.normal(size=3)
    prior = Belief(np.zeros(3), np.diag([4.0, 1.0, 0.25]))
    other = Belief(np.array([0.3, -0.2, 0.1]), np.diag([0.09, 0.04, 0.01]))
    precision = told_alone + np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(precision)
    told = Belief(covariance @ told_alone @ best, covariance)

    def integral(belief):
        samples = drawn.multivariate_normal(belief.mean, belief.covariance, 400_000) - best
        return np.mean(np.exp(-0.5 * np.einsum("ni,ij,nj->n", samples, told_alone, samples)))

    expected = np.log(integral(other) / integral(prior))
    assert log_ratio(prior, other, told, learns_order=True) == pytest.approx(expected, abs=0.02)


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


# A delay that may be long


LATE = {
    "geometry.area": math.pi * 1e-4,
    "geometry.thickness": 0.02,
    "displacement.delay_sd": 0.1,
}


def late_press(seed: int, delay: float) -> Any:
    """A press to a quarter of 20 mm and a hold of 2 s, the displacement stamped late [s]."""
    draw = np.random.default_rng(1000 + seed)
    tissue = Tissue(
        linear_stiffness=math.exp(draw.uniform(math.log(2000.0), math.log(8000.0))),
        nonlinear_stiffness=draw.uniform(6.0, 10.0),
        fractional_order=draw.uniform(0.08, 0.32),
    )
    scenario = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=(Site(tissue, (RampHold(0.3, 0.25, 2.0, 0.6),)),),
        force=ForceSensor(rate_hz=200.0, noise_n=0.005),
        displacement=DisplacementSensor(200.0, noise_m=5e-6, delay_s=delay),
        approach=Approach(distance_m=0.004, speed_m_per_s=0.005, start_pause_s=2.0),
    )
    return simulate(scenario, seed)


@pytest.mark.parametrize("numbers", counts(1, 12))
@pytest.mark.parametrize("delay", [-0.05, 0.1, *first(0.02, 0.0, 0.05)])
def test_a_delay_of_up_to_100_ms_is_learned_and_gives_no_wrong_number(delay, numbers):
    converged = 0
    for seed in range(numbers):
        recording = late_press(seed, delay)
        truth = truth_of(recording)
        _, outputs = identified(items_of(recording), LATE)
        (summary,) = summaries_of(outputs)
        states = [o for o in outputs if isinstance(o, TissueState)]
        known = [state for state in states if state.status is Status.CONVERGED]
        for one in (*known, *([summary] if summary.converged else [])):
            off = np.abs(one.estimate.mean - truth) / one.estimate.deviations
            assert np.all(off < (3.0 if one is summary else 4.0)), (seed, off)
        if not summary.converged:
            continue
        converged += 1
        learned, sd = summary.estimate.delay
        assert abs(learned - delay) < 3.0 * sd, (seed, learned, sd)
        found = summary.apparent_stiffness
        g, g_n, order = math.exp(truth[0]), math.exp(truth[1]), truth[2]
        relaxed = found.time_scale**-order / math.gamma(1.0 - order)
        stiffness = g * math.exp(0.25 * g_n - 1.0) * relaxed * math.pi * 1e-4 / 0.02
        assert abs(found.value - stiffness) < 3.0 * found.sd
    assert converged >= 0.6 * numbers


@pytest.mark.parametrize("delay", [-0.05, 0.0321, 0.1])
def test_a_delay_shifts_the_motion_and_its_derivative_is_exact(delay):
    record = Record(delay=0.2)
    for time in np.arange(0.0, 1.0, 0.005).tolist():
        record.add(time, 0.1 * math.sin(6.0 * time), 1.0, is_observed=True)
    points, step = record.points(), 1e-6
    moved = points.earlier(delay, 0.0)
    at = points.times + delay
    inside = (at > 0.03) & (at < 0.96)
    assert moved.compressions[inside] == pytest.approx(0.1 * np.sin(6.0 * at[inside]), abs=1e-4)
    later, before = (points.earlier(delay + way, 0.0).compressions for way in (step, -step))
    assert moved.rates == pytest.approx((later - before) / (2.0 * step), abs=1e-4)


def test_a_short_delay_counts_as_before():
    """The default is no wider than a block: there the column is linear."""
    recording = late_press(0, 0.002)
    parameters = LATE | {"displacement.delay_sd": 0.0025}
    (summary,) = summaries_of(identified(items_of(recording), parameters)[1])
    assert summary.converged and summary.estimate.delay is None
