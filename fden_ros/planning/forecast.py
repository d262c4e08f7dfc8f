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

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.budget import budget_of
from fden_ros.core.estimation.density import Belief
from fden_ros.core.estimation.estimate import Budget
from fden_ros.core.estimation.maxima import completed, find_maxima
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import NEARLY_FOUND, UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import Evaluation
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.search import Solved
from fden_ros.core.estimation.unknowns import LAW, ORIGIN, Lifetime
from fden_ros.planning.motion import Motion, Sensors, record, until
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
#: Speed of a release that is not looked at [m/s].
_AWAY = 1.0
_LAW = slice(0, len(LAW))


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
        #: Places of what is not known of the law.
        self._open = np.flatnonzero(tissue.covariance.diagonal() > 0.0)
        block = np.ix_(self._open, self._open)
        self._precision: Array = np.asarray(np.linalg.inv(tissue.covariance[block]), dtype=float)
        self._touches: dict[tuple[float, int], Touch] = {}

    def _setting(self, origin_sd: float) -> PressSetting:
        config = self.config.estimator
        return PressSetting(
            config,
            config.uncertainty,
            self.config.geometry,
            origin_sd,
            self._scale * self.sensors.force_sd,
            self._scale * zero_sd(self.sensors),
            0.0,
            RigKnowledge.stated(config),
        )

    def _posterior(self, setting: PressSetting, depth: float) -> Posterior:
        """Return the posterior of a press, with what is known of the tissue for a prior."""
        length = self.config.geometry.length
        noise = self.sensors.displacement_sd / length
        posterior = setting.posterior((), noise, depth / length)
        mean, precision = posterior.belief.mean.copy(), posterior.belief.precision.copy()
        mean[_LAW] = self.tissue.mean
        precision[np.ix_(self._open, self._open)] = self._precision
        posterior.belief = Belief(mean, precision)
        return posterior

    def _state(self, posterior: Posterior, tissue: Array) -> Array:
        state: Array = posterior.belief.mean.copy()
        state[_LAW] = tissue
        return state

    @property
    def _origin_sd(self) -> float:
        """Usual standard deviation of the origin at a touch [1]."""
        if self.config.strain_origin is not None:
            return 0.0
        found = [touch.origin_sd for touch in self._touches.values()]
        return float(np.median(found)) if found else _FIRST_ORIGIN_SD

    def compared(self, motion: Motion, tissues: Array, presses: int = 1) -> Parts[list[Expected]]:
        """Return what up to so many presses tell of tissues (k, 3), at one place of the scales.

        Tissues that no number can hold are left out. A part is a tissue.
        """
        setting = self._setting(self._origin_sd)
        kernel, characteristic, roughness = _COMPARED * setting.stated.characteristic_sd
        scales = Scales(kernel, characteristic, roughness, 1.0)
        posterior = self._posterior(setting, motion.deepest)
        points = record(motion, self.config.geometry, self.sensors, _REACH * setting.origin_sd)
        lasting = [u.lifetime is not Lifetime.CONTACT for u in posterior.model.unknowns]
        lasting += [True] * (posterior.model.size - len(lasting))
        found: list[Expected] = []
        for seed, tissue in enumerate(tissues):
            yield points.times.size
            state = self._state(posterior, tissue)
            try:
                evaluation = posterior.evaluate(points, state)
                touch = self._touch(motion, points, evaluation, seed)
                if setting.origin_sd:
                    evaluation.jacobian[:, ORIGIN] *= touch.origin_sd / setting.origin_sd
                errors = posterior.error_model.errors(points, state, evaluation)
                white = posterior.error_model.whitened(
                    evaluation.jacobian, errors, scales.roughness, scales.motion
                )
                kept, is_left = _kept(motion, points, evaluation)
                normal = white[:kept].T @ white[:kept]
                prior = posterior.precision(state, scales)
                covariances = _repeated(normal, prior, np.array(lasting), presses)
            except UNSOLVABLE:
                continue
            variances = np.array([c.diagonal()[_LAW] for c in covariances])
            force = float(evaluation.stress.max()) / self._scale
            found.append(Expected(variances, self._added(touch), touch.is_hidden, force, is_left))
        return found

    def _touch(self, motion: Motion, points: Points, found: Evaluation, seed: int) -> Touch:
        key = motion.speed, seed
        if key not in self._touches:
            course = points.middles, found.stress / self._scale
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
        geometry, length = self.config.geometry, self.config.geometry.length
        common = self._posterior(self._setting(self._origin_sd), motion.deepest)
        points = record(motion, geometry, self.sensors, _REACH * self._origin_sd)
        strain = geometry.strain(motion.deepest / length)
        for seed, tissue in enumerate(tissues):
            try:
                response = common.model.response(points, self._state(common, tissue))
                touch = self._touch(motion, points, response, seed)
                setting = self._setting(touch.origin_sd)
                posterior = self._posterior(setting, motion.deepest)
                own = self._measured(motion, points, response, seed)
                state = self._state(posterior, tissue)
                scales = posterior.grid[len(posterior.grid) // 2].scales
                maxima = yield from find_maxima(
                    posterior, own, [state], scales, (), strain, NEARLY_FOUND
                )
                solutions = yield from completed(posterior, own, maxima, strain)
            except UNSOLVABLE:
                continue
            _, covariance = solutions.moments
            budget = None
            if not found:
                solved = Solved(posterior, solutions, None, False)
                budget = budget_of(setting, solved, self.sensors.displacement_sd / length)
            variances = covariance.diagonal()[_LAW]
            deviations = np.sqrt(variances + self._added(touch))
            found.append(Stated(deviations, variances, touch, budget))
        return found

    def _measured(self, motion: Motion, points: Points, found: Evaluation, seed: int) -> Points:
        """Return a record with the stresses of a response, and noise, until the release."""
        kept, _ = _kept(motion, points, found)
        noise = np.random.default_rng(seed).standard_normal(found.stress.size)
        noise *= self._scale * self.sensors.force_sd / np.sqrt(points.counts)
        return until(replace(points, stresses=found.stress + noise), kept)

    def depth_of_force(self, motion: Motion, force: float, tissues: Array) -> Array:
        """Return at which depth of a ramp tissues (k, 3) meet a force [N], (k,) [m]."""
        posterior = self._posterior(self._setting(self._origin_sd), motion.deepest)
        points = record(motion, self.config.geometry, self.sensors, 0.0)
        depths = motion.depths(points.middles)
        found = np.zeros(len(tissues))
        for k, tissue in enumerate(tissues):
            try:
                stress = posterior.model.response(points, self._state(posterior, tissue)).stress
            except UNSOLVABLE:
                continue
            above = np.flatnonzero(stress > force * self._scale)
            found[k] = depths[above[0]] if above.size else motion.depth
        return found


def _kept(motion: Motion, points: Points, found: Evaluation) -> tuple[int, bool]:
    """Return how many blocks the tissue is on the probe, and whether it leaves too soon."""
    away = np.flatnonzero((found.stress <= 0.0) & (points.middles > motion.held[0]))
    if not away.size:
        return points.middles.size, False
    return int(away[0]), bool(points.middles[away[0]] < motion.held[1])


def _repeated(normal: Array, prior: Array, lasting: Array, presses: int) -> list[Array]:
    """Return the covariances after each press: what a contact alone has begins anew."""
    found = [_inverse(normal + prior)]
    for _ in range(presses - 1):
        before = prior.copy()
        kept = np.ix_(lasting, lasting)
        before[kept] = _inverse(found[-1][kept])
        found.append(_inverse(normal + before))
    return found


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a precision."""
    root = np.linalg.inv(np.linalg.cholesky(matrix))
    if not np.isfinite(root).all():
        raise np.linalg.LinAlgError("the precision is not finite")
    result: Array = root.T @ root
    return result
