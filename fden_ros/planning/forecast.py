# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What a motion will tell: the posterior of its record, at tissues that are drawn.

Nothing here models a press: response, error processes, priors and modes are those of the posterior
that will be given the real record. With the Jacobian J whitened by the error processes,

.. math:: \Sigma = (J^T J + \Lambda)^{-1}

is the covariance at given scales of the law's errors, which compares motions; what is stated of
one is the mixture over scales and modes, with a noise that is drawn.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import UNSOLVABLE, Budget, ImaginedPress, Parts, Points
from fden_ros.planning.motion import Motion, Sensors, record
from fden_ros.planning.tissue import TissueBelief
from fden_ros.planning.touch import Touch, touch_of, zero_sd

#: Scales of the law's errors at which motions are compared, over the stated one [1]: of tissue
#: that is all but the law's.
_COMPARED = np.array([0.1, 0.1, 0.05])
#: Standard deviation of the origin before a touch was simulated [1].
_FIRST_ORIGIN_SD = 3e-3
#: Standard deviations of the origin that a touch may be before its nominal place [1].
_REACH = 6.0
#: Added to the variances where no contact is detected [1].
_UNTOLD = 100.0


class Expected(NamedTuple):
    """What one motion tells of one tissue."""

    variances: Array  #: of ln G, ln Gn and alpha [1] after each of such presses, (presses, 3)
    added: Array  #: what the thickness adds, and a contact that is not told, (3,)
    is_hidden: bool  #: by noise is where the force begins
    force: float  #: largest [N]
    is_left: bool  #: the tissue leaves the probe before the release

    def deviations(self, wider: Array | float = 1.0) -> Array:
        """Return the deviations that will be stated, where the law's are wider, (presses, 3)."""
        result: Array = np.sqrt(wider**2 * self.variances + self.added)
        return result


class Stated(NamedTuple):
    """What the estimator will state of one tissue."""

    deviations: Array  #: standard deviations of ln G, ln Gn and alpha [1], (3,)
    variances: Array  #: of these, but for the thickness, (3,)
    touch: Touch
    budget: Budget | None  #: of the first tissue alone


class Forecast:
    """What motions will tell of a tissue.

    Parameters
    ----------
    config : PipelineConfig
    sensors : Sensors
    tissue : TissueBelief
    """

    def __init__(self, config: PipelineConfig, sensors: Sensors, tissue: TissueBelief) -> None:
        self.config, self.sensors, self.tissue = config, sensors.slower(), tissue
        self._scale = config.geometry.stress_per_force
        self._mean, self._covariance = tissue.mean, tissue.covariance
        self._touches: dict[tuple[float, int], Touch] = {}

    def press(self, motion: Motion, origin_sd: float) -> ImaginedPress:
        """Return the press of a motion, with what is known of the tissue for a prior."""
        geometry, sensors = self.config.geometry, self.sensors
        return ImaginedPress(
            self.config.estimator,
            geometry,
            stress_sd=self._scale * sensors.force_sd,
            zero_sd=self._scale * zero_sd(sensors),
            compression_sd=sensors.displacement_sd / geometry.length,
            origin_sd=origin_sd,
            deepest=motion.deepest / geometry.length,
            mean=self._mean,
            covariance=self._covariance,
        )

    @property
    def _origin_sd(self) -> float:
        """Usual standard deviation of the origin at a touch [1]."""
        if self.config.contact_point is not None:
            return 0.0
        found = [touch.origin_sd for touch in self._touches.values()]
        return float(np.median(found)) if found else _FIRST_ORIGIN_SD

    def compared(self, motion: Motion, tissues: Array, presses: int = 1) -> Parts[list[Expected]]:
        """Return what up to so many presses tell of tissues (k, 3), at one place of the scales.

        Tissues that no number can hold are left out. A part is a tissue.
        """
        origin_sd = self._origin_sd
        press = self.press(motion, origin_sd)
        points = record(motion, self.config.geometry, self.sensors, _REACH * origin_sd)
        found: list[Expected] = []
        for seed, tissue in enumerate(tissues):
            yield points.times.size
            try:
                evaluation = press.evaluate(points, tissue)
                stress = evaluation.stress
                touch = self._touch(motion, points, stress, seed)
                kept, is_left = _kept(motion, points, stress)
                variances = press.variances(
                    points,
                    tissue,
                    evaluation,
                    _COMPARED,
                    origin_sd=touch.origin_sd,
                    observed=kept,
                    presses=presses,
                )
            except UNSOLVABLE:
                continue
            force = float(stress.max()) / self._scale
            found.append(Expected(variances, self._added(touch), touch.is_hidden, force, is_left))
        return found

    def _touch(self, motion: Motion, points: Points, stress: Array, seed: int) -> Touch:
        key = motion.speed, seed
        if key not in self._touches:
            course = points.middles, stress / self._scale
            self._touches[key] = touch_of(self.config, self.sensors, motion, course, seed)
        return self._touches[key]

    def _added(self, touch: Touch) -> Array:
        """Return what is added to the variances."""
        thickness = self.config.estimator.uncertainty.thickness_sd**2
        untold = 0.0 if touch.is_told else _UNTOLD
        return np.array([thickness + untold, thickness + untold, untold])

    def stated(self, motion: Motion, tissues: Array) -> Parts[list[Stated]]:
        """Return what the estimator will state of tissues (k, 3) after a motion, in parts."""
        found: list[Stated] = []
        common = self.press(motion, self._origin_sd)
        points = record(motion, self.config.geometry, self.sensors, _REACH * self._origin_sd)
        for seed, tissue in enumerate(tissues):
            try:
                stress = common.stress(points, tissue)
                touch = self._touch(motion, points, stress, seed)
                press = self.press(motion, touch.origin_sd)
                measured = stress + self._noise(points, seed)
                kept, _ = _kept(motion, points, stress)
                solutions = yield from press.solved(points, tissue, measured, kept)
            except UNSOLVABLE:
                continue
            _, covariance = solutions.moments
            budget = press.budget(solutions) if not found else None
            variances = covariance.diagonal()[:3]
            deviations = np.sqrt(variances + self._added(touch))
            found.append(Stated(deviations, variances, touch, budget))
        return found

    def _noise(self, points: Points, seed: int) -> Array:
        """Return the noise of the stresses of a record [Pa]."""
        noise = np.random.default_rng(seed).standard_normal(points.counts.size)
        noise *= self._scale * self.sensors.force_sd / np.sqrt(points.counts)
        return noise

    def depth_of_force(self, motion: Motion, force: float, tissues: Array) -> Array:
        """Return at which depth of a ramp tissues (k, 3) meet a force [N], (k,) [m]."""
        press = self.press(motion, self._origin_sd)
        points = record(motion, self.config.geometry, self.sensors, 0.0)
        depths = motion.depths(points.middles)
        found = np.zeros(len(tissues))
        for k, tissue in enumerate(tissues):
            try:
                stress = press.stress(points, tissue)
            except UNSOLVABLE:
                continue
            above = np.flatnonzero(stress > force * self._scale)
            found[k] = depths[above[0]] if above.size else motion.depth
        return found


def _kept(motion: Motion, points: Points, stress: Array) -> tuple[int, bool]:
    """Return how many blocks the tissue is on the probe, and whether it leaves too soon."""
    away = np.flatnonzero((stress <= 0.0) & (points.middles > motion.held[0]))
    if not away.size:
        return points.middles.size, False
    return int(away[0]), bool(points.middles[away[0]] < motion.held[1])
