# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether residuals that should be independent, of variance 1, are larger or slower than that."""

from __future__ import annotations

from scipy.special import chdtri, ndtr

from fden_ros.core.arrays import Array

#: What lies beyond as many standard deviations of a normal is not by chance [1]: one record in
#: three million.
NO_CHANCE = 5.0


def contradicts(residuals: Array) -> bool:
    """Return whether sums over windows of 1, 2, 4, ... are larger than chance makes them.

    `residuals`: whitened, in the order of time, (n,).
    """
    size = 1
    while size <= residuals.size:
        count = residuals.size // size
        sums = residuals[: count * size].reshape(count, size).sum(axis=1)
        if float(sums @ sums) / size > chdtri(count, ndtr(-NO_CHANCE)):
            return True
        size *= 2
    return False
