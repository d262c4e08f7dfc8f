# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and motion of a probe as recorded: nothing projected, nothing scaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fden_ros.core.arrays import Array


@dataclass(frozen=True)
class Streams:
    """One recording: force and position with their stamps, in the units of the recording.

    Parameters
    ----------
    name : str
        Of the recording.
    force_times : Array
        Stamps [s], increasing, shape (n,).
    force : Array
        Shape (n, 3) of a wrench, (n, 1) of a number.
    motion_times : Array
        Stamps [s], increasing, shape (m,).
    position : Array
        Shape (m, 3) of a pose, (m, 1) of a joint.
    torque : Array, optional
        Of the wrench, shape (n, 3).
    orientation : Array, optional
        Unit quaternions x, y, z, w that turn the sensor's frame into the positions', (m, 4).
    """

    name: str
    force_times: Array
    force: Array
    motion_times: Array
    position: Array
    torque: Array | None = None
    orientation: Array | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Components of force and position."""
        return self.force.shape[1], self.position.shape[1]

    @property
    def start(self) -> float:
        """First stamp that both streams have reached [s]."""
        return float(max(self.force_times[0], self.motion_times[0]))

    @property
    def end(self) -> float:
        """Last stamp that both streams have [s]."""
        return float(min(self.force_times[-1], self.motion_times[-1]))

    def rotation_at(self, times: Array) -> Rotation | None:
        """Return the sensor's orientation at `times` (n,)."""
        if self.orientation is None:
            return None
        flips = np.sum(self.orientation[1:] * self.orientation[:-1], axis=1) < 0.0
        signs = np.where(np.cumsum([False, *flips]) % 2 == 1, -1.0, 1.0)
        parts = (signs[:, None] * self.orientation).T
        turns = [np.interp(times, self.motion_times, part) for part in parts]
        return Rotation.from_quat(np.stack(turns, axis=1))

    def turn_rates(self, times: Array) -> Array:
        """Return how fast the tool turns between `times` (n,): (n - 1,) [rad/s]; 0: not known."""
        turns = self.rotation_at(times)
        if turns is None:
            return np.zeros(times.size - 1)
        return np.asarray((turns[1:] * turns[:-1].inv()).magnitude() / np.diff(times))
