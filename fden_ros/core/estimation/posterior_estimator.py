# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator of one site: its presses, each with a posterior, and what is said of them.

After a press its posterior is the next one's prior, and the stress of the press goes on to act as
the free surface of the tissue. Where nothing says that a touch is of the same place, there are
several pasts, and a hypothesis for each.
"""

from __future__ import annotations

import math

from scipy.special import expit

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Sample
from fden_ros.core.estimation.budget import budget_of
from fden_ros.core.estimation.estimate import Budget, Estimate
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.hypothesis import MISMATCH, Past
from fden_ros.core.estimation.intake import Intake
from fden_ros.core.estimation.pasts import Pasts
from fden_ros.core.estimation.press_estimate import estimate_of, prior_estimate
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.proposals.place import Tissue
from fden_ros.core.estimation.search import Solved
from fden_ros.core.law import Geometry


class PosteriorEstimator(Estimator):
    """The estimator of one site.

    Parameters
    ----------
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    path_variance : float
        Of the compression per sample, times the time between samples [s].

    Attributes
    ----------
    press : PressPosterior or None
        The newest press; None: there was none.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
        path_variance: float = 0.0,
    ) -> None:
        self._pasts = Pasts(
            PressSetting(config, geometry, origin_sd, noise_sd, zero_sd=0.0, drift_sd=0.0)
        )
        self._path_variance = path_variance
        self._time = self._compression_sd = 0.0
        self.press: PressPosterior | None = None

    def may_be_of(self, other: PosteriorEstimator, shift: float, log_wider: float) -> None:
        """Take the tissue of another estimator for what may be touched next.

        Parameters
        ----------
        other : PosteriorEstimator
            Of the touch before; it is not used any more.
        shift : float
            By which its compressions are larger [1].
        log_wider : float
            Logarithm of how much wider the origin's prior is than where the touch showed the
            surface: that noise may hide it there makes this no less likely.
        """
        before = other.estimate()
        last = Tissue(before.mean, before.covariance)
        other.put_away()
        other._pasts.wait(other._time)
        self._pasts.may_be_of(other._pasts, shift, last, log_wider)
        self._compression_sd = other._compression_sd

    # What others ask

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law.

        A law that is said to be exact: the residuals; else another law is likelier.
        """
        if not self._best.setting.is_bent:
            return self._solved is not None and self._solved.is_contradicted
        return self._mismatch_probability > MISMATCH

    @property
    def _mismatch_probability(self) -> float:
        """Of another law, by the pasts that know it [1]; NaN: none does."""
        known = [
            (weight, past.mismatch_probability)
            for weight, past in self._weighed_pasts()
            if not math.isnan(past.mismatch_probability)
        ]
        total = sum(weight for weight, _ in known)
        return sum(weight * odds for weight, odds in known) / total if total else math.nan

    def _weighed_pasts(self) -> list[tuple[float, Past]]:
        """Return the pasts with their probabilities by now."""
        if self.press is not None and self.press.weighed:
            return [(weight, one.past) for weight, one in self.press.weighed]
        return self._pasts.weighed

    @property
    def _best(self) -> Past:
        """The likeliest past."""
        if self.press is not None and self.press.weighed:
            return self.press.best.past
        return max(self._weighed_pasts(), key=lambda pair: pair[0])[1]

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest solution was not found, or the newest block is not explained."""
        return self.press is not None and self.press.is_doubtful

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        return self._solved.rig_misfit if self._solved is not None else 0.0

    @property
    def _solved(self) -> Solved | None:
        return self.press.solved if self.press is not None else None

    # Samples

    def begin_contact(self, bias_sd: float, drift_sd: float, way: Array | None = None) -> None:
        """Start a press whose stress has a zero [Pa] and a drift [Pa/s] of its own."""
        self.put_away()
        self._pasts.wait(self._time)
        hypotheses = self._pasts.hypotheses(bias_sd, drift_sd)
        settings = [one.setting for one in hypotheses]
        known = self._compression_sd, self._path_variance
        self.press = PressPosterior(hypotheses, Intake(settings, self._time, *known, way))

    def take(self, step: float, compression: float, stress: float, *, is_free: bool) -> None:
        """Take a sample of a contact, `step` seconds after the last."""
        assert self.press is not None
        self._time += step
        self.press.take(Sample(self._time, compression, stress), step, is_free=is_free)

    def rest(self, duration: float) -> None:
        """Let time [s] pass between two contacts."""
        self._time += duration

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._pasts.remember(self._time, 0.0)
        if self.press is not None:
            self.press.intake.skip()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction."""
        assert self.press is not None
        self._pasts.remember(self._time, block.stress)
        for past in self._pasts.all:
            past.sample_count += block.size
        innovation = self.press.update(block.stress, block.compression, is_past=block.is_past)
        self._see_mismatch()
        return innovation

    def budget(self) -> Budget | None:
        """Return what makes the estimate of the newest press uncertain; None: not known."""
        press = self.press
        if press is None or press.solved is None or press.best.misses:
            return None
        return budget_of(press.setting, press.solved)

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
            # Three times as much as in contact: no filter takes samples in the air, and the last
            # solution is found within 0.8 s.
            self.press.work(3.0 * seconds)

    def finish(self) -> None:
        """Do what is left of it."""
        if self.press is not None:
            self.press.finish()
            self._see_mismatch()

    def _see_mismatch(self) -> None:
        for one in self.press.hypotheses if self.press is not None else ():
            if one.plateau_odds is not None:
                one.past.mismatch_probability = float(expit(one.plateau_odds))

    def put_away(self) -> None:
        """Make the posterior of the press the prior of the next, for each past that it leaves."""
        press, self.press = self.press, None
        if press is None:
            return
        self._compression_sd = press.intake.compression_sd
        weighed = press.weighed or [(one.share, one) for one in press.hypotheses]
        self._pasts.carry(weighed, press.intake.deepest)

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        estimate = None
        if self.press is not None:
            estimate = estimate_of(self.press, self._mismatch_probability)
        if estimate is None:
            estimate = prior_estimate(self._best.setting, self._best.shift)
        return estimate._replace(sample_count=self._best.sample_count)
