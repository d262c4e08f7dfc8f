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

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.loop_arguments import WalkState
from fden_ros.core.estimation.press_model import Evaluation, PressModel
from fden_ros.core.estimation.record import BLOCK_TIME, Points
from fden_ros.core.estimation.unknowns import LOG_G, STRAIN_FLOOR
from fden_ros.core.law.characteristic import apparent_stiffness_factor

#: Time for which the tissue's surface moves against its stiffness [s], as found on breathing and
#: heartbeat: the hereditary form is no better.
SURFACE_TIME = 0.25
#: Error of a strain whose motion bends between two samples, over the bend times the step [1]: a
#: quarter where it bends in the middle, 0.17 in the mean; without it chi-squared is up to 9 a
#: point.
_CORNER = 0.2
#: Shortest time that a step of the motion counts for [s].
_SHORTEST = 1e-4


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
    """The error processes of a record at one state, per block, each of shape (m,)."""

    noise: Array  #: variances of the blocks [Pa^2]
    gain: Array  #: stress per compression of the surface [Pa]
    rough: Array  #: variance of the walk at rho = 1 [Pa^2]
    #: Variances that drift and surface gain [Pa^2, 1].
    drift: Array
    motion: Array
    loading: Loading  #: at the last block

    def walks(self, roughness: float, motion: float) -> tuple[Array, Array]:
        """Return the variances that the walks gain, at scales of roughness and motion."""
        return roughness**2 * self.rough + self.drift, motion**2 * self.motion


class ErrorModel:
    """The error processes of one press.

    Parameters
    ----------
    model : PressModel
    uncertainty : Uncertainty
    noise : Noise
    """

    def __init__(self, model: PressModel, uncertainty: Uncertainty, noise: Noise) -> None:
        self._model, self._noise = model, noise
        geometry = model.geometry
        self._drift = (geometry.stress_per_force * uncertainty.force_drift_sd) ** 2
        self._motion = (uncertainty.surface_motion_sd / geometry.length) ** 2

    def errors(
        self, points: Points, state: Array, found: Evaluation, before: Loading | None = None
    ) -> Errors:
        """Return the processes at a state where the model is evaluated.

        `before`: the loading that the blocks go on from; None: none.
        """
        elastic, slope = np.abs(found.elastic), found.slope
        order = self._model.order(state)
        factor = 1.0 / math.gamma(1.0 - order)
        stiffness = points.mean(slope)
        noise = self._noise.stress**2 / points.counts
        if self._noise.compression:
            fast = stiffness * factor * np.maximum(points.durations, _SHORTEST) ** -order
            noise = noise + (fast * self._noise.compression) ** 2 / points.counts
        step = np.maximum(points.steps, _SHORTEST)
        # Where the motion bends at the touch, the slope is that of the step behind it.
        steepest = np.maximum(slope, np.append(slope[1:], 0.0))
        corner = (_CORNER * points.bends * points.steps * steepest * factor * step**-order) ** 2
        by_block = np.maximum.reduceat(corner, points.met)
        by_block[1:] += by_block[:-1].copy()
        for value, unknown in zip(state, self._model.unknowns, strict=False):
            if unknown.since is not None:
                # A block that the change cuts may have had it for all or none of its time, and so
                # may the next, where the change was that much later.
                cut = points.middles - points.durations <= unknown.since
                cut &= unknown.since < points.middles + points.durations
                by_block += cut * (value * points.mean(elastic * factor * step**-order)) ** 2
        floor = STRAIN_FLOOR * math.exp(state[LOG_G])
        before = before or Loading(float(points.times[0]), floor, 0.0)
        seconds = np.diff(points.middles, prepend=before.time)
        loading = np.array([before.elastic, before.age])
        # An age of less than a block counts as none.
        clock = loops.clock(points.mean(elastic) + floor, seconds, BLOCK_TIME, loading)
        return Errors(
            noise=noise + by_block,
            gain=-stiffness * apparent_stiffness_factor(order, SURFACE_TIME),
            rough=found.stress**2 * clock,
            drift=self._drift * seconds,
            motion=self._motion * seconds,
            loading=Loading(float(points.middles[-1]), float(loading[0]), float(loading[1])),
        )

    def whitened(
        self, rows: Array, errors: Errors, roughness: float, motion: float
    ) -> tuple[Array, float, WalkState]:
        """Return rows (m, k) as independent and of variance 1, and log det of their covariance."""
        result = np.ascontiguousarray(rows)
        if result is rows:
            result = rows.copy()
        state = WalkState(np.array([self._noise.zero**2, 0.0, 0.0]), np.zeros((2, rows.shape[1])))
        walks = errors.walks(roughness, motion)
        return result, loops.whiten(result, errors.noise, errors.gain, walks, state), state
