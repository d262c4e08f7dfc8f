# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Recursive estimation on the stress itself, averaged over the scale of the model's error.

No tissue is exactly FDEN. The motion of a block becomes responses
(:mod:`fden_ros.core.estimation.stress_observation`) that a bank of posteriors takes, each with its
own scale of the law's error (:mod:`fden_ros.core.estimation.posterior_bank`). What none of them
foresaw may be a change of the tissue (:mod:`fden_ros.core.estimation.tissue_change`); how far the
tissue is from the law is watched beside them (:mod:`fden_ros.core.estimation.law_watch`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Estimate, StateIndex
from fden_ros.core.estimation.estimator import Block, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Prior
from fden_ros.core.estimation.innovation_monitor import CHANGE_DEVIATIONS
from fden_ros.core.estimation.law_watch import LawWatch
from fden_ros.core.estimation.mixture_estimate import mixture_estimate
from fden_ros.core.estimation.posterior import Prediction
from fden_ros.core.estimation.posterior_bank import PosteriorBank
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.stress_observation import Observation, StressObservation
from fden_ros.core.estimation.surface_shift import SurfaceShift
from fden_ros.core.estimation.surprise import is_surprise
from fden_ros.core.estimation.tissue_change import Change, Knowledge, TissueChange
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.interpolation import LogStiffnessGrid
from fden_ros.core.streams.samples import PathNoise

_ORIGIN = StateIndex.STRAIN_ORIGIN

#: Half the range of the nodes of ln Gn: in prior standard deviations [1], and at most [1]. Beyond
#: four deviations lie 6e-5 of the prior; a factor of e^2 either way holds all tissue.
_GRID_DEVIATIONS, _WIDEST_GRID = 4.0, 2.0
#: Distance of the outer nodes of the strain origin from 0: in its standard deviations [1], and at
#: least [1]: nodes too close would make the parabola through them ill-conditioned.
_ORIGIN_REACH, _LEAST_ORIGIN_REACH = 2.0, 0.003
_NOISELESS = PathNoise()


class StressEstimator:
    """The estimator of one site.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    path_noise : PathNoise
        Of the compression [1].
    rig : RigKnowledge, optional
        What earlier contacts have told; without it what the configuration states.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
        path_noise: PathNoise = _NOISELESS,
        rig: RigKnowledge | None = None,
    ) -> None:
        self._known_rig = rig = rig or RigKnowledge.stated(config)
        self._stated_config = config
        stated = config.uncertainty
        config = replace(config, uncertainty=rig.learned(stated))
        self._config = config
        self._geometry = geometry
        grid = _log_gn_nodes(config.prior)
        origins = _origin_nodes(origin_sd, grid)
        self._observation = StressObservation(
            config.uncertainty, geometry, grid, origins, noise_sd, path_noise
        )
        self._bank = PosteriorBank(config, grid, origins, noise_sd, origin_sd, rig.scaled(stated))
        self._prior_covariance = self._bank.best.covariance.copy()
        self._surface = SurfaceShift(config.uncertainty.surface_motion_sd / geometry.length)
        self._has_newest = False  # the last block of this contact was taken
        self._steady_stress = 0.0  # magnitude at the last block that was no surprise [Pa]
        self._max_compression = 0.0
        self._sample_count = 0
        self._change = TissueChange()
        self._law = LawWatch(geometry, config.prior, stated, noise_sd, origin_sd)
        #: What is left to do between two blocks, and whether it has begun.
        self._work: Iterator[None] = iter(())
        self._is_at_work = False

    @property
    def is_doubtful(self) -> bool:
        """Whether a surprise of late is not explained, or a solution not found."""
        return self._change.is_doubtful or not self._bank.best.is_solved

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law.

        A law that is said to be exact: the innovations; else its deviation is a threshold's.
        """
        if self._bank.is_exact:
            return self._change.is_mismatch
        deviation = self._law.deviation
        return deviation is not None and deviation.is_mismatch

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return self._change.count

    # Samples

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a contact with its own bias [Pa] and drift [Pa/s] of the stress."""
        self._finish_work()
        self._change.begin_contact()
        self._law.begin_contact()
        self._has_newest = False
        self._steady_stress = 0.0
        shift_sd = self._surface.begin_contact(self._bank.best)
        self._bank.begin_contact(bias_sd, drift_sd, shift_sd)
        self._observation.begin_contact()

    def press(self, step: float, compression: float, surface: float = 0.0) -> None:
        """Take the motion of a sample in contact, from which `surface` was taken off [1]."""
        self._surface.wait(step)
        self._observation.press(step, compression - self._surface.shifted, surface)

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air."""
        self._surface.wait(sum(steps))
        self._observation.rest(steps, free_responses)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._finish_work()
        self._observation.skip()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        self._finish_work()
        block = block._replace(compression=block.compression - self._surface.shifted)
        seen = self._observation.take_block(block, self._bank.best)
        predictions = self._predict(block, seen)
        best = self._bank.best_of(predictions)
        innovation = Innovation(
            predicted_fractional_stress=seen.fractional_stress,
            predicted_stress=block.stress + best.residual,
            innovation=-best.residual,
            variance=seen.noise + best.spread,
        )
        known = self._knowledge(seen.noise, best, predictions)
        change = self._change.watch(block, innovation, known)
        if change is not None:
            self._start_anew(change, innovation, block)
        if not self._change.is_suspected:
            self._steady_stress = abs(block.stress)
        self._has_newest = not self._change.is_blind(block.memory_time)
        if self._has_newest:
            self._take(block, seen.noise, predictions)
        return innovation

    def _predict(self, block: Block, seen: Observation) -> list[Prediction]:
        """Return every posterior's prediction."""
        # A jump is none of the law's error: what it adds to the stress would excuse it.
        highest = self._steady_stress * math.exp(seen.growth.loading)
        stress = min(abs(block.stress), highest + CHANGE_DEVIATIONS * math.sqrt(seen.noise))
        late = seen.late_delay if self._has_newest else 0.0
        predictions = self._bank.predict(seen, block, stress, late)
        total = seen.noise + sum(p.residual + p.spread for p in predictions)
        if not (seen.noise > 0.0 and math.isfinite(total)):
            raise FloatingPointError(
                f"the response to a compression of {block.compression:g} and a stress of "
                f"{block.stress:g} Pa is not finite"
            )
        return predictions

    def _knowledge(
        self, noise: float, best: Prediction, predictions: list[Prediction]
    ) -> Knowledge:
        """Return what is known while a block is compared with its predictions."""
        posterior = self._bank.best
        return Knowledge(
            noise=noise + posterior.walk_share(best),
            state=posterior.state,
            is_unimodal=posterior.is_unimodal,
            is_fresh=posterior.is_unimodal or posterior.blocks_since_solved == 0,
            is_exact=self._bank.is_exact,
            is_surprise=is_surprise(
                self._bank,
                predictions,
                noise,
                self._config.prior.linear_stiffness_log_sd,
                is_first=not self._change.is_suspected,
            ),
        )

    def _take(self, block: Block, noise: float, predictions: list[Prediction]) -> None:
        """Learn from a block."""
        # A state that takes up surprises would hide the change that they may be.
        updates = not self._change.is_suspected
        self._bank.add(predictions, noise, block.size, updates=updates)
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        self._observation.follow(block.stress)
        if not self._bank.is_exact:
            self._law.add(block, self._observation.loading_age, self._tissue)

    @property
    def _tissue(self) -> Array:
        """State of the tissue at the best scale: ln G, ln Gn, alpha and origin, shape (4,)."""
        return self._bank.best.state[: _ORIGIN + 1]

    def _start_anew(self, change: Change, innovation: Innovation, block: Block) -> None:
        """Learn a new tissue from here on; the response to the old one is kept as it was."""
        best = self._bank.best
        if change.state is not None:
            best.state = change.state
        late = block.memory_time + 0.5 * block.duration - change.time
        self._observation.freeze(best, late)
        self._bank.start_anew(innovation.predicted_fractional_stress)
        self._max_compression = -math.inf
        self._law.stop()

    # Between two blocks

    def work_ahead(self, steps: int, *, begins: bool) -> None:
        """Do some steps of what is to be done before the next block, while nobody waits for it.

        That is a solution with all blocks so far, where one is due. The next block finishes what
        has begun, so that the same comes of it however many steps are done before.
        """
        if begins and not self._is_at_work:
            self._work, self._is_at_work = self._relinearising(), True
        for _ in itertools.islice(self._work, steps):
            pass

    def _finish_work(self) -> None:
        for _ in self._work:
            pass
        self._work, self._is_at_work = iter(()), False

    def __getstate__(self) -> dict[str, object]:
        """Return the state for a copy: what is under way is done first, as a block would."""
        self._finish_work()
        return self.__dict__

    def relinearise(self, *, fully: bool = False) -> None:
        """Do all that at once; `fully`: solve also where it is not due, and fit the law."""
        self._finish_work()
        for _ in self._relinearising(fully=fully):
            pass

    def _relinearising(self, *, fully: bool = False) -> Iterator[None]:
        """Do what nobody waits for, step by step."""
        if not fully:
            self._law.work_ahead()
            yield
        if self._change.is_suspected:
            return
        yield from self._bank.relinearise(fully=fully)
        if fully and not self._bank.is_exact:
            self._law.finish(self._tissue)

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate: mean and covariance of the mixture."""
        mean, covariance = self._bank.moments()
        if self._bank.is_exact:
            # The law is said to be exact: where it is not, nothing accounts for it but this.
            covariance *= self._change.inflation
            if self.is_mismatch:
                covariance += self._prior_covariance
        return mixture_estimate(
            self._config,
            self._bank,
            (mean, covariance),
            self._largest_strain(float(mean[_ORIGIN])),
            self._surface,
            self._law.deviation,
            sample_count=self._sample_count,
            loading_age=self._observation.loading_age,
        )

    def _largest_strain(self, origin: float) -> float:
        """Return the largest strain so far; 0 where the origin was never reached [1]."""
        compression = self._max_compression - origin
        return self._geometry.strain(compression) if compression > 0.0 else 0.0

    def motion_evidence(self) -> list[float] | None:
        """Return the evidence for shares of the stated motion; None where it tells nothing."""
        if self._bank.is_exact or self._stated_config.uncertainty.surface_motion_sd == 0.0:
            return None
        stated = self._stated_config.uncertainty
        learned = replace(stated, force_drift_sd=self._config.uncertainty.force_drift_sd)
        return self._law.motion_evidence(self._tissue, learned)

    @property
    def rig_deviations(self) -> float:
        """How far a contact that went in and out says the rig is from what is stated [1]."""
        best = self._bank.best
        told = self._observation.has_reversed and best.is_solved
        return best.rig_deviations() if told else 0.0

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after a contact; None where it tells nothing.

        That is where nothing is open, the loading never reversed, the tissue changed, or a
        solution was not found.
        """
        is_open = any(self._config.uncertainty.rig_sd)
        if not (is_open and self._observation.has_reversed) or self._change.count:
            return None
        moments = self._bank.rig()
        if moments is None:
            return None
        return self._known_rig.taught(*moments, self._stated_config)


def _log_gn_nodes(prior: Prior) -> LogStiffnessGrid:
    return LogStiffnessGrid(
        math.log(prior.nonlinear_stiffness),
        min(_GRID_DEVIATIONS * prior.nonlinear_stiffness_log_sd, _WIDEST_GRID),
    )


def _origin_nodes(origin_sd: float, grid: LogStiffnessGrid) -> Array:
    """Return the nodes of the strain origin [1], shape (3,), or (1,) where it is known."""
    if origin_sd <= 0.0:
        return np.zeros(1)
    reach = min(max(_ORIGIN_REACH * origin_sd, _LEAST_ORIGIN_REACH), grid.widest_origin)
    return np.linspace(-reach, reach, 3)
