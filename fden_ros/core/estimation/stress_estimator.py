# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

r"""Recursive estimation on the stress itself, averaged over the scale of the model's error.

No tissue is exactly FDEN. A bank of posteriors (:mod:`fden_ros.core.estimation.posterior`), each
with its own scale of the error of kernel and characteristic, takes the same blocks; the first one
has none. They are weighed by their evidence, and the estimate has the moments of the mixture:
where the data are those of the law, the exact posterior has all the weight and nothing is lost;
where they are not, the deviations say so.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.edge import EDGE_SHARE
from fden_ros.core.estimation.estimate import (
    Estimate,
    ParameterSet,
    StateIndex,
    converged,
    determined,
)
from fden_ros.core.estimation.estimator import Block, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.innovation_monitor import CHANGE_DEVIATIONS
from fden_ros.core.estimation.law_watch import LawWatch
from fden_ros.core.estimation.motion_jitter import MotionJitter
from fden_ros.core.estimation.motion_noise import MotionNoise
from fden_ros.core.estimation.normal_equations import BlockResponse
from fden_ros.core.estimation.posterior import Prediction, StressPosterior
from fden_ros.core.estimation.rig import RigResponse
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.tissue_change import Change, Knowledge, TissueChange
from fden_ros.core.estimation.unmodelled import (
    SURFACE_TIME,
    LoadingAge,
    model_error_variance,
    rig_error_variance,
)
from fden_ros.core.law.characteristic import (
    ElasticResponse,
    apparent_stiffness_factor,
    elastic_response,
)
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.interpolation import Lagrange, LogStiffnessGrid
from fden_ros.core.law.kernel import order_interpolation
from fden_ros.core.law.stress_response import StressBasis
from fden_ros.core.streams.samples import PathNoise

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
_SHIFT = StateIndex.SHIFT

#: Half the range of the nodes of ln Gn: in prior standard deviations [1], and at most [1]. Beyond
#: four deviations lie 6e-5 of the prior; a factor of e^2 either way holds all tissue.
_GRID_DEVIATIONS, _WIDEST_GRID = 4.0, 2.0
#: Distance of the outer nodes of the strain origin from 0: in its standard deviations [1], and at
#: least [1]: nodes too close would make the parabola through them ill-conditioned.
_ORIGIN_REACH, _LEAST_ORIGIN_REACH = 2.0, 0.003
#: Scales of the model's error in the bank, as multiples of what `Uncertainty` states [1].
_SCALES = (0.0, 1.0)
#: Least duration of a block for which the tissue yields to a bending tool [s]: that of one sample.
_SHORTEST_BLOCK = 0.002
#: Weight [1] below which a scale is solved for only where _RARELY blocks wait.
_LEAST_WEIGHT = 1e-4
#: Blocks [1], and share of all blocks so far [1], after which a scale of less weight than that is
#: solved for all the same: early on its solution may be the wrong maximum. With at most 0.4 s of
#: blocks two presses of beef at 10 Hz end in such a one, 39 deviations off.
_RARELY, _RARELY_SHARE = 40, 0.5
#: Share of the prior's deviation of ln G [1] below which the data have said something, and
#: deviation of ln G [1] above which the stress is not normal about its prediction.
_KNOWN_SHARE, _KNOWN_LOG_SD = 0.5, 0.5
#: A scale's likelihood ratio against it, -2 ln of its weight [1], counts up to this [1]: it has to
#: be surprised by three deviations all the same, because tissue may begin to leave the law.
_MOST_AGAINST, _TINY_WEIGHT = 27.0, 1e-12
#: A surprise that follows one has to be one by this share of the squared deviations [1], four of
#: them: it has only to show that the first was no outlier. Not where the law is said to be exact:
#: a noise three times as large as stated would be a change instead of a mismatch.
_FOLLOWING = 4.0 / 9.0
_NOISELESS = PathNoise()
#: Alpha is not known where it is farther than this from that of the law's fit, in deviations of
#: both [1]: on 78 presses of beef the ones kept are then 1.4 of their deviations off the order of
#: their holds, the others 5.2; with 2 they are 1.9.
_SAME_ORDER = 1.5
#: Time for which the surface goes on moving away from where it was [s]: one breath.
_LONGEST_SHIFT = 4.0


class StressEstimator:
    """The bank of posteriors on the stress.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    path_noise : PathNoise
        Of the compression [s].
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
        motion = rig.motion_share * stated.surface_motion_sd
        config = replace(config, uncertainty=replace(stated, surface_motion_sd=motion))
        prior = config.prior
        self._config = config
        self._geometry = geometry
        self._noise_variance = noise_sd**2
        self._motion = MotionNoise(path_noise.total)
        self._jitter = MotionJitter(path_noise.displacement)
        # The surface moves slower than the probe, and its noise is told apart by itself: where the
        # probe turns, a line through both would take the turn for noise.
        self._surface_jitter = MotionJitter(path_noise.surface)
        grid = self._grid = LogStiffnessGrid(
            math.log(prior.nonlinear_stiffness),
            min(_GRID_DEVIATIONS * prior.nonlinear_stiffness_log_sd, _WIDEST_GRID),
        )
        reach = max(_ORIGIN_REACH * origin_sd, _LEAST_ORIGIN_REACH)
        origins: Array = np.linspace(-reach, reach, 3) if origin_sd > 0.0 else np.zeros(1)
        self._in_origin = Lagrange(origins)
        self._in_order = order_interpolation()
        self._basis = StressBasis(geometry, grid.nodes, origins)
        known = rig.scaled(stated)
        scales = _at_scales(config)
        self._bank = [
            StressPosterior(
                scaled, grid, origins, noise_sd, origin_sd, known, regards_jitter=len(scales) > 1
            )
            for scaled in scales
        ]
        self._weights = np.full(len(self._bank), 1.0 / len(self._bank))
        self._block_count = 0
        self._best = self._bank[-1]
        self._prior_covariance = self._best.covariance.copy()
        self._age = LoadingAge()
        self._rig = RigResponse(config.uncertainty, geometry, path_noise.total)
        self._last_response: BlockResponse | None = None
        self._step = 0.0  # of the law's stress up to the newest block [Pa]
        self._has_newest = False  # the last block of this contact was taken
        self._steady_stress = 0.0  # magnitude at the last block that was no surprise [Pa]
        self._max_compression = 0.0
        self._sample_count = 0
        self._contact_start: float | None = None
        self._elapsed = 0.0  # since the last contact began [s]
        # The surface's way in a second, as compression [1].
        self._way = config.uncertainty.surface_motion_sd / geometry.length
        self._surface = 0.0  # how far the surface has shifted by then, as compression [1]
        self._change = TissueChange()
        self._law = LawWatch(geometry, prior, stated, noise_sd, origin_sd)
        #: What is left to do between two blocks, and whether it has begun.
        self._work: Iterator[None] = iter(())
        self._is_at_work = False

    @property
    def is_doubtful(self) -> bool:
        """Whether a surprise of late is not explained, or a solution not found."""
        return self._change.is_doubtful or not self._best.is_solved

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law.

        A law that is said to be exact: the innovations; else its deviation is a threshold's.
        """
        if self._is_exact:
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
        self._motion.interrupt()
        self._interrupt_jitter()
        self._change.begin_contact()
        self._law.begin_contact()
        self._age.interrupt()
        self._rig.begin_contact()
        self._last_response = None
        self._has_newest = False
        self._contact_start = None
        self._steady_stress = 0.0
        shift_sd = self._follow_surface()
        for posterior in self._bank:
            posterior.begin_contact(bias_sd, drift_sd, shift_sd)
        self._basis.begin_contact()

    def _follow_surface(self) -> float:
        """Begin where the surface was in the last contact; return how far it may have moved since.

        In its way in a second; so the shift that is left is small, and its column linear.
        """
        if self._way == 0.0:
            return 0.0
        self._surface += self._way * float(self._best.state[_SHIFT])
        elapsed, self._elapsed = self._elapsed, 0.0
        known = float(self._best.covariance[_SHIFT, _SHIFT])
        return math.sqrt(min(elapsed, _LONGEST_SHIFT) + known)

    def press(self, step: float, compression: float, surface: float = 0.0) -> None:
        """Take the motion of a sample in contact, from which `surface` was taken off [1]."""
        self._elapsed += step
        compression -= self._surface
        self._motion.press(step, compression)
        jitter = self._jitter.press(step, compression + surface)
        jitter -= self._surface_jitter.press(step, surface)
        self._basis.press(step, compression, jitter)

    def _interrupt_jitter(self) -> None:
        self._jitter.interrupt()
        self._surface_jitter.interrupt()

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air."""
        self._motion.interrupt()
        self._interrupt_jitter()
        self._elapsed += sum(steps)
        self._basis.rest(steps, free_responses)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._finish_work()
        self._motion.skip_block()
        self._basis.discard_block()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        self._finish_work()
        block = block._replace(compression=block.compression - self._surface)
        elastic, noise, predictions = self._predict(block)
        best = predictions[self._bank.index(self._best)]
        innovation = Innovation(
            predicted_fractional_stress=elastic,
            predicted_stress=block.stress + best.residual,
            innovation=-best.residual,
            variance=noise + best.spread,
        )
        known = self._knowledge(noise, best, predictions)
        change = self._change.watch(block, innovation, known)
        if change is not None:
            self._start_anew(change, innovation, block)
        if not self._change.is_suspected:
            self._steady_stress = abs(block.stress)
        self._has_newest = not self._change.is_blind(block.memory_time)
        if self._has_newest:
            self._take(block, noise, predictions)
        return innovation

    def _predict(self, block: Block) -> tuple[float, float, list[Prediction]]:
        """Return the elastic response [Pa s^alpha], the block's noise and every prediction.

        The noise is the variance of the block's mean stress [Pa^2].
        """
        state = self._best.state
        elastic, relaxed = self._elastic(block, state)
        slope = elastic.by_strain * self._geometry.strain_slope(block.compression - state[_ORIGIN])
        response = self._respond(block, state, slope / math.exp(state[_LOG_G]))
        growth = self._age.grow(block.duration, elastic.value / math.exp(state[_LOG_G]))
        noise, before = self._motion.take_block(
            block.duration, block.size, slope, float(state[_ORDER])
        )
        turn = self._rig.turn_variance
        noise += self._noise_variance / block.size + turn
        before += turn * block.size**2
        late = self._rig.late_delay if self._has_newest else 0.0
        stiffness = max(slope, 0.0) * relaxed / self._geometry.length
        rig_error = rig_error_variance(
            self._config.uncertainty, self._geometry, block.duration, stiffness
        )
        # A jump is none of the law's error: what it adds to the stress would excuse it.
        highest = self._steady_stress * math.exp(growth.loading)
        stress = min(abs(block.stress), highest + CHANGE_DEVIATIONS * math.sqrt(noise))
        predictions = []
        for posterior in self._bank:
            posterior.amend_newest(before, late)
            model_error = model_error_variance(posterior.uncertainty, stress, growth)
            predictions.append(posterior.predict(*response, block, model_error + rig_error))
        total = noise + sum(prediction.residual + prediction.spread for prediction in predictions)
        if not (noise > 0.0 and math.isfinite(total)):
            raise FloatingPointError(
                f"the response to a compression of {block.compression:g} and a stress of "
                f"{block.stress:g} Pa is not finite"
            )
        return elastic.value, noise, predictions

    def _knowledge(
        self, noise: float, best: Prediction, predictions: list[Prediction]
    ) -> Knowledge:
        """Return what is known while a block is compared with its predictions."""
        posterior = self._best
        return Knowledge(
            noise=noise + posterior.walk_share(best),
            state=posterior.state,
            is_unimodal=posterior.is_unimodal,
            is_fresh=posterior.is_unimodal or posterior.blocks_since_solved == 0,
            is_exact=self._is_exact,
            is_surprise=self._is_surprise(noise, predictions),
        )

    def _is_surprise(self, noise: float, predictions: list[Prediction]) -> bool:
        """Whether no scale of the model's error foresaw a block, whatever alpha is.

        A scale that the data have spoken against need not be so surprised, but for the exact law;
        and what one scale foresaw is no surprise within the deviation of another.
        """
        least = _FOLLOWING * (CHANGE_DEVIATIONS**2 - _MOST_AGAINST) * noise
        if not self._is_tissue_known or any(p.residual**2 <= least for p in predictions):
            return False
        against = np.minimum(-2.0 * np.log(np.maximum(self._weights, _TINY_WEIGHT)), _MOST_AGAINST)
        against[0] = 0.0
        is_first = not self._change.is_suspected
        share = 1.0 if is_first or self._is_exact else _FOLLOWING
        thresholds = (share * (CHANGE_DEVIATIONS**2 - against)).tolist()
        squares, spreads = zip(
            *(posterior.foreseen(p) for posterior, p in zip(self._bank, predictions, strict=True)),
            strict=True,
        )
        square = min(squares)
        if any(
            square <= threshold * (noise + spread)
            for threshold, spread in zip(thresholds, spreads, strict=True)
        ):
            return False
        return all(
            square
            > threshold
            * (noise + spread + posterior.order_variance(prediction, is_first=is_first))
            for posterior, prediction, threshold, spread in zip(
                self._bank, predictions, thresholds, spreads, strict=True
            )
        )

    def _take(self, block: Block, noise: float, predictions: list[Prediction]) -> None:
        """Let every posterior learn from a block."""
        for posterior, prediction in zip(self._bank, predictions, strict=True):
            posterior.add(prediction, noise, block.size)
            # A state that takes up surprises would hide the change that they may be.
            if posterior.is_unimodal and not self._change.is_suspected:
                posterior.update(prediction, noise)
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        self._block_count += 1
        self._rig.follow(block.stress, self._step)
        if not self._is_exact:
            self._law.add(block, self._age.age, self._best.state[: _ORIGIN + 1])

    @property
    def _is_exact(self) -> bool:
        """Whether the law is said to be exact."""
        return len(self._bank) == 1

    @property
    def _is_tissue_known(self) -> bool:
        """Whether the data say something of the tissue's stiffness: only then can it change."""
        known = _KNOWN_LOG_SD
        if len(self._bank) > 1:
            known = min(known, _KNOWN_SHARE * self._config.prior.linear_stiffness_log_sd)
        return bool(self._best.covariance[_LOG_G, _LOG_G] < known**2)

    def _elastic(self, block: Block, state: Array) -> tuple[ElasticResponse, float]:
        """Return the elastic response at a block, and E at the time scale of the surface."""
        strain = self._geometry.strain(block.compression - float(state[_ORIGIN]))
        elastic = elastic_response(strain, math.exp(state[_LOG_G]), math.exp(state[_LOG_GN]))
        return elastic, apparent_stiffness_factor(float(state[_ORDER]), SURFACE_TIME)

    def _respond(
        self, block: Block, state: Array, slope: float
    ) -> tuple[Array, Array, dict[StateIndex, float]]:
        """Return the responses of law, old memory and linear parameters but the walk."""
        if self._config.uncertainty.compliance_sd > 0.0:
            self._bend(block, state, slope * math.exp(state[_LOG_G]))
        law, free, pulse, linearised = self._basis.take_block()
        self._step = self._law_step(BlockResponse(law, free))
        if self._contact_start is None:
            self._contact_start = block.memory_time
        in_order, _ = self._in_order(float(state[_ORDER]))
        linear = {
            StateIndex.BIAS: 1.0,
            StateIndex.DRIFT: block.memory_time - self._contact_start,
            StateIndex.PULSE: float(in_order @ pulse),
        }
        linear |= self._rig.columns(
            block,
            linearised @ in_order,
            self._step / math.exp(state[_LOG_G]),
            math.exp(state[_LOG_G]),
        )
        return law, free, linear

    def _bend(self, block: Block, state: Array, slope: float) -> None:
        """Let the response to the compliance go on at the present state, by a block's force."""
        duration = max(block.duration, _SHORTEST_BLOCK)
        stiffness = slope * apparent_stiffness_factor(float(state[_ORDER]), duration)
        in_origin, _ = self._in_origin(float(state[_ORIGIN]))
        force = self._rig.bend(block.compression, stiffness)
        self._basis.linearise(math.exp(state[_LOG_GN]), in_origin, force)

    def _law_step(self, response: BlockResponse) -> float:
        """Return the step of the law's stress from the last block to a response [Pa]."""
        before, self._last_response = self._last_response or response, response
        return self._best.law_step(before, response)

    def _start_anew(self, change: Change, innovation: Innovation, block: Block) -> None:
        """Learn a new tissue from here on; the response to the old one is kept as it was."""
        if change.state is not None:
            self._best.state = change.state
        late = block.memory_time + 0.5 * block.duration - change.time
        self._basis.freeze(*self._best.law_weights(), late)
        for posterior in self._bank:
            if posterior is not self._best:
                posterior.state = self._best.state.copy()
                posterior.covariance = self._best.covariance.copy()
            posterior.start_anew(innovation.predicted_fractional_stress)
        self._weights.fill(1.0 / len(self._bank))
        self._block_count = 0
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
        solved = False
        for posterior, weight in zip(self._bank, self._weights, strict=True):
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
        if fully and not self._is_exact:
            self._law.finish(self._best.state[: _ORIGIN + 1])

    def _weigh(self) -> None:
        evidence = np.array([posterior.log_evidence for posterior in self._bank])
        weights = np.exp(evidence - evidence.max())
        self._weights = weights / weights.sum()
        self._best = self._bank[int(np.argmax(self._weights))]

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate: mean and covariance of the mixture."""
        config = self._config
        states = np.array([posterior.state for posterior in self._bank])
        mean = self._weights @ states
        centred = states - mean
        covariance = (self._weights[:, None] * centred).T @ centred
        for weight, posterior in zip(self._weights, self._bank, strict=True):
            covariance += weight * posterior.covariance
        if self._is_exact:
            # The law is said to be exact: where it is not, nothing accounts for it but this.
            covariance *= self._change.inflation
            if self.is_mismatch:
                covariance += self._prior_covariance
        deviation = self._law.deviation
        if deviation is not None and deviation.motion_covariance is not None:
            own = covariance[:_ORIGIN, :_ORIGIN]
            own += _positive(deviation.motion_covariance - own)
        thickness = config.uncertainty.thickness_sd
        # Strain goes with 1/h: ln G and ln Gn are off together.
        covariance[:_ORDER, :_ORDER] += thickness**2
        # Symmetric to the last bit, which products of matrices are not.
        covariance = 0.5 * (covariance + covariance.T)
        # The origin of this contact, where the surface has shifted since the first.
        in_origin = np.zeros(mean.size)
        in_origin[_ORIGIN], in_origin[_SHIFT] = 1.0, self._way
        beyond = self._probability_beyond_boundary(mean)
        deviations = np.sqrt(np.maximum(covariance.diagonal()[:_ORIGIN], 0.0))
        valid, at_edge = determined(config, deviations, beyond), self._at_edge()
        is_solved = self._best.is_solved and not at_edge
        known = converged(config, deviations, valid) if is_solved else ParameterSet.NONE
        if self._order_is_disputed(float(mean[_ORDER]), float(deviations[_ORDER])):
            known &= ~ParameterSet.FRACTIONAL_ORDER
        return Estimate(
            log_linear_stiffness=float(mean[_LOG_G]),
            log_nonlinear_stiffness=float(mean[_LOG_GN]),
            fractional_order=float(mean[_ORDER]),
            covariance=covariance[:_ORIGIN, :_ORIGIN],
            strain_origin=float(mean @ in_origin) + self._surface,
            strain_origin_sd=math.sqrt(max(float(in_origin @ covariance @ in_origin), 0.0)),
            probability_beyond_boundary=beyond,
            valid=valid,
            known=known,
            at_edge=at_edge,
            sample_count=self._sample_count,
            model_error=self._model_error,
            loading_age=self._age.age,
            law_error=deviation.error if deviation is not None else None,
        )

    def _order_is_disputed(self, order: float, deviation: float) -> bool:
        """Whether the tissue is not the law's, and the fit of its relaxation wants another alpha.

        A walk takes any part of the stress that does not relax, the fit any smooth kernel: where
        the relaxation is no power law, each has an alpha of its own.
        """
        fit = self._law.deviation
        if fit is None or not self._best.uncertainty.kernel_sd:
            return False
        both = math.hypot(deviation, fit.fractional_order_sd)
        return abs(order - fit.fractional_order) > _SAME_ORDER * both

    def _at_edge(self) -> ParameterSet:
        """Return the parameters at an end of what can be represented, at a scale that counts."""
        found = ParameterSet.NONE
        for weight, posterior in zip(self._weights, self._bank, strict=True):
            if weight >= EDGE_SHARE:
                found |= posterior.at_edge()
        return found

    def motion_evidence(self) -> list[float] | None:
        """Return the evidence for shares of the stated motion; None where it tells nothing."""
        if self._is_exact or self._stated_config.uncertainty.surface_motion_sd == 0.0:
            return None
        return self._law.motion_evidence(self._best.state[: _ORIGIN + 1])

    @property
    def rig_deviations(self) -> float:
        """How far a contact that went in and out says the rig is from what is stated [1]."""
        told = self._rig.has_reversed and self._best.is_solved
        return self._best.rig_deviations() if told else 0.0

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after a contact; None where it tells nothing.

        That is where nothing is open, the loading never reversed, the tissue changed, or a
        solution was not found. The mixture of all scales of the model's error has these moments.
        """
        is_open = any(self._config.uncertainty.rig_sd)
        solved = all(posterior.is_solved and posterior.is_unimodal for posterior in self._likely)
        if not (is_open and solved and self._rig.has_reversed) or self._change.count:
            return None
        moments = [posterior.rig() for posterior in self._bank]
        means = np.array([mean for mean, _ in moments])
        mean = self._weights @ means
        centred = means - mean
        covariance = (self._weights[:, None] * centred).T @ centred
        for weight, (_, own) in zip(self._weights, moments, strict=True):
            covariance += weight * own
        return self._known_rig.taught(mean, 0.5 * (covariance + covariance.T), self._stated_config)

    @property
    def _likely(self) -> list[StressPosterior]:
        return [
            posterior
            for posterior, weight in zip(self._bank, self._weights, strict=True)
            if weight >= _LEAST_WEIGHT
        ]

    @property
    def _model_error(self) -> float:
        errors = [posterior.uncertainty.characteristic_sd for posterior in self._bank]
        return math.sqrt(float(self._weights @ np.square(errors)))

    def _probability_beyond_boundary(self, mean: Array) -> float:
        compression = self._max_compression - float(mean[_ORIGIN])
        if compression <= 0.0:
            return 0.0
        strain = self._geometry.strain(compression)
        beyond = np.array(
            [posterior.probability_beyond_boundary(strain) for posterior in self._bank]
        )
        return min(float(self._weights @ beyond), 1.0)


def _positive(matrix: Array) -> Array:
    """Return the positive part of a symmetric matrix, shape (n, n)."""
    values, vectors = np.linalg.eigh(matrix)
    part: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return part


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
