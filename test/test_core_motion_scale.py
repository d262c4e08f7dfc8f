# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The scale of the surface's motion, learned over contacts; and a surface that has shifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from property_helpers import counts, first

from benchmark import presses
from benchmark.presses import CASES, trial_of
from fden_ros.core.estimation.motion_scale import (
    LEAST_SHARE,
    NO_EVIDENCE,
    SCALES,
    SMOOTH,
    pooled,
    share_of,
)
from fden_ros.core.estimation.rig_knowledge import RigKnowledge

AT_REST = (0.0, 9.0, 13.0, 15.0, 15.5)
BREATHES = (0.0, 8.0, 6.0, -6.0, -24.0)


def case_of(name):
    return CASES[name]


def test_without_any_contact_all_of_the_stated_motion_counts():
    assert share_of(NO_EVIDENCE) == 1.0


def test_contacts_at_rest_leave_a_quarter_of_the_stated_motion_and_no_less():
    known = NO_EVIDENCE
    for _ in range(100):
        known = pooled(known, AT_REST)
    assert share_of(known) == LEAST_SHARE


def test_a_smooth_motion_counts_for_more_than_the_walk_that_is_likely():
    assert share_of((-9.0, -5.0, 0.0, -1.0, -5.0)) == SMOOTH * SCALES[2]


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


@pytest.mark.parametrize(
    ("breathes", "is_learned"),
    [(False, True), pytest.param(True, False, marks=pytest.mark.statistics)],
)
def test_sites_that_rest_sharpen_the_next_and_sites_that_breathe_do_not(
    breathes, is_learned, monkeypatch
):
    monkeypatch.setattr(presses, "RATE_HZ", 100.0)
    rig = replace(case_of("breathing_0.3mm" if breathes else "undisturbed"), sites=3)
    learned = trial_of(rig, 0, {}).contacts[-1]
    stated = trial_of(rig, 0, {"surface.learn_motion": False}).contacts[-1]
    assert bool(np.all(learned.deviation < 0.9 * stated.deviation)) == is_learned
    assert np.all(np.abs(learned.error) < 3.0 * learned.deviation)


@pytest.mark.parametrize("number", first(3, 4))
def test_a_surface_that_stays_lower_after_a_press_is_met_within_the_deviations(number):
    """A press of 1.25 s after another: without a shift alpha was 2.8 to 3.3 deviations off."""
    for contact in trial_of(case_of("plastic_0.1mm"), number, {}).contacts:
        assert np.all(np.abs(contact.error) < 2.0 * contact.deviation)


@pytest.mark.parametrize("number", first(1, 2))
def test_a_noisy_marker_of_the_surface_is_not_taken_for_slow_tissue(number):
    """It was 2.6 to 4.6 deviations of alpha."""
    (contact,) = trial_of(case_of("breathing_1mm_measured"), number, {}).contacts
    assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)


def ratios(name, numbers):
    """Return errors over stated deviations, shape (contacts, 3)."""
    trials = [trial_of(case_of(name), number, {}) for number in numbers]
    contacts = [contact for trial in trials for contact in trial.contacts]
    return np.array([contact.error / contact.deviation for contact in contacts])


@pytest.mark.parametrize("numbers", counts(1, 8))
def test_a_surface_that_moves_far_more_than_is_stated_is_no_silent_error(numbers):
    """Breathing of 1 mm is smooth: the parameters follow it, 2.7 standard deviations off."""
    assert np.all(np.abs(ratios("breathing_1mm", range(numbers))) < 5.0)


def test_the_steps_of_an_encoder_count_as_noise(monkeypatch):
    """Alpha was 4.1 deviations off.

    Not where noise makes the reading of a hold flicker between two steps: docs/robots.md.
    """
    # It holds at 5 mm.
    monkeypatch.setattr(presses, "_MOST_THICKER", 0.0)
    (contact,) = trial_of(case_of("encoder_50um"), 1, {}).contacts
    assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)
