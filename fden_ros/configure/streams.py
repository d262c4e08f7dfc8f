# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and motion of a probe as recorded: nothing projected, nothing scaled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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
    def start(self) -> float:
        """First stamp that both streams have reached [s]."""
        return float(max(self.force_times[0], self.motion_times[0]))

    @property
    def end(self) -> float:
        """Last stamp that both streams have [s]."""
        return float(min(self.force_times[-1], self.motion_times[-1]))

    def position_at(self, times: Array) -> Array:
        """Return the position at `times` (n,), linear between the samples: (n, 1) or (n, 3)."""
        columns = [np.interp(times, self.motion_times, column) for column in self.position.T]
        return np.stack(columns, axis=1)

    def rotation_at(self, times: Array) -> Array | None:
        """Return the sensor's orientation at `times` (n,) as matrices (n, 3, 3)."""
        if self.orientation is None:
            return None
        signed = _continuous(self.orientation)
        parts = [np.interp(times, self.motion_times, column) for column in signed.T]
        return matrices_of(np.stack(parts, axis=1))

    def scaled(self, force: float, position: float) -> Streams:
        """Return the same recording with force (and torque) and position multiplied."""
        torque = None if self.torque is None else force * self.torque
        return replace(
            self, force=force * self.force, torque=torque, position=position * self.position
        )


def _continuous(quaternions: Array) -> Array:
    """Return the quaternions (m, 4), each with the sign that is nearer to the one before."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)
    signed: Array = quaternions.copy()
    signed[1:] *= signs[:, None]
    return signed


def matrices_of(quaternions: Array) -> Array:
    """Return rotation matrices (n, 3, 3) of quaternions x, y, z, w of any length (n, 4)."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
