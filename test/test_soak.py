# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Hours on a robot, faster than real time: one pipeline, shift after shift, a fault in each.

Three shifts in each run, an hour's worth with ``make statistics``.
"""

from __future__ import annotations

import math
import pickle
import random

import pytest
from fault_helpers import WARNING_FLAGS, shift, undisturbed
from pipeline_helpers import Item
from property_helpers import counts
from test_faults import ROWS

from fden_ros.core.outputs import ContactSummary, Output
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.parameters import check, pipeline_config

#: These leave no clean part behind: the same stamps again, a sensor that stays dead or slow, or
#: air that is not the air's for less than a lookback before the third site.
LEFT_OUT = {
    "bag_loops",
    "bias_steps",
    "contact_at_start",
    "force_wrong_sign",
    "rate_changes",
    "rate_changes_of_one",
    "topic_stops",
}
#: Estimates of the clean part may differ by so many standard deviations: what came before moves
#: the grid of the blocks and the bias that was measured, not what was pressed.
DEVIATIONS = 1.0


def ignored(output: object) -> None:
    """Take an output and forget it."""


class Emitter:
    """Keeps the last summary only."""

    def __init__(self) -> None:
        self.last: ContactSummary | None = None
        self.count = 0

    def __call__(self, output: Output) -> None:
        self.count += 1
        if isinstance(output, ContactSummary):
            self.last = output


@pytest.mark.parametrize("seconds", counts(30, 3600))
def test_mixed_faults_leave_the_clean_part_and_the_memory_as_they_were(seconds: int) -> None:
    s = shift()
    duration = s.second(s.items[-1].stamp_ns) + 0.5
    clean = undisturbed().summaries[-1]
    assert clean.estimate is not None
    emitter = Emitter()
    pipeline = Pipeline(pipeline_config(check(s.parameters)), emitter)
    rows = [row for row in ROWS if row.name not in LEFT_OUT and not row.parameters]
    generator = random.Random(11)
    offset, sizes, played = 0, [], []
    for _ in range(max(round(seconds / duration), 1)):
        row = generator.choice(rows)
        played.append(row.name)
        # A robot is back at its first site before the next shift.
        for item in row.samples(s):
            if not isinstance(item, Item):
                item(pipeline)
                continue
            stamp = item.stamp_ns and item.stamp_ns + offset
            if item.stream == 0:
                pipeline.add_force(stamp, item.value)
            else:
                pipeline.add_displacement(stamp, item.value, item.position)
        found = emitter.last
        assert found is not None and found.estimate is not None, played
        assert found.converged and found.complete and not found.flags & WARNING_FLAGS, played
        sd = math.sqrt(max(clean.estimate.covariance[0, 0], found.estimate.covariance[0, 0]))
        difference = found.estimate.log_linear_stiffness - clean.estimate.log_linear_stiffness
        assert abs(difference) < DEVIATIONS * sd, played
        emitter.last = None
        offset += round((duration + row.moved) * NANOSECONDS)
        pipeline._emit_output = ignored
        sizes.append(len(pickle.dumps(pipeline)))
        pipeline._emit_output = emitter
    assert emitter.count > 100 * len(played)
    assert max(sizes) < 1.2 * sizes[0] + 50_000, sizes
