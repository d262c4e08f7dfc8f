# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What adds to the stress of a press and changes with time, as processes in continuous time.

.. math::
    f = \text{model} + w(t) - k\,s(t) + v, \qquad
    dw = \rho f\,\sqrt{|d\ln(\varphi + \varphi_0)| + |d\ln(A + A_0)|}\;dB
         + c\,\sigma_d\,\sqrt{dt}\;dB', \qquad ds = \sigma_s\sqrt{dt}\;dB''

- w: what the law leaves out beside its smooth errors, relative to the stress, by the change of the
  elastic response and of the mean age A of the loading; and the drift of the force's zero. It
  begins with the uncertainty of the zero at the touch.
- s: the motion of the tissue's surface, against the stiffness k that it meets in 0.25 s.
- v: the noise of the force, of the motion, and the error of a motion that bends between samples.

Every variance is taken at the state that is asked for, over the time of a block. Nothing but the
last term depends on the sampling.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.loops import Evaluation, WalkState
from fden_ros.core.estimation.smooth_errors import STRAIN_FLOOR
from fden_ros.core.estimation.unknowns import LOG_G
from fden_ros.core.law import Geometry, apparent_stiffness_factor

#: Time for which the tissue's surface moves against its stiffness [s], as found on breathing and
#: heartbeat: the hereditary form is no better.
SURFACE_TIME = 0.25


class Row(enum.IntEnum):
    """Places of the processes of :class:`Errors`."""

    NOISE = 0
    GAIN = 1
    ROUGHNESS = 2
    DRIFT = 3
    MOTION = 4


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is measured."""

    stress: float  #: per sample [Pa]
    compression: float = 0.0  #: per sample [1]
    zero: float = 0.0  #: of the stress's zero at the touch [Pa]


class Loading(NamedTuple):
    """How the tissue is loaded at a block."""

    time: float  #: of the block [s]
    elastic: float  #: elastic response, and what counts as none [Pa s^alpha]
    age: float  #: mean time since it was built up [s]


@dataclass(frozen=True)
class Errors:
    """The error processes of a record at one state."""

    #: Of each block: variance of the noise [Pa^2], stress per compression of the surface [Pa],
    #: variance of the walk at rho = 1 [Pa^2], and the variances that drift [Pa^2] and surface [1]
    #: gain. Shape (5, m).
    rows: Array
    loading: Loading  #: at the last block

    @property
    def gain(self) -> Array:
        """Stress per compression of the surface [Pa], (m,)."""
        return self.rows[Row.GAIN]

    def under(self, other: Errors) -> Errors:
        """Return them with the variances of another stiffness, as stress: only the gain is own."""
        rows = other.rows.copy()
        rows[Row.GAIN] = self.gain
        moved = np.divide(other.gain, self.gain, out=np.ones_like(self.gain), where=self.gain != 0)
        rows[Row.MOTION] *= moved**2
        return Errors(rows, self.loading)


@dataclass(frozen=True)
class ErrorModel:
    """The error processes of one press."""

    geometry: Geometry
    uncertainty: Uncertainty
    noise: Noise
    #: The order of the relaxation at a state: that of the press's model.
    order: Callable[[Array], float]

    def errors(
        self, points: Points, state: Array, found: Evaluation, before: Loading | None = None
    ) -> Errors:
        """Return the processes at a state where the model is evaluated.

        `before`: the loading that the blocks go on from; None: none.
        """
        order = self.order(state)
        drift = (self.geometry.stress_per_force * self.uncertainty.force_drift_sd) ** 2
        motion = (self.uncertainty.surface_motion_sd / self.geometry.length) ** 2
        floor = STRAIN_FLOOR * math.exp(state[LOG_G])
        # Error of a strain whose motion bends between two samples, over the bend times the step
        # [1]: a quarter where it bends in the middle, 0.17 in the mean; without it chi-squared is
        # up to 9 a point.
        corner = 0.2
        # Shortest time that a step of the motion counts for [s].
        shortest = 1e-4
        # An age of less than a block counts as none.
        numbers = np.array(
            [
                *(self.noise.stress**2, self.noise.compression),
                *(order, 1.0 / math.gamma(1.0 - order)),
                *(drift, motion, apparent_stiffness_factor(order, SURFACE_TIME)),
                *(corner, shortest, floor, BLOCK_TIME),
            ]
        )
        loading = np.array(before or (points.times[0], floor, 0.0))
        rows = np.empty((5, points.stresses.size))
        loops.errors(
            found.elastic, found.slope, found.stress, points.first, points.last, points.met,
            points.counts, points.durations, points.middles, points.steps, points.bends,
            numbers, loading, rows,
        )  # fmt: skip
        return Errors(rows, Loading(*loading.tolist()))

    def walk(self, columns: int) -> WalkState:
        """Return the walks before the first block; `columns`: of rows that see them."""
        return WalkState(np.array([self.noise.zero**2, 0.0, 0.0]), np.zeros((2, columns)))

    def whitened(self, rows: Array, errors: Errors, roughness: float, motion: float) -> Array:
        """Return rows (m, k) as independent and of variance 1."""
        result = rows.copy(order="C")
        loops.whiten(result, errors.rows, roughness, motion, self.walk(rows.shape[1]))
        return result
