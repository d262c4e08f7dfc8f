# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a decision took, and how a site compares, in messages and back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from output_helpers import ESTIMATE, summary

from fden_ros.core.classification.classifier import ClassProbabilities
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.outputs import (
    Classification,
    Decided,
    Decision,
    Flag,
)
from fden_ros.offline.rows import CORRELATIONS, contact_row
from fden_ros.ros.messages import classification_message, summary_message, summary_of

CLASSES = ClassProbabilities("liver", ("liver", "unknown"), (0.9, 0.1), 0.4)
COVARIANCE = np.array([[4e-4, -1e-4, 0.0], [-1e-4, 4e-4, 1e-6], [0.0, 1e-6, 1e-6]])
SUMMARY = summary(
    flags=Flag.MODEL_MISMATCH, classes=CLASSES, estimate=ESTIMATE._replace(covariance=COVARIANCE)
)


def test_what_is_learned_of_the_rig_goes_into_the_summary():
    rig = RigKnowledge((2e-3, 0.01), ((1e-6, 0.0), (0.0, 0.0)), contacts=3)
    message = summary_message(replace(SUMMARY, rig=rig), "probe")
    assert (message.delay, message.friction) == (2e-3, 0.01)
    assert message.delay_sd == pytest.approx(1e-3)
    assert (message.friction_sd, message.rig_contacts) == (0.0, 3)


def test_decision_goes_into_the_message_with_its_flags():
    output = Classification(
        1, Decision.CLASS, 1, 1, Flag.MODEL_MISMATCH, CLASSES, "mine", Decided(0.8, 0.21)
    )
    message = classification_message(output, "probe")
    assert message.flags == Flag.MODEL_MISMATCH
    assert (message.label, message.typicality) == ("liver", 0.4)
    assert (message.decision_time, message.decision_strain) == (0.8, 0.21)
    assert (message.ratio, message.ratio_low, message.ratio_high) == (0.0, 0.0, 0.0)


def test_summary_comes_back_from_its_message():
    sent = replace(SUMMARY, decided=Decided(0.8, 0.21))
    back = summary_of(summary_message(sent, "probe"))
    assert back.classes == CLASSES
    assert back.decided == sent.decided


def test_row_of_a_table_has_the_correlations():
    row = contact_row(SUMMARY, None)
    for name, (i, j) in CORRELATIONS.items():
        expected = COVARIANCE[i, j] / math.sqrt(COVARIANCE[i, i] * COVARIANCE[j, j])
        assert row[name] == pytest.approx(expected)
