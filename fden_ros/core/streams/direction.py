# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which of the two streams seems to have the wrong sign, for a hint."""

from __future__ import annotations

from fden_ros.core.streams.samples import Pair

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
        if block and pair.stamp_ns - block[0].stamp_ns > _BLOCK_NS:
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
    def hint(self) -> str:
        """What to check where the force falls below its value in the air."""
        if self._force > 0.0 > self._together:
            return (
                "the force grows as the displacement falls: does the displacement have the wrong "
                "sign (displacement.axis, displacement.inverted)?"
            )
        begins = "or did the data begin in contact?"
        if self._force < 0.0 < self._together:
            return (
                "the displacement falls with it: do both have the wrong sign (force.axis and "
                f"displacement.axis, or their .inverted), {begins}"
            )
        return f"does it have the wrong sign (force.axis, force.inverted), {begins}"
