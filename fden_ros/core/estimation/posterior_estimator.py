# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator of one site: its presses, each with a posterior, and what is said of them.

After a press its posterior is the next one's prior, and the stress of the press goes on to act as
the free surface of the tissue.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.budget import Budget, budget_of
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.learned_scales import MOTION_SCALES
from fden_ros.core.estimation.press_estimate import estimate_of, prior_estimate
from fden_ros.core.estimation.press_model import FreeSurface
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.press_setting import Carried, PressSetting, rig_places
from fden_ros.core.estimation.record import Sample
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.search import Solved
from fden_ros.core.estimation.unknowns import Lifetime
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.relaxation import StressMoments

#: Standard deviation of the zero where it is not measured [N]: with 0 a preload puts ln Gn eight
#: standard deviations off.
_UNKNOWN_ZERO = 0.01
#: Probability of a relaxation that ends beyond which it is said [1].
_MISMATCH = 0.95
#: The speed at the touch is that of so long before it [s].
_TOUCH_TIME = 0.1
#: Part of the variance of what is stated of a rig that a press tells at least [1].
_LEAST_TOLD = 0.01


class PosteriorEstimator(Estimator):
    """The estimator of one site.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    path_variance : float
        Of the compression per sample, times the time between samples [s].
    rig : RigKnowledge, optional
        What earlier contacts have told; without it what the configuration states.

    Attributes
    ----------
    press : PressPosterior or None
        The newest press; None: there was none.
    work_share : float
        Part of the work of a block that is its own [1].
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
        path_variance: float = 0.0,
        rig: RigKnowledge | None = None,
    ) -> None:
        known = rig or RigKnowledge.stated(config)
        self._setting = PressSetting(
            replace(config, uncertainty=known.learned(config.uncertainty)),
            config.uncertainty,
            geometry,
            origin_sd,
            noise_sd,
            zero_sd=0.0,
            drift_sd=0.0,
            rig=known,
        )
        self._path_variance = path_variance
        self._time = self._deepest = self._compression_sd = 0.0
        self.press: PressPosterior | None = None
        self.work_share = 1.0
        self._moments, self._moments_at = StressMoments(), 0.0
        self._stress_before = 0.0
        self._sample_count = self._earlier_changes = 0
        self._mismatch_probability = math.nan

    # What others ask

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law.

        A law that is said to be exact: the residuals; else a relaxation that ends is likelier.
        """
        if not self._setting.is_bent:
            return self._solved is not None and self._solved.is_contradicted
        return self._mismatch_probability > _MISMATCH

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest solution was not found, or the newest block is not explained."""
        return self.press is not None and self.press.is_doubtful

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return self._earlier_changes + (self.press.change_count if self.press else 0)

    @property
    def likeliest(self) -> PosteriorEstimator:
        """Itself."""
        return self

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        if self._solved is None:
            return 0.0
        belief, best, off = self._solved.posterior.belief, self._solved.best, 0.0
        before = belief.variances()
        for k, unknown in enumerate(self._solved.model.unknowns):
            if unknown.lifetime is Lifetime.RIG:
                told = max(before[k] - best.covariance[k, k], _LEAST_TOLD * before[k])
                off = max(off, abs(best.mean[k] - belief.mean[k]) / math.sqrt(told))
        return off

    def motion_evidence(self) -> list[float] | None:
        """Return the log evidence of the press for scales of the surface's stated motion.

        The law counts as exact, so that all it leaves out counts as motion.
        """
        stated, press = self._setting.stated.surface_motion_sd, self.press
        if press is None or press.solved is None or press.is_lost or not stated:
            return None
        now = self._setting.config.uncertainty.surface_motion_sd
        solved = press.solved
        exact = min(weighed.scales for weighed in solved.posterior.grid)
        grid = [exact._replace(motion=scale * stated / now) for scale in MOTION_SCALES]
        points, maximum = press.record.points(), solved.best.maximum
        return [solved.posterior.evidence(points, replace(maximum, scales=s)) for s in grid]

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after the press; None where it tells nothing."""
        if self._solved is None:
            return None
        own, found = rig_places(self._solved.model)
        if not own:
            return None
        mean, covariance = self._setting.rig.scaled(self._setting.stated)
        best = self._solved.best
        mean[own] = best.mean[found]
        covariance[np.ix_(own, own)] = best.covariance[np.ix_(found, found)]
        return self._setting.rig.taught(mean, covariance, self._setting.config)

    @property
    def _solved(self) -> Solved | None:
        return self.press.solved if self.press is not None else None

    # Samples

    def go_on_beside(self, new: PosteriorEstimator) -> None:
        """Take over what a new one knows of noise and rig: one record is to weigh both."""
        self._carry()
        own, other = self._setting, new._setting
        self._setting = replace(own, config=other.config, rig=other.rig, stress_sd=other.stress_sd)
        self._path_variance = new._path_variance
        new._compression_sd = self._compression_sd

    def begin_contact(self, bias_sd: float, drift_sd: float, way: Array | None = None) -> None:
        """Start a press whose stress has a zero [Pa] and a drift [Pa/s] of its own."""
        self._carry()
        if self._setting.is_late and self._setting.carried is None and self._setting.origin_sd:
            self._setting = replace(self._setting, touch_speed=_touch_speed(way))
        setting = replace(
            self._setting,
            zero_sd=bias_sd or _UNKNOWN_ZERO * self._setting.geometry.stress_per_force,
            drift_sd=drift_sd,
        )
        if setting.carried is not None:
            self._moments.wait(self._time - self._moments_at)
            self._moments_at = self._time
            frozen = StressMoments()
            frozen.values = self._moments.values.copy()
            setting = replace(setting, free=FreeSurface(frozen, self._time))
        self._setting = setting
        self.press = PressPosterior(setting, self._time, self._deepest, self._compression_sd, way)

    def take(self, step: float, compression: float, stress: float, *, is_free: bool) -> None:
        """Take a sample of a contact, `step` seconds after the last.

        `is_free`: the tissue is not on the probe, as far as is known.
        """
        assert self.press is not None
        self._time += step
        sd = math.sqrt(self._path_variance / step) if step > 0.0 else 0.0
        self.press.work_share = self.work_share
        self.press.take(Sample(self._time, compression, stress), sd, is_free=is_free)

    def rest(self, duration: float) -> None:
        """Let time [s] pass between two contacts."""
        self._time += duration

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._remember(0.0)
        if self.press is not None:
            self.press.skip()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction."""
        assert self.press is not None
        self._remember(block.stress)
        self._sample_count += block.size
        innovation = self.press.update(block.stress, block.compression, is_past=block.is_past)
        self._see_mismatch()
        return innovation

    def budget(self) -> Budget | None:
        """Return what makes the estimate of the newest press uncertain; None: not known."""
        return budget_of(self.press) if self.press is not None else None

    def begin_finish(self) -> None:
        """Begin to solve anew at the end of a contact, from all starts."""
        if self.press is not None:
            self.press.begin_last()

    @property
    def is_working(self) -> bool:
        """Whether that is under way."""
        return self.press is not None and self.press.is_working

    def work(self, seconds: float) -> None:
        """Go on with that by the work of a time without samples [s]."""
        if self.press is not None:
            self.press.work(seconds)

    def finish(self) -> None:
        """Do what is left of it."""
        if self.press is not None:
            self.press.finish()
            self._see_mismatch()

    def _see_mismatch(self) -> None:
        if self._solved is not None and self._solved.mismatch_probability is not None:
            self._mismatch_probability = self._solved.mismatch_probability

    def _remember(self, stress: float) -> None:
        """Take the mean stress of a block into the tissue's memory."""
        step = self._time - self._moments_at
        if step > 0.0:
            self._moments.add(step, self._stress_before, stress)
            self._moments_at, self._stress_before = self._time, stress

    def _carry(self) -> None:
        """Make the posterior of the press the prior of the next."""
        press, self.press = self.press, None
        if press is None:
            return
        self._earlier_changes += press.change_count
        self._deepest, self._compression_sd = press.deepest, press.compression_sd
        if press.solved is not None:
            best = press.solved.best
            mean, covariance = press.solved.modes.mixed(best.mean, best.covariance)
            carried = Carried(press.solved.model, mean, covariance)
            self._setting = replace(self._setting, carried=carried)

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        estimate = None
        if self.press is not None:
            estimate = estimate_of(self.press, self._mismatch_probability)
        if estimate is None:
            estimate = prior_estimate(self._setting)
        return estimate._replace(sample_count=self._sample_count)


def _touch_speed(way: Array | None) -> float:
    """Return the speed of the compression before a touch [1/s]; 0: it was not seen to come."""
    if way is None or way.shape[1] < 2:
        return 0.0
    times, compressions, _ = way
    near = times >= times[-1] - _TOUCH_TIME
    if np.ptp(times[near]) <= 0.0:
        return 0.0
    return float(np.polyfit(times[near] - times[-1], compressions[near], 1)[0])
