# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posteriors at every scale of the model's error, weighed by their evidence.

All take the same blocks; the first one's law has no error. The bank has the moments of the
mixture: where the data are those of the law, the exact posterior has all the weight and nothing is
lost; where they are not, the deviations say so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.edge import EDGE_SHARE
from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.posterior import Prediction, StressPosterior
from fden_ros.core.estimation.stress_observation import Observation
from fden_ros.core.estimation.unmodelled import model_error_variance
from fden_ros.core.law.interpolation import LogStiffnessGrid

#: Scales of the model's error in the bank, as multiples of what `Uncertainty` states [1].
_SCALES = (0.0, 1.0)
#: Weight [1] below which a scale is solved for only where _RARELY blocks wait.
_LEAST_WEIGHT = 1e-4
#: Blocks [1], and share of all blocks so far [1], after which a scale of less weight than that is
#: solved for all the same: early on its solution may be the wrong maximum. With at most 0.4 s of
#: blocks two presses of beef at 10 Hz end in such a one, 39 deviations off.
_RARELY, _RARELY_SHARE = 40, 0.5


class PosteriorBank:
    """The mixture of the posteriors of one tissue.

    Parameters
    ----------
    config : EstimatorConfig
    grid : LogStiffnessGrid
        Nodes of ln Gn.
    origins : ndarray, shape (m,)
        Nodes of the strain origin [1].
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    rig : tuple of ndarray, shape (2,), (2, 2)
        Mean and covariance of delay and friction before the first contact, in their stated
        deviations.

    Attributes
    ----------
    members : list of StressPosterior
        From the smallest scale to the largest.
    weights : ndarray, shape (scales,)
        Their shares in the mixture [1].
    best : StressPosterior
        The one of the largest weight.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        grid: LogStiffnessGrid,
        origins: Array,
        noise_sd: float,
        origin_sd: float,
        rig: tuple[Array, Array],
    ) -> None:
        scales = _at_scales(config)
        self.members = [
            StressPosterior(
                scaled, grid, origins, noise_sd, origin_sd, rig, regards_jitter=len(scales) > 1
            )
            for scaled in scales
        ]
        self.weights: Array = np.full(len(self.members), 1.0 / len(self.members))
        self.best = self.members[-1]
        self._block_count = 0

    @property
    def is_exact(self) -> bool:
        """Whether the law is said to be exact."""
        return len(self.members) == 1

    # Blocks

    def begin_contact(self, bias_sd: float, drift_sd: float, shift_sd: float) -> None:
        """Start a contact, as each posterior does."""
        for posterior in self.members:
            posterior.begin_contact(bias_sd, drift_sd, shift_sd)

    def predict(
        self, seen: Observation, block: Block, stress: float, late_delay: float
    ) -> list[Prediction]:
        """Return the prediction of every posterior for a block.

        Parameters
        ----------
        seen : Observation
        block : Block
        stress : float
            Of which the law's error is a share [Pa].
        late_delay : float
            What the column of the delay lacks of the newest block taken, at G = 1 [1].
        """
        predictions = []
        for posterior in self.members:
            posterior.amend_newest(seen.noise_before, late_delay)
            model_error = model_error_variance(posterior.uncertainty, stress, seen.growth)
            variance = model_error + seen.rig_error
            predictions.append(
                posterior.predict(seen.law, seen.free, seen.linear, block, variance)
            )
        return predictions

    def best_of(self, predictions: Sequence[Prediction]) -> Prediction:
        """Return the prediction of the best posterior."""
        return predictions[self.members.index(self.best)]

    def add(
        self, predictions: Sequence[Prediction], noise: float, size: int, *, updates: bool
    ) -> None:
        """Take a block; `updates`: the states take it up at once."""
        for posterior, prediction in zip(self.members, predictions, strict=True):
            posterior.add(prediction, noise, size)
            if posterior.is_unimodal and updates:
                posterior.update(prediction, noise)
        self._block_count += 1

    def start_anew(self, predicted_fractional_stress: float) -> None:
        """Learn a new tissue from here on, all from the best posterior [Pa s^alpha]."""
        for posterior in self.members:
            if posterior is not self.best:
                posterior.state = self.best.state.copy()
                posterior.covariance = self.best.covariance.copy()
            posterior.start_anew(predicted_fractional_stress)
        self.weights.fill(1.0 / len(self.members))
        self._block_count = 0

    # Solution

    def relinearise(self, *, fully: bool) -> Iterator[None]:
        """Solve for the scales that are due, or `fully`: that have new blocks, step by step."""
        solved = False
        for posterior, weight in zip(self.members, self.weights, strict=True):
            if posterior.work_ahead():
                yield
            waiting = posterior.blocks_since_solved
            rarely = min(_RARELY, _RARELY_SHARE * self._block_count)
            if weight < _LEAST_WEIGHT and not fully and waiting < rarely:
                continue
            if posterior.is_due() or (fully and waiting):
                yield from posterior.relinearise()
                solved = True
                yield
        if solved:
            self._weigh()

    def _weigh(self) -> None:
        evidence = np.array([posterior.log_evidence for posterior in self.members])
        weights = np.exp(evidence - evidence.max())
        self.weights = weights / weights.sum()
        self.best = self.members[int(np.argmax(self.weights))]

    # Result

    def moments(self) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) of the mixture's state."""
        return self._mixed([(posterior.state, posterior.covariance) for posterior in self.members])

    def rig(self) -> tuple[Array, Array] | None:
        """Return mean (2,) and covariance (2, 2) of delay and friction, in stated deviations.

        None where a scale that counts has no solution, or none that is normal.
        """
        for posterior, weight in zip(self.members, self.weights, strict=True):
            if weight >= _LEAST_WEIGHT and not (posterior.is_solved and posterior.is_unimodal):
                return None
        mean, covariance = self._mixed([posterior.rig() for posterior in self.members])
        return mean, 0.5 * (covariance + covariance.T)

    def _mixed(self, moments: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Return mean and covariance of the mixture from those of its members."""
        means = np.array([mean for mean, _ in moments])
        mean: Array = self.weights @ means
        centred = means - mean
        covariance: Array = (self.weights[:, None] * centred).T @ centred
        for weight, (_, own) in zip(self.weights, moments, strict=True):
            covariance += weight * own
        return mean, covariance

    def at_edge(self) -> ParameterSet:
        """Return the parameters at an end of what can be represented, at a scale that counts."""
        found = ParameterSet.NONE
        for weight, posterior in zip(self.weights, self.members, strict=True):
            if weight >= EDGE_SHARE:
                found |= posterior.at_edge()
        return found

    @property
    def model_error(self) -> float:
        """The scale of the model's error, averaged by the evidence [1]."""
        errors = [posterior.uncertainty.characteristic_sd for posterior in self.members]
        return math.sqrt(float(self.weights @ np.square(errors)))

    def probability_beyond_boundary(self, strain: float) -> float:
        """Return P(strain > 1/Gn) [1]; 0 where the strain is not positive."""
        if strain <= 0.0:
            return 0.0
        beyond = np.array(
            [posterior.probability_beyond_boundary(strain) for posterior in self.members]
        )
        return min(float(self.weights @ beyond), 1.0)


def _at_scales(config: EstimatorConfig) -> list[EstimatorConfig]:
    """Return the configuration at every scale of the model's error."""
    stated = config.uncertainty
    if not (stated.kernel_sd or stated.characteristic_sd):
        return [config]
    return [
        replace(
            config,
            uncertainty=replace(
                stated,
                kernel_sd=scale * stated.kernel_sd,
                characteristic_sd=scale * stated.characteristic_sd,
            ),
        )
        for scale in _SCALES
    ]
