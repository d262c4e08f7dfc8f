# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The scales of the surface's motion and of the force's drift, learned over contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from property_helpers import counts

from benchmark import presses
from benchmark.presses import CASES, trial_of
from fden_ros.core.estimation.drift_scale import (
    drift_evidence,
)
from fden_ros.core.estimation.motion_scale import (
    LEAST_SHARE,
    NO_EVIDENCE,
    pooled,
    share_of,
)
from fden_ros.core.estimation.rig_knowledge import RigKnowledge

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
    known = NO_EVIDENCE
    for _ in range(100):
        known = pooled(known, AT_REST)
    assert share_of(known) == LEAST_SHARE


def test_two_contacts_that_breathe_outweigh_a_hundred_at_rest():
    known = NO_EVIDENCE
    for _ in range(100):
        known = pooled(known, AT_REST)
    for _ in range(2):
        known = pooled(known, BREATHES)
    assert share_of(known) == 1.0


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
    """Return the last contact of three sites."""
    return trial_of(replace(case_of(name), sites=3), 0, own).contacts[-1]


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
    if not breathes:
        stated = of_three_sites(name, {"force.learn_drift": False})
        assert learned.deviation[0] < 0.95 * stated.deviation[0]


def ratios(name, numbers):
    """Return errors over stated deviations, shape (contacts, 3)."""
    trials = [trial_of(case_of(name), number, {}) for number in numbers]
    contacts = [contact for trial in trials for contact in trial.contacts]
    return np.array([contact.error / contact.deviation for contact in contacts])


@pytest.mark.parametrize("numbers", counts(1, 8))
def test_a_surface_that_moves_far_more_than_is_stated_is_no_silent_error(numbers):
    """Breathing of 1 mm is smooth: the parameters follow it, 2.7 standard deviations off."""
    assert np.all(np.abs(ratios("breathing_1mm", range(numbers))) < 5.0)
