# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How a block's stress follows from the motion: responses of law and rig, and their noise."""

from __future__ import annotations

import math
from typing import NamedTuple

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.motion_jitter import MotionJitter
from fden_ros.core.estimation.motion_noise import MotionNoise
from fden_ros.core.estimation.normal_equations import BlockResponse
from fden_ros.core.estimation.posterior import StressPosterior
from fden_ros.core.estimation.rig import RigResponse
from fden_ros.core.estimation.unmodelled import (
    SURFACE_TIME,
    Growth,
    LoadingAge,
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

#: Least duration of a block for which the tissue yields to a bending tool [s]: that of one sample.
_SHORTEST_BLOCK = 0.002


class Observation(NamedTuple):
    """What the motion makes of a block's stress, about a state."""

    fractional_stress: float  #: phi, the elastic response [Pa s^alpha]
    law: Array  #: D^alpha phi at G = 1 [1], shape (nodes, origins * orders)
    free: Array  #: of the old tissue's memory [Pa], shape (orders,)
    linear: dict[StateIndex, float]  #: columns of the linear parameters but the walk's
    noise: float  #: variance of the block's mean stress [Pa^2]
    noise_before: float  #: what it tells of the block before: further variance of a sample [Pa^2]
    late_delay: float  #: and what that block's column of the delay lacks, at G = 1 [1]
    growth: Growth  #: of the loading over the block
    rig_error: float  #: by which the variance of the rig's error grows [Pa^2]


class StressObservation:
    """Follows the motion of a site, sample by sample.

    Parameters
    ----------
    uncertainty : Uncertainty
    geometry : Geometry
    grid : LogStiffnessGrid
        Nodes of ln Gn.
    origins : ndarray, shape (m,)
        Nodes of the strain origin [1].
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    path_noise : PathNoise
        Of the compression [1].
    """

    def __init__(
        self,
        uncertainty: Uncertainty,
        geometry: Geometry,
        grid: LogStiffnessGrid,
        origins: Array,
        noise_sd: float,
        path_noise: PathNoise,
    ) -> None:
        self._uncertainty = uncertainty
        self._geometry = geometry
        self._noise_variance = noise_sd**2
        self._motion = MotionNoise(path_noise.total)
        self._jitter = MotionJitter(path_noise.displacement)
        # The surface moves slower than the probe, and its noise is told apart by itself: where the
        # probe turns, a line through both would take the turn for noise.
        self._surface_jitter = MotionJitter(path_noise.surface)
        self._in_origin = Lagrange(origins)
        self._in_order = order_interpolation()
        self._basis = StressBasis(geometry, grid.nodes, origins)
        self._age = LoadingAge()
        self._rig = RigResponse(uncertainty, geometry, path_noise.total)
        self._last_response: BlockResponse | None = None
        self._step = 0.0  # of the law's stress up to the newest block [Pa]
        self._contact_start: float | None = None

    @property
    def loading_age(self) -> float:
        """The mean time since the present elastic response was built up [s]."""
        return self._age.age

    @property
    def has_reversed(self) -> bool:
        """Whether the probe has gone in and out in this contact."""
        return self._rig.has_reversed

    # Samples

    def begin_contact(self) -> None:
        """Start a contact."""
        self._motion.interrupt()
        self._interrupt_jitter()
        self._age.interrupt()
        self._rig.begin_contact()
        self._last_response = None
        self._contact_start = None
        self._basis.begin_contact()

    def press(self, step: float, compression: float, surface: float) -> None:
        """Take the motion of a sample in contact, from which `surface` was taken off [1]."""
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
        self._basis.rest(steps, free_responses)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._motion.skip_block()
        self._basis.discard_block()

    # Blocks

    def take_block(self, block: Block, posterior: StressPosterior) -> Observation:
        """Return what the motion since the last block makes of one's stress.

        Parameters
        ----------
        block : Block
        posterior : StressPosterior
            At whose state what is not linear is linearised.
        """
        state, geometry = posterior.state, self._geometry
        elastic, relaxed = self._elastic(block, state)
        slope = elastic.by_strain * geometry.strain_slope(block.compression - state[_ORIGIN])
        law, free, linear = self._respond(block, posterior, slope / math.exp(state[_LOG_G]))
        growth = self._age.grow(block.duration, elastic.value / math.exp(state[_LOG_G]))
        noise, before = self._motion.take_block(
            block.duration, block.size, slope, float(state[_ORDER])
        )
        turn = self._rig.turn_variance
        noise += self._noise_variance / block.size + turn
        before += turn * block.size**2
        stiffness = max(slope, 0.0) * relaxed / geometry.length
        rig_error = rig_error_variance(self._uncertainty, geometry, block.duration, stiffness)
        return Observation(
            fractional_stress=elastic.value,
            law=law,
            free=free,
            linear=linear,
            noise=noise,
            noise_before=before,
            late_delay=self._rig.late_delay,
            growth=growth,
            rig_error=rig_error,
        )

    def follow(self, stress: float) -> None:
        """Follow the stress of a block that was taken [Pa]."""
        self._rig.follow(stress, self._step)

    def freeze(self, posterior: StressPosterior, late: float) -> None:
        """Keep the response so far as an old tissue's, which ended `late` seconds ago."""
        self._basis.freeze(*posterior.law_weights(), late)

    def _elastic(self, block: Block, state: Array) -> tuple[ElasticResponse, float]:
        """Return the elastic response at a block, and E at the time scale of the surface."""
        strain = self._geometry.strain(block.compression - float(state[_ORIGIN]))
        elastic = elastic_response(strain, math.exp(state[_LOG_G]), math.exp(state[_LOG_GN]))
        return elastic, apparent_stiffness_factor(float(state[_ORDER]), SURFACE_TIME)

    def _respond(
        self, block: Block, posterior: StressPosterior, slope: float
    ) -> tuple[Array, Array, dict[StateIndex, float]]:
        """Return the responses of law, old memory and linear parameters but the walk."""
        state = posterior.state
        if self._uncertainty.compliance_sd > 0.0:
            self._bend(block, state, slope * math.exp(state[_LOG_G]))
        law, free, pulse, linearised = self._basis.take_block()
        response = BlockResponse(law, free)
        before, self._last_response = self._last_response or response, response
        self._step = posterior.law_step(before, response)
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
