# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How the force rose out of the noise at a touch: along a line from a surface, or exponentially.

Below the boundary strain 1/Gn the law is linear, and a touch bends the force: there the surface
is. Where noise hides that part, the force that is seen rises as :math:`e^{G_n x}` from nowhere,
and a surface found by a line is where the noise ends, not where the tissue begins. Then the data
tell Gn, and of G only :math:`G e^{-G_n o}`, with the strain origin o open: G is not determined.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

#: Growths over the depth at which exponentials are compared with the line [1], a factor of the
#: root of two apart: a line bends less than the first of them, and the steepest is beyond what
#: the noise hides.
GROWTHS = (0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0, 5.66, 8.0)
#: The surface is seen where a line from it explains the force by at least this chi-squared better
#: than the exponential of the tissue found does [1], which is what tells a touch from a drift. Of
#: 60 simulated touches whose linear part was hidden none was above; of 99 whose linear part was
#: seen at most 10 were below.
_LEAST_EVIDENCE = 20.0


class Rise(NamedTuple):
    """The rise of the force until a touch was detected."""

    depth: float  #: of the probe behind the surface found, at the detection [m]
    #: Chi-squared by which the line is better than an exponential, for each of :data:`GROWTHS`.
    line_evidence: tuple[float, ...]

    @property
    def is_bent(self) -> bool:
        """Whether the surface is seen however the force of the tissue grows."""
        return min(self.line_evidence) >= _LEAST_EVIDENCE

    def shows_surface(self, growth: float) -> bool:
        """Whether the surface is seen if the force of the tissue grows exponentially.

        Parameters
        ----------
        growth : float
            Of the logarithm of the tissue's stress over the depth, beyond its boundary strain [1].
        """
        if growth < GROWTHS[0]:
            return True
        evidence = np.interp(math.log(growth), np.log(GROWTHS), self.line_evidence)
        return bool(evidence >= _LEAST_EVIDENCE)
