# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A touch of which nothing says whether it is where the last one was.

Both are followed, each by an estimator: the tissue pressed before, which still recovers, and
tissue at rest. With the log evidence :math:`l_k` of each its probability is

.. math:: P_k = e^{l_k} / \sum_j e^{l_j},

the estimate has the moments of the mixture, and what is claimed is what both claim. One that the
data have ruled out is no longer followed.

The tissue of another place may be anything, or as that of the last: with a prior as wide as all
tissue alone, the last place was too likely wherever an organ is pressed at several. Each has a
prior of one half. With the likelihood :math:`e^{s^T\theta - \theta^T \Lambda \theta / 2}` of the
press the evidence under a prior :math:`N(m, C)` is

.. math:: |1 + C\Lambda|^{-1/2}\; e^{(s + C^{-1} m)^T (\Lambda + C^{-1})^{-1} (s + C^{-1} m) / 2
    - m^T C^{-1} m / 2}.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.claims import converged
from fden_ros.core.estimation.estimate import Estimate, Member, mixture, positive
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.posterior_estimator import PosteriorEstimator
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.solution import NEGLIGIBLE

#: Probability of a place below which its claims are not asked for [1].
_LEAST_WEIGHT = 0.01
#: How far alike tissue is from that of the last place: standard deviations of ln G, ln Gn and
#: alpha [1], by which simulated touches were told apart best.
_ALIKE: Array = np.array([0.3, 0.15, 0.04])


class Tissue(NamedTuple):
    """A belief in (ln G, ln Gn, alpha)."""

    mean: Array  #: shape (3,)
    covariance: Array  #: shape (3, 3)


class Placed(NamedTuple):
    """An estimator, and what it brings along."""

    estimator: PosteriorEstimator
    shift: float = 0.0  #: by which its compressions are larger than those it is given [1]
    changes: int = 0  #: of the tissue, found before
    last: Tissue | None = None  #: of another place, which this one's may be like; None: it is that
    #: Logarithm of how much wider the origin's prior is than where the touch showed the surface:
    #: that noise may hide it there makes this no less likely.
    wider: float = 0.0

    @property
    def press(self) -> PressPosterior:
        """The present press."""
        assert self.estimator.press is not None
        return self.estimator.press

    def log_evidence(self, config: EstimatorConfig) -> float:
        """Return the log evidence of the present press."""
        found = self.press.log_evidence
        if self.last is None or not math.isfinite(found):
            return found
        estimate = self.estimator.estimate()
        prior = Tissue(config.prior.mean, np.diag(config.prior.deviations**2))
        alike = self.last._replace(covariance=self.last.covariance + np.diag(_ALIKE**2))
        told = Tissue(estimate.mean, estimate.covariance)
        gain = log_ratio(prior, alike, told, learns_order=not config.is_order_given)
        return found + self.wider + float(np.logaddexp(0.0, gain)) - math.log(2.0)

    def estimate(self) -> Estimate:
        """Return its estimate, the origin in the compressions that it is given."""
        found = self.estimator.estimate()
        motions = tuple(replace(motion, shift=self.shift) for motion in found.small_motions)
        origin = found.strain_origin - self.shift
        return found._replace(strain_origin=origin, small_motions=motions)


def log_ratio(prior: Tissue, other: Tissue, told: Tissue, *, learns_order: bool) -> float:
    """Return the log evidence under another prior over that under the prior of a posterior.

    Parameters
    ----------
    prior, other : Tissue
    told : Tissue
        The posterior with the first.
    learns_order : bool
        alpha is an unknown.
    """
    learned = slice(0, 3 if learns_order else 2)

    def natural(tissue: Tissue) -> tuple[Array, Array]:
        covariance = tissue.covariance[learned, learned]
        precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return precision, precision @ tissue.mean[learned]

    (before, pull_before), (after, pull_after) = natural(prior), natural(told)
    # What the press itself tells, which is never less than nothing.
    likelihood = positive(after - before)

    def log_evidence(tissue: Tissue) -> float:
        precision, pull = natural(tissue)
        both, pulled = likelihood + precision, pull_after - pull_before + pull
        volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(both)[1]
        square = pulled @ np.linalg.solve(both, pulled) - pull @ tissue.mean[learned]
        return 0.5 * float(volume + square)

    return log_evidence(other) - log_evidence(prior)


