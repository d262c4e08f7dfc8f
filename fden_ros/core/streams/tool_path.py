# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far a probe has gone along its own axis, wherever that points."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fden_ros.core.streams.rotation import Transform, Vector, dot, rotate


@dataclass(frozen=True)
class ToolPathConfig:
    """Along what a probe advances.

    Parameters
    ----------
    axis : Vector
        Unit vector in the probe's frame, out of its tip.
    normal : Vector, optional
        Unit vector into the tissue, perpendicular to its surface; where it is not known, the
        probe is taken to stand upright.
    """

    axis: Vector
    normal: Vector | None = None


class ToolPath:
    """Add up the probe's way along its axis.

    Steps are projected on the axis of their time, so that a turn far from the origin is no way.

    Parameters
    ----------
    config : ToolPathConfig
    """

    def __init__(self, config: ToolPathConfig) -> None:
        self._config = config
        self._last: tuple[Vector, Vector] | None = None
        self._way = 0.0

    def add(self, probe: Transform) -> tuple[float, float]:
        """Take the next place of the probe.

        Returns
        -------
        tuple of float
            Way into the tissue so far, from any origin [m]: along the axis, of that the part along
            the normal where it is known. Angle between the two [rad]; 0 where it is not.
        """
        place, axis = probe.translation, rotate(probe.rotation, self._config.axis)
        last, self._last = self._last, (place, axis)
        tilt = 0.0
        share = 1.0
        if self._config.normal is not None:
            share = min(max(dot(axis, self._config.normal), -1.0), 1.0)
            tilt = math.acos(share)
        if last is not None:
            (x0, y0, z0), (a0, b0, c0) = last
            step = place[0] - x0, place[1] - y0, place[2] - z0
            middle = 0.5 * (axis[0] + a0), 0.5 * (axis[1] + b0), 0.5 * (axis[2] + c0)
            self._way += share * dot(middle, step)
        return self._way, tilt
