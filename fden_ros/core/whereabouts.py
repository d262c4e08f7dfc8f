# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The place of a site: which positions belong to it, and whether the probe was dragged out."""

from __future__ import annotations

import math

from fden_ros.core.config import PipelineConfig
from fden_ros.core.streams import Pair, Position

#: A probe is dragged beyond this multiple of the distance of two sites, so that noise of the
#: position does not count.
_DRAGGED = 2.0


class Whereabouts:
    """Where a site was touched, and the motion of the probe since."""

    def __init__(self, first: Pair, config: PipelineConfig) -> None:
        self._config, self._touched_at = config, first.displacement
        self.touched = self.left = first.position

    def is_apart(self, position: Position | None) -> bool | None:
        """Whether a position is of another site; None: not known."""
        if self.touched is None or position is None:
            return None
        return self._config.is_apart(self.touched, position)

    def is_at(self, position: Position | None) -> bool:
        """Whether a position is known to be of this site."""
        return self.is_apart(position) is False

    def is_dragged(self, pair: Pair) -> bool:
        """Whether the probe has moved aside from its touch, and farther than in.

        It then presses on tissue whose past was not seen. The part of its path that is not its
        displacement is aside, in whatever frame the approach axis is. (Along an axis that is
        tilted by less than 45 degrees it moves less to the side than in.)
        """
        if self.touched is None or pair.position is None:
            return False
        path = math.dist(self.touched, pair.position)
        inward = abs(pair.displacement - self._touched_at)
        least = _DRAGGED * self._config.site_distance
        return path**2 > inward**2 + max(least, inward) ** 2
