# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How much of the stress a filter lacks that is linear about an earlier state.

The stress of a block goes with :math:`\varphi(x;\, G, G_n)\,A^{-\alpha}`, A the mean age of its
loading. With :math:`\Delta` the change of that logarithm from one state to another, and
:math:`\Delta_1` its linear part, a model that is linear about the first lacks

.. math::
    e^{\Delta} - 1 - \Delta_1

of the stress there: what a second-order filter would correct for (Bar-Shalom, Li and Kirubarajan
2001, section 10.3.2). The smooth errors of the law do not count.
"""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER
from fden_ros.core.law import log_phi


class LinearRange:
    """What a model that is linear about a state lacks at other states, for some blocks.

    Parameters
    ----------
    about : ndarray, shape (size,)
    age : float
        Mean time since the loading was built up [s].
    """

    def __init__(self, model: PressModel, points: Points, about: Array, age: float) -> None:
        self._geometry, self._about = model.geometry, about
        self._compressions, self._by_state = model.motion.ends(points, about)
        self._log_age = math.log(max(age, BLOCK_TIME))

    def lacking(self, block: int, state: Array) -> float:
        """Return what the model lacks at a block, in parts of its stress [1]."""
        off = state - self._about
        before, moved = float(self._compressions[block]), float(self._by_state[block] @ off)
        if before <= 0.0 or before + moved <= 0.0:
            return 0.0
        first, second = self._geometry.strain(before), self._geometry.strain(before + moved)
        excess = max(math.exp(self._about[LOG_GN]) * first - 1.0, 0.0)
        by_compression = self._geometry.strain_slope(before) / first * (1.0 + excess)
        relaxed = -self._log_age * float(off[ORDER])
        linear = off[LOG_G] + excess * off[LOG_GN] + by_compression * moved + relaxed
        change = _log_phi(second, state) - _log_phi(first, self._about) + relaxed
        # A factor of e^20 is far enough.
        return math.expm1(min(change, 20.0)) - float(linear)


def _log_phi(strain: float, state: Array) -> float:
    return float(log_phi(np.array(strain), state[LOG_G], state[LOG_GN]))
