# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One contact in a bounded number of points, close where strain or stress change."""

from __future__ import annotations

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator import Block

#: A block becomes a point when the compression has changed by this share, or by at least this much
#: [1]; or when the time since the last point is this share of the loading's age [1]. Half of each
#: gives the same deviations on beef, within a fifth of their standard deviations.
_MOTION_SHARE, _LEAST_MOTION = 0.05, 0.002
_AGE_SHARE = 0.1
#: Points at most [1]: a press to a strain of 0.4 with a hold of an hour takes 150. What comes
#: after is left out.
_MOST_POINTS = 160


class ContactRecord:
    """Blocks of a contact that begins at rest, thinned by the clocks of motion and relaxation."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin a contact."""
        self._points = [(0.0, 0.0, 0.0, 0.0)]

    def __len__(self) -> int:
        return len(self._points) - 1

    @property
    def duration(self) -> float:
        """Time from the touch to the last point [s]."""
        return self._points[-1][0]

    def add(self, block: Block, age: float) -> None:
        """Take a block, where the loading is of `age` [s]."""
        time, compression = self._points[-1][:2]
        moved = abs(block.compression - compression)
        is_point = moved > max(_MOTION_SHARE * abs(compression), _LEAST_MOTION)
        is_point |= block.memory_time - time > _AGE_SHARE * age
        if is_point and block.memory_time > time and len(self) < _MOST_POINTS:
            self._points.append(
                (block.memory_time, block.compression, block.stress, 1.0 / block.size)
            )

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Return times [s], compressions [1], stresses [Pa] and 1/(samples of a point) [1].

        The first is the touch: at time 0, where all is 0.
        """
        times, compressions, stresses, shares = np.array(self._points).T
        return times, compressions, stresses, shares
