# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is odd about the input, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from fden_ros.core.plausibility import of_stream
from fden_ros.core.streams.direction import Direction
from fden_ros.core.streams.samples import Reason
from fden_ros.core.streams.synchronize import SynchronizeConfig, Synchronizer

#: Samples that are usually without a partner when two streams begin.
_USUAL_UNPAIRED = 2


def input_warnings(
    config: SynchronizeConfig,
    synchronizer: Synchronizer,
    air_events: tuple[int, int],
    direction: Direction,
    rejected: Mapping[str, int],
    clock_jumps: int,
) -> dict[str, int]:
    """Return what was odd about the samples, in words, and how often.

    Parameters
    ----------
    config : SynchronizeConfig
    synchronizer, direction
        What saw the samples.
    air_events : tuple of int
        How often the force fell below its value in the air, and how often it drifted there.
    rejected : mapping
        Counts of rejected samples, keyed ``"<stream>.<reason>"``.
    clock_jumps : int
        How often the clock jumped.
    """
    falls, drifts = air_events
    counts = {
        of_stream("force", synchronizer.force_guard, config.force_limit): 1,
        of_stream("displacement", synchronizer.displacement_guard, config.displacement_limit): 1,
        "the clock jumped back: everything learned was reset": clock_jumps,
        f"the force fell below its value in the air: {direction.hint}": falls,
        "the force drifts in the air: tare, or let the sensor warm up": drifts,
        "the force repeated one value: is the sensor dead, or at its end?": rejected.get(
            f"force.{Reason.STUCK}", 0
        ),
    }
    return {words: count for words, count in counts.items() if words and count}


def unusual(rejected: Counter[str]) -> int:
    """Return the count of rejected samples, less the first two without a partner."""
    unpaired = rejected[f"force.{Reason.UNPAIRED}"]
    return rejected.total() - min(unpaired, _USUAL_UNPAIRED)
