# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is odd about the input, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from fden_ros.core.plausibility import of_stream
from fden_ros.core.streams import Pair, Reason, SynchronizeConfig, Synchronizer

#: Samples that are usually without a partner when two streams begin.
_USUAL_UNPAIRED = 2
#: Means over this time are compared with the first of them [ns].
_BLOCK_NS = 100_000_000


class Direction:
    """Whether the force grows or falls from where it began, and whether the motion goes with it.

    A contact only pushes: most of the force lies on one side of its first value.
    """

    def __init__(self) -> None:
        self._block: list[Pair] = []
        self._first: float | None = None
        self._last: tuple[float, float] | None = None
        self._force = 0.0  #: sum of signed squares of the force against its first value [N^2]
        self._together = 0.0  #: sum of the products of their changes [N m]

    def add(self, pair: Pair) -> None:
        """Take a pair, in order of time."""
        block = self._block
        if block and not 0 <= pair.stamp_ns - block[0].stamp_ns <= _BLOCK_NS:
            self._close(
                sum(one.force for one in block) / len(block),
                sum(one.displacement for one in block) / len(block),
            )
            block.clear()
        block.append(pair)

    def _close(self, force: float, displacement: float) -> None:
        if self._first is None or self._last is None:
            self._first = force
        else:
            change = force - self._first
            self._force += change * abs(change)
            self._together += (force - self._last[0]) * (displacement - self._last[1])
        self._last = force, displacement

    @property
    def is_right(self) -> bool:
        """Whether the signs are as they have to be: the force grows, and the displacement too."""
        return self._force > 0.0 and self._together >= 0.0

    @property
    def hint(self) -> str:
        """What to check where the force falls below its value in the air."""
        if self._force > 0.0 > self._together:
            return (
                "the force grows as the displacement falls: does the displacement have the wrong "
                "sign (displacement.axis, displacement.inverted)?"
            )
        begins = "or did the data begin in contact?"
        if self.is_right:
            return f"was a slow or faint touch taken for the air (touch faster), {begins}"
        if self._together > 0.0:
            return (
                "the displacement falls with it: do both have the wrong sign (force.axis and "
                f"displacement.axis, or their .inverted), {begins}"
            )
        return f"does it have the wrong sign (force.axis, force.inverted), {begins}"


def input_warnings(
    config: SynchronizeConfig,
    synchronizer: Synchronizer,
    air_events: tuple[int, int, bool],
    direction: Direction,
    rejected: Mapping[str, int],
    clock_jumps: int,
) -> dict[str, int]:
    """Return what was odd about the samples, in words, and how often.

    Parameters
    ----------
    synchronizer, direction
        What saw the samples.
    air_events : tuple of int
        How often the force fell below its value in the air, how often it rose without a contact,
        and whether there was air at all.
    rejected : mapping
        Counts of rejected samples, keyed ``"<stream>.<reason>"``.
    clock_jumps : int
        How often the clock jumped.
    """
    falls, drifts, has_air = air_events
    rise = "the force drifts in the air: tare, or let the sensor warm up"
    if not has_air:
        # It may be the tissue's.
        rise = (
            "the force rises without a touch. Did the data begin in contact (begin in the air; a "
            "testing machine's table: --from-touch)? Or does it drift (tare, or let the sensor "
            "warm up)?"
        )
    counts = {
        of_stream("force", synchronizer.force_guard, config.force_limit): 1,
        of_stream("displacement", synchronizer.displacement_guard, config.displacement_limit): 1,
        "the clock jumped back: everything learned was reset": clock_jumps,
        f"the force fell below its value in the air: {direction.hint}": falls,
        rise: drifts,
        "the force repeated one value: is the sensor dead, or at its end?": rejected.get(
            f"force.{Reason.STUCK}", 0
        ),
    }
    return {words: count for words, count in counts.items() if words and count}


def unusual(rejected: Counter[str]) -> int:
    """Return the count of rejected samples, less the first two without a partner."""
    unpaired = rejected[f"force.{Reason.UNPAIRED}"]
    return rejected.total() - min(unpaired, _USUAL_UNPAIRED)