class EitherPlace(Estimator):
    """Follows a touch of the same place or of another.

    Parameters
    ----------
    config : EstimatorConfig
    places : sequence of Placed
        Estimators that have not been touched since.
    """

    def __init__(self, config: EstimatorConfig, *places: Placed) -> None:
        self._config, self._places = config, list(places)
        self._weights: Array = np.full(len(places), 1.0 / len(places))
        self._changes = 0

    @property
    def best(self) -> Placed:
        """The likeliest place."""
        return self._places[int(np.argmax(self._weights))]

    @property
    def likeliest(self) -> PosteriorEstimator:
        """The estimator of the likeliest place."""
        return self.best.estimator

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law."""
        return self.likeliest.is_mismatch

    @property
    def is_doubtful(self) -> bool:
        """Whether either does not explain the newest data."""
        return any(place.estimator.is_doubtful for place in self._places)

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found, when places were last weighed.

        What one place takes for a change another may explain without it.
        """
        return self._changes if len(self._places) > 1 else self._newest_changes()

    def _newest_changes(self) -> int:
        return self.likeliest.change_count - self.best.changes

    def begin_contact(self, bias_sd: float, drift_sd: float, way: Array | None = None) -> None:
        """Start a press whose stress has a zero [Pa] and a drift [Pa/s] of its own."""
        for place in self._places:
            place.estimator.work_share = 1.0 / len(self._places)
            own = None if way is None else way + np.array([[0.0], [place.shift], [0.0]])
            place.estimator.begin_contact(bias_sd, drift_sd, own)

    def take(self, step: float, compression: float, stress: float, *, is_free: bool) -> None:
        """Take a sample of a contact, `step` seconds after the last."""
        for place in self._places:
            place.estimator.take(step, compression + place.shift, stress, is_free=is_free)

    def rest(self, duration: float) -> None:
        """Let time [s] pass between two contacts."""
        for place in self._places:
            place.estimator.rest(duration)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        for place in self._places:
            place.estimator.skip()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the likeliest prediction."""
        likeliest, found = int(np.argmax(self._weights)), []
        before = self._solved_at()
        is_solving = any(place.press.is_solving for place in self._places)
        for place in self._places:
            shifted = block._replace(
                compression=block.compression + place.shift,
                # They are weighed by the same record: no solution begins before all have ended.
                is_past=block.is_past or is_solving,
            )
            found.append(place.estimator.update(shifted))
        newest = max(place.press.begun_at for place in self._places)
        for place in self._places:
            if place.press.begun_at < newest and not place.press.is_solving:
                place.press.begin_solution()
        after = self._solved_at()
        if after != before and len(after) == 1:
            self._weigh()
        return found[likeliest]

    def begin_finish(self) -> None:
        """Begin to solve anew at the end of a contact, from all starts."""
        for place in self._places:
            place.estimator.begin_finish()

    @property
    def is_working(self) -> bool:
        """Whether that is under way."""
        return any(place.estimator.is_working for place in self._places)

    def work(self, seconds: float) -> None:
        """Go on with that by the work of a time without samples [s]."""
        for place in self._places:
            place.estimator.work(seconds)

    def finish(self) -> None:
        """Do what is left of what `begin_finish` has begun."""
        for place in self._places:
            place.estimator.finish()
        self._weigh()

    def _solved_at(self) -> set[int]:
        """Return the blocks in the records of the newest solutions."""
        return {place.press.solved_at for place in self._places}

    def _weigh(self) -> None:
        """Weigh the places by their evidence, and drop what is ruled out."""
        if len(self._places) == 1:
            return
        evidence = np.array([place.log_evidence(self._config) for place in self._places])
        if not np.isfinite(evidence).any():
            return
        kept = np.flatnonzero(evidence > evidence.max() - NEGLIGIBLE)
        self._places = [self._places[k] for k in kept]
        for place in self._places:
            place.estimator.work_share = 1.0 / len(self._places)
        self._weights = softmax(evidence[kept])
        self._changes = self._newest_changes()

    def estimate(self) -> Estimate:
        """Return the present estimate: the mixture's moments, and what all claim."""
        estimates = [place.estimate() for place in self._places]
        if len(estimates) == 1:
            return estimates[0]

        def mixed(of: Callable[[Estimate], float]) -> float:
            return float(self._weights @ [of(e) for e in estimates])

        best = estimates[int(np.argmax(self._weights))]
        weighed = zip(self._weights.tolist(), estimates, strict=True)
        mean, covariance = mixture([Member(w, e.mean, e.covariance) for w, e in weighed])
        origin = mixed(lambda e: e.strain_origin)
        spread = mixed(lambda e: e.strain_origin_sd**2 + (e.strain_origin - origin) ** 2)
        valid, known = best.valid, best.known
        for weight, estimate in zip(self._weights, estimates, strict=True):
            if weight < _LEAST_WEIGHT:
                continue
            valid, known = valid & estimate.valid, known & estimate.known
        deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        return best._replace(
            log_linear_stiffness=float(mean[0]),
            log_nonlinear_stiffness=float(mean[1]),
            fractional_order=float(mean[2]),
            covariance=covariance,
            strain_origin=origin,
            strain_origin_sd=math.sqrt(spread),
            probability_beyond_boundary=mixed(lambda e: e.probability_beyond_boundary),
            valid=valid,
            known=known & converged(self._config, deviations, valid),
            small_motions=tuple(
                replace(motion, weight=weight)
                for weight, estimate in zip(self._weights.tolist(), estimates, strict=True)
                for motion in estimate.small_motions
            ),
        )
