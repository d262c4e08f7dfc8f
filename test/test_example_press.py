# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The example's recording with parameters that are wrong, or say less or more than its own."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from property_helpers import first

from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.offline.replay import replay
from fden_ros.parameters import read_parameter_file
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from simulation.simulate import EXACT

EXAMPLES = Path(__file__).parent.parent / "examples"
#: ln G, G in Pa s^alpha, and ln Gn of the two contacts; alpha.
TRUTH = np.column_stack([np.log([[450.0, 9.0], [700.0, 8.0]]), [0.131, 0.131]])


@functools.cache
def _outputs(changes: tuple[tuple[str, object], ...]) -> list[Output]:
    outputs: list[Output] = []
    replay(
        EXAMPLES / "press.csv",
        read_parameter_file(EXAMPLES / "probe.yaml").changed(dict(changes)),
        Selection(columns=Columns.parse("time_s,force_N,depth_mm*1e-3")),
        on_output=lambda output, _frame: outputs.append(output),
    )
    return outputs


def outputs_of(changes: Mapping[str, object]) -> list[Output]:
    return _outputs(tuple(changes.items()))


def summaries(changes: Mapping[str, object]) -> list[ContactSummary]:
    return [output for output in outputs_of(changes) if isinstance(output, ContactSummary)]


def test_a_rig_that_leaves_nothing_open_is_ten_times_sharper_and_within_1_percent():
    for arm, exact, truth in zip(summaries({}), summaries(EXACT), TRUTH, strict=True):
        assert np.all(arm.estimate.deviations[:2] > 10 * exact.estimate.deviations[:2])
        assert exact.estimate.mean == pytest.approx(truth, abs=0.01)


@pytest.mark.parametrize("delay", [-0.01, 0.01, *first(0.02, -0.02, -0.0025)])
def test_a_wrong_delay_gives_no_wrong_number_under_a_good_status(delay):
    wrong = {"displacement.delay": delay}
    # Beyond what delay_sd allows for, the summaries alone.
    outputs = outputs_of(wrong) if abs(delay) <= 0.01 else summaries(wrong)
    claims = [
        (output.site_id, output.estimate)
        for output in outputs
        if isinstance(output, TissueState | ContactSummary) and output.estimate is not None
    ]
    assert claims
    for site_id, estimate in claims:
        error = np.abs(estimate.mean - TRUTH[site_id - 1])
        for index in range(3):
            assert not estimate.knows(index) or error[index] < 5.0 * estimate.deviations[index]
