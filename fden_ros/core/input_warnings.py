# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Problems of the input, in words."""

from __future__ import annotations

from collections.abc import Mapping

from fden_ros.advice import INPUTS
from fden_ros.core.plausibility import of_stream
from fden_ros.core.streams import Pair, Reason, SynchronizeConfig, Synchronizer

#: Means over this time are compared with the first of them [ns].
_BLOCK_NS = 100_000_000


class Direction:
    """Whether the force grows or falls from its first value, and whether with the motion.

    A contact only pushes: most of the force lies on one side of its first value.
    """

    def __init__(self) -> None:
        self._block: list[Pair] = []
        #: First and newest means of force and displacement.
        self._ends: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._force = 0.0  #: sum of signed squares of the force less its first value [N^2]
        self._together = 0.0  #: sum of the products of their changes [N m]

    def add(self, pair: Pair) -> None:
        """Add a pair, in order of time."""
        block = self._block
        if block and not 0 <= pair.stamp_ns - block[0].stamp_ns <= _BLOCK_NS:
            force, displacement = (
                sum(values) / len(block)
                for values in zip(*((one.force, one.displacement) for one in block), strict=True)
            )
            first, last = self._ends or ((force, displacement), (force, displacement))
            change = force - first[0]
            self._force += change * abs(change)
            self._together += (force - last[0]) * (displacement - last[1])
            self._ends = first, (force, displacement)
            block.clear()
        block.append(pair)

    @property
    def cause(self) -> str:
        """The likeliest cause of a force that falls below its value in the air.

        A touch, if the signs are right: the force grows with the displacement.
        """
        if self._force > 0.0:
            return "touch" if self._together >= 0.0 else "displacement sign"
        return "both signs" if self._together > 0.0 else "force sign"


def input_warnings(
    config: SynchronizeConfig,
    synchronizer: Synchronizer,
    air_events: tuple[int, int, bool],
    direction: Direction,
    rejected: Mapping[str, int],
    clock_jumps: int,
) -> dict[str, int]:
    """Return the problems of the samples in words, with counts.

    `air_events`: how often the force fell below its value in the air, how often it rose without a
    contact, and whether there was air at all. `rejected`: counts of ``"<stream>.<reason>"``.
    """
    falls, rises, has_air = air_events
    # A force of the wrong sign also rises, when it returns: the sign comes first.
    is_sign = not falls and direction.cause == "displacement sign"
    counts = {
        of_stream("force", synchronizer.force_guard, config.force_limit): 1,
        of_stream("displacement", synchronizer.displacement_guard, config.displacement_limit): 1,
        str(INPUTS["clock"]): clock_jumps,
        str(INPUTS[direction.cause]): rises if is_sign else falls,
        str(INPUTS["drift" if has_air else "rise"]): 0 if is_sign else rises,
        str(INPUTS["stuck"]): rejected.get(f"force.{Reason.STUCK}", 0),
    }
    return {words: count for words, count in counts.items() if words and count}
