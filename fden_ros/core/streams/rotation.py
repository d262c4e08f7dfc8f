# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as unit quaternions (x, y, z, w), and rigid transforms made of them."""

from __future__ import annotations

import math
from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

#: Part by which a measured number may differ from one that it stands for. A quaternion whose
#: length differs from 1 by more was never set, or is damaged.
TOLERANCE = 0.01


class Transform(NamedTuple):
    """Where a frame is, and how it is turned, in its parent."""

    translation: Vector  #: [m]
    rotation: Quaternion

    def then(self, child: Transform) -> Transform:
        """Return where a child of this frame is in this one's parent."""
        x, y, z = rotate(self.rotation, child.translation)
        a, b, c = self.translation
        return Transform((a + x, b + y, c + z), multiply(self.rotation, child.rotation))

    def inverse(self) -> Transform:
        """Return where the parent is in the frame."""
        back = conjugate(self.rotation)
        x, y, z = rotate(back, self.translation)
        return Transform((-x, -y, -z), back)


def normalised(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion of length 1; a ValueError says that it was far from that."""
    length = math.hypot(*quaternion)
    if not abs(length - 1.0) <= TOLERANCE:
        raise ValueError(f"the quaternion {quaternion} has length {length:g}; it must be 1")
    x, y, z, w = (part / length for part in quaternion)
    return x, y, z, w


def conjugate(quaternion: Quaternion) -> Quaternion:
    """Return the opposite rotation."""
    x, y, z, w = quaternion
    return -x, -y, -z, w


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation by `b` and then by `a`."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """Return a turned vector."""
    x, y, z, w = quaternion
    twice = [2.0 * part for part in cross((x, y, z), vector)]
    turned = cross((x, y, z), (twice[0], twice[1], twice[2]))
    a, b, c = (v + w * t + u for v, t, u in zip(vector, twice, turned, strict=True))
    return a, b, c


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def angle(a: Quaternion, b: Quaternion) -> float:
    """Return the angle between two rotations [rad]."""
    x, y, z, w = multiply(conjugate(a), b)
    return 2.0 * math.atan2(math.hypot(x, y, z), abs(w))


def slerp(a: Quaternion, b: Quaternion, fraction: float) -> Quaternion:
    """Return the rotation at a fraction of the shorter turn between two, at a constant rate."""
    product = sum(p * q for p, q in zip(a, b, strict=True))
    sign = -1.0 if product < 0.0 else 1.0
    product = min(abs(product), 1.0)
    first, second = 1.0 - fraction, fraction
    if product < 1.0:
        between = math.acos(product)
        first, second = (math.sin(part * between) / math.sin(between) for part in (first, second))
    x, y, z, w = (first * p + sign * second * q for p, q in zip(a, b, strict=True))
    length = math.hypot(x, y, z, w)
    return x / length, y / length, z / length, w / length
