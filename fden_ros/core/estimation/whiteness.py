# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether residuals that should be independent, of variance 1, are larger or slower than that."""

from __future__ import annotations

import math

from fden_ros.core.arrays import Array

#: Scales j of the windows of 2^j residuals whose sums are tested [1].
_SCALES = 14
#: Chi-squared of a scale is too large beyond as many standard deviations of a normal [1]: one
#: record in three million is by chance.
_DEVIATIONS = 5.0


def contradicts(residuals: Array) -> bool:
    """Return whether sums over windows of some length are larger than chance makes them.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
        Whitened, in the order of time.
    """
    for scale in range(_SCALES):
        size = 1 << scale
        count = residuals.size // size
        if not count:
            return False
        sums = residuals[: count * size].reshape(count, size).sum(axis=1)
        if float(sums @ sums) / size > _chi_squared_limit(count):
            return True
    return False


def _chi_squared_limit(degrees: int) -> float:
    """Return what chi-squared exceeds by chance as seldom as a normal _DEVIATIONS.

    (Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.)
    """
    spread = 2.0 / (9.0 * degrees)
    return float(degrees * (1.0 - spread + _DEVIATIONS * math.sqrt(spread)) ** 3)
