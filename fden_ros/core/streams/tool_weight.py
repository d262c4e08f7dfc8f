# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What a turning tool's own weight adds to the measured force.

A tool of mass m beyond the sensor pulls on it with :math:`m R^T g`, where R is the sensor's
orientation and g gravity in the frame that R refers to; with the lever c of its centre of mass it
twists it by :math:`c \times m R^T g`. The part along the force's axis changes as the tool turns,
and looks like drift or contact if it is not taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

from fden_ros.core.streams.rotation import (
    Quaternion,
    Vector,
    conjugate,
    cross,
    normalised,
    rotate,
)


@dataclass(frozen=True)
class ToolWeight:
    """The load of a tool's weight along one axis of the sensor.

    Parameters
    ----------
    mass : float
        Of all that the sensor carries [kg].
    centre_of_mass : tuple of float
        In the sensor's frame [m].
    gravity : tuple of float
        In the frame that orientations refer to [m/s^2].
    axis : tuple of float
        Unit vector in the sensor's frame.
    is_torque : bool
        Whether the torque about the axis is wanted, not the force along it.

    Examples
    --------
    A tool of 0.2 kg that points down, and then lies on its side:

    >>> tool = ToolWeight(0.2, (0.0, 0.0, 0.05), (0.0, 0.0, -9.81), (0.0, 0.0, 1.0))
    >>> round(tool.load((0.0, 0.0, 0.0, 1.0)), 3)
    -1.962
    >>> abs(round(tool.load((0.7071, 0.0, 0.0, 0.7071)), 3))
    0.0
    """

    mass: float
    centre_of_mass: Vector
    gravity: Vector
    axis: Vector
    is_torque: bool = False

    def load(self, orientation: Quaternion, axis: Vector | None = None) -> float:
        """Return force [N] or torque [N m] of the weight along the axis, or another `axis`.

        Parameters
        ----------
        orientation : tuple of float
            Unit quaternion x, y, z, w that turns the sensor's frame into gravity's.

        Raises
        ------
        ValueError
            If `orientation` is no rotation.
        """
        weight = rotate(conjugate(normalised(orientation)), self.gravity)
        vector = cross(self.centre_of_mass, weight) if self.is_torque else weight
        return self.mass * sum(a * v for a, v in zip(axis or self.axis, vector, strict=True))
