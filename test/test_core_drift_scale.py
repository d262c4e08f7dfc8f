# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The scale of the force's drift in contact, learned over contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark import presses
from benchmark.presses import CASES, trial_of
from fden_ros.core.estimation.drift_scale import (
    DRIFT_SCALES,
    NO_DRIFT_EVIDENCE,
    drift_evidence,
    drift_share,
)
from fden_ros.core.estimation.rig_knowledge import RigKnowledge

NOISE, STATED = 1e-3**2, 10e-3**2
UNKNOWN = RigKnowledge((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)))


def after(changes):
    """Return what is known after changes of the air's force [N]."""
    known = UNKNOWN
    for change in changes:
        known = known.drifted(drift_evidence(change, NOISE, STATED))
    return known


def test_without_any_contact_the_stated_drift_counts():
    assert drift_share(NO_DRIFT_EVIDENCE) == UNKNOWN.drift_share == 1.0


def test_one_contact_after_which_the_air_is_as_before_makes_nothing_sharper():
    assert after([0.0]).drift_share == 1.0


def test_many_such_contacts_leave_a_quarter():
    generator = np.random.default_rng(3)
    assert after(generator.normal(0.0, 1e-3, 12)).drift_share == DRIFT_SCALES[-1] == 0.25


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


def test_sites_without_drift_sharpen_the_next(monkeypatch):
    monkeypatch.setattr(presses, "RATE_HZ", 100.0)
    rig = replace(CASES["undisturbed"], sites=3)
    learned = trial_of(rig, 1, {}).contacts[-1]
    stated = trial_of(rig, 1, {"force.learn_drift": False}).contacts[-1]
    assert learned.deviation[0] < 0.95 * stated.deviation[0]
    assert np.all(np.abs(learned.error) < 3.0 * learned.deviation)
