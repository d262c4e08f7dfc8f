# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The tool: its travel along its own axis, and the force by its weight.

A tool of mass m beyond the sensor pulls on it with :math:`m R^T g`, where R is the sensor's
orientation and g gravity in the frame that R refers to; with the lever c of its centre of mass it
twists it by :math:`c \times m R^T g`. The part along the force's axis changes as the tool turns,
and looks like drift or contact unless it is subtracted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fden_ros.core.parameter import parameter
from fden_ros.core.streams.rotation import (
    Quaternion,
    Transform,
    Vector,
    conjugate,
    cross,
    dot,
    normalised,
    rotate,
)


class ToolPath:
    """Adds up the travel of the probe along its axis.

    Steps are projected on the axis of their time, so that a turn far from the origin
    adds nothing. `axis` and `normal` are those of `SynchronizeConfig`.
    """

    def __init__(self, axis: Vector, normal: Vector | None) -> None:
        self._axis, self._normal = axis, normal
        self._last: tuple[Vector, Vector] | None = None
        self._advance = 0.0

    def add(self, probe: Transform) -> tuple[float, float]:
        """Add the next place of the probe; return depth so far [m] and tilt [rad].

        The depth, from any origin, is along the axis, and of that the part along the normal if it
        is known. The tilt is the angle between the two, otherwise 0.
        """
        place, axis = probe.translation, rotate(probe.rotation, self._axis)
        last, self._last = self._last, (place, axis)
        normal = self._normal
        cosine = 1.0 if normal is None else min(max(dot(axis, normal), -1.0), 1.0)
        tilt = math.acos(cosine)
        if last is not None:
            (x0, y0, z0), (a0, b0, c0) = last
            step = place[0] - x0, place[1] - y0, place[2] - z0
            middle = 0.5 * (axis[0] + a0), 0.5 * (axis[1] + b0), 0.5 * (axis[2] + c0)
            self._advance += cosine * dot(middle, step)
        return self._advance, tilt


@dataclass(frozen=True)
class ToolWeight:
    """The load of a tool's weight along one axis of the sensor.

    Examples
    --------
    A tool of 0.2 kg that points down, and then lies on its side:

    >>> tool = ToolWeight(0.2, (0.0, 0.0, 0.05), (0.0, 0.0, -9.81), (0.0, 0.0, 1.0))
    >>> round(tool.load((0.0, 0.0, 0.0, 1.0)), 3)
    -1.962
    >>> abs(round(tool.load((0.7071, 0.0, 0.0, 0.7071)), 3))
    0.0
    """

    mass: float = parameter(
        "tool.mass",
        0.0,
        "Mass that the force sensor carries, for a tool that turns. Its weight is subtracted "
        "from the force, with the orientation of the displacement's pose or transform.",
        "kg",
        0.0,
        1000.0,
    )
    centre_of_mass: Vector = parameter(
        "tool.centre_of_mass",
        (0.0, 0.0, 0.0),
        "Centre of mass in the sensor's frame; used only for a torque.",
        "m",
        may_be_zero=True,
    )
    gravity: Vector = parameter(
        "tool.gravity",
        (0.0, 0.0, -9.80665),
        "Gravity in the frame of the poses, for a sensor that measures the load on the tool; "
        "otherwise reverse it.",
        "m/s^2",
    )
    axis: Vector = (0.0, 0.0, 1.0)  #: unit vector in the sensor's frame
    is_torque: bool = False  #: the torque about the axis is wanted, not the force along it

    def load(self, orientation: Quaternion, axis: Vector | None = None) -> float:
        """Return force [N] or torque [N m] of the weight along the axis, or another `axis`.

        `orientation` turns the sensor's frame into gravity's; a ValueError says that it is no
        rotation.
        """
        weight = rotate(conjugate(normalised(orientation)), self.gravity)
        vector = cross(self.centre_of_mass, weight) if self.is_torque else weight
        return self.mass * sum(a * v for a, v in zip(axis or self.axis, vector, strict=True))
