# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One place on the tissue: its strain origin, its memory and its estimator."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.block import Means
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.estimate import Estimate, ParameterSet, converged, without_surface
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import Observation
from fden_ros.core.estimation.fractional_stress_estimator import (
    FractionalStressEstimator,
    exact_orders,
)
from fden_ros.core.estimation.posterior_estimator import PosteriorEstimator
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.law.characteristic import apparent_stiffness_factor, elastic_responses
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.law.kernel import SHORTEST_STEP, order_interpolation, order_nodes
from fden_ros.core.outputs import WITHHELD, Flag
from fden_ros.core.streams.samples import NANOSECONDS, Pair, PathNoise, lateral_distance

#: The orders of the integral from here on are those between which it is interpolated; before them
#: stand the exact ones.
_NODES = 3
#: The tissue's relaxation between two contacts is followed in steps, the first of 1 ms [s], each
#: longer by 4 %. (Eight steps a decade would bias Gn by a third of its error's bound.)
_FIRST_REST, _REST_RATIO = 1e-3, 1.04
#: A touch elsewhere within this time [s] of a contact whose beginning was not seen continues it: a
#: palpation of 1 Hz dips out of the tissue for at most half of its period.
_DIP_TIME = 0.5
#: The surface found at the touch starts the filter; its deviation is multiplied by this, since the
#: filter sees those samples again.
ORIGIN_WIDENING = 3.0

#: The force where a touch is found is the mean of its last samples, as many [1].
_DETECTED = 3

#: Without positions a touch after the timeout is at the same place where the surface, more than 5
#: of its deviations below where it was met first, lies as deep as 0.6 to 1.6 of what the tissue
#: has not recovered of the last contact; after 5 timeouts that is too little to tell.
_CLEARLY_BELOW, _RECOVERED, _MOST_TIMEOUTS = 5.0, (0.6, 1.6), 5.0
#: A probe is dragged beyond this multiple of the distance of two sites [1], so that noise of the
#: position drags none.
_DRAGGED = 2.0
#: A contact contradicts what is stated of the rig where a quantity of it is farther off than this
#: many standard deviations [1]: undisturbed rigs reach 1.8, a friction six times as large 2.7.
_CONTRADICTION = 2.5


class Site:
    """One place on the tissue, from the first touch on.

    Parameters
    ----------
    site_id : int
    onset : Onset
        Of the first touch.
    config : PipelineConfig
    rig : RigKnowledge
        What is known of the rig before the first touch.
    flags : Flag
        What stands against every estimate.

    Attributes
    ----------
    origin : float
        Nominal displacement at zero strain [m].
    origin_sd : float
        Its standard deviation, as compression [1].
    is_usable : bool
        The history has been seen from the first touch, without a gap.
    estimate : Estimate or None
        The newest.
    left : Position or None
        Where the probe was when the tissue was last on it.
    teaches_rig, teaches_motion, teaches_drift : bool
        What is learned here of the rig, of the surface's motion and of the force's drift, may be
        used at other sites.
    known_rig : RigKnowledge
        What was known of the rig before the first touch.
    """

    def __init__(
        self,
        site_id: int,
        onset: Onset,
        config: PipelineConfig,
        rig: RigKnowledge,
        flags: Flag = Flag.NONE,
    ) -> None:
        first = onset.samples[0]
        self.site_id = site_id
        self.start_ns = self.last_ns = first.stamp_ns
        self.position = self.left = first.position
        self._touched_at = first.displacement
        self.is_usable = True
        self.flags = flags
        self.estimate: Estimate | None = None
        self._config = config
        self.known_rig = rig
        self.teaches_rig, self.teaches_motion = config.learns_rig, config.learns_motion
        self.teaches_drift = config.learns_drift
        if config.strain_origin is not None:
            self.origin, self.origin_sd = config.strain_origin, 0.0
        else:
            self.origin = onset.displacement
            found = ORIGIN_WIDENING * onset.displacement_sd / config.geometry.length
            self.origin_sd = math.hypot(found, _hidden_strain(onset, config))
        self._interpolation = order_interpolation()
        self._integral = FractionalIntegral(_orders(config))
        self._integral.start(0.0)
        self._estimator: Estimator | None = None
        self._rise = onset.rise if config.strain_origin is None else None
        self._variance_factor = 1.0
        #: For the surface's motion: of the newest contact, and of the first, the only one that
        #: begins at rest.
        self._newest_evidence: list[float] | None = None
        self._motion_evidence: list[float] | None = None

    @property
    def has_failed(self) -> bool:
        """Whether the computation failed here."""
        return bool(self.flags & Flag.ESTIMATION_FAILED)

    @property
    def usable_estimate(self) -> Estimate | None:
        """The newest estimate, where the history has been seen."""
        return self.estimate if self.is_usable else None

    @property
    def is_learning(self) -> bool:
        """Whether blocks are of use."""
        return self._estimator is not None and self.is_usable

    @property
    def is_known(self) -> bool:
        """Whether the estimate has converged and the model describes the tissue."""
        return (
            self.is_usable
            and self.estimate is not None
            and self.estimate.converged
            and self._estimator is not None
            and not self._estimator.is_mismatch
        )

    @property
    def is_mismatch(self) -> bool:
        """Whether the innovations are larger or slower than model and noise explain."""
        return self._estimator is not None and self._estimator.is_mismatch

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest innovations are not explained yet."""
        return self._estimator is not None and self._estimator.is_doubtful

    @property
    def change_count(self) -> int:
        """How often the tissue was found to have changed under the probe."""
        return self._estimator.change_count if self._estimator is not None else 0

    # Touch

    def is_elsewhere(self, onset: Onset) -> bool:
        """Whether a touch is at another site than this.

        Without positions that is after the timeout, unless the tissue pressed here would be just
        where the surface was met: nothing else says that it has not moved.
        """
        contact, first = self._config.contact, onset.samples[0]
        if self.position is None or first.position is None:
            timeouts = self.seconds_to(first.stamp_ns) / contact.site_timeout
            if timeouts <= 1.0:
                return False
            return timeouts > _MOST_TIMEOUTS or not self._has_recovered_to(onset)
        apart = lateral_distance(contact.approach_axis, self.position, first.position)
        return apart > contact.site_distance

    def _has_recovered_to(self, onset: Onset) -> bool:
        """Whether the tissue has come back from the last contact as far as a touch met it."""
        estimate = self.estimate
        if estimate is None or not self.is_known:
            return False
        length = self._config.geometry.length
        way = (onset.displacement - self.origin) / length - estimate.strain_origin
        if way * length <= _CLEARLY_BELOW * onset.displacement_sd:
            return False
        step = self.seconds_to(onset.samples[0].stamp_ns)
        deepest, highest = (way / share + estimate.strain_origin for share in _RECOVERED)
        return self.is_above_surface(step, highest) and not self.is_above_surface(step, deepest)

    def check_history(self, onset: Onset) -> None:
        """Become unusable if the tissue may have been pressed unseen before a touch."""
        first = onset.samples[0]
        # A site that was pressed before needs no surface, only to be left alone in between.
        is_followed = onset.seen if first.stamp_ns == self.start_ns else onset.air_seen
        if not is_followed and not self._begins_at_origin(first):
            self.is_usable = False
            self.flags |= Flag.ORIGIN_UNCERTAIN

    def leaves_doubt(self, stamp_ns: int) -> bool:
        """Whether a touch elsewhere may be of a probe that has not left the tissue since this.

        So a probe that palpates as it slides dips out of a contact whose beginning was not seen,
        or in which it went as far to the side as to another site: the tissue that it meets next
        is of what it has just dragged along.
        """
        is_doubted = Flag.ORIGIN_UNCERTAIN in self.flags or self._has_slid
        return is_doubted and dips(stamp_ns - self.last_ns)

    @property
    def _has_slid(self) -> bool:
        """Whether the probe left the tissue beside this site."""
        if self.position is None or self.left is None:
            return False
        contact = self._config.contact
        apart = lateral_distance(contact.approach_axis, self.position, self.left)
        return apart > contact.site_distance

    def is_dragged_over(self, pair: Pair) -> bool:
        """Whether the probe has gone aside from its touch, and farther than in.

        It then presses on tissue whose past was not seen. What is not the displacement's part of
        its way is aside, in whatever frame the approach axis is. (Along an axis that is tilted by
        less than 45 degrees it goes less to the side than in.)
        """
        if self.position is None or pair.position is None:
            return False
        way = math.dist(self.position, pair.position)
        inward = abs(pair.displacement - self._touched_at)
        least = _DRAGGED * self._config.contact.site_distance
        return way**2 > inward**2 + max(least, inward) ** 2

    def _begins_at_origin(self, pair: Pair) -> bool:
        """Whether the origin is given and a sample is there, so that no press came before it."""
        origin = self._config.strain_origin
        if origin is None:
            return False
        compression = (pair.displacement - origin) / self._config.geometry.length
        return compression <= self._config.block_compression

    def begin_contact(self, onset: Onset, noise: PathNoise) -> None:
        """Let the tissue relax until a touch, and start the estimator.

        `noise` is that of displacement and surface.
        """
        scale = self._config.geometry.stress_per_force
        if self.is_usable and self._estimator is None:
            self._estimator = _new_estimator(
                self._config, onset.noise_sd * scale, self.origin_sd, noise, self.known_rig
            )
        self._rest_until(onset.samples[0].stamp_ns)
        self._integral.take_sum()
        if self._estimator is not None:
            self._estimator.begin_contact(onset.bias_sd * scale, onset.drift_sd * scale)

    def _rest_until(self, stamp_ns: int) -> None:
        """Let the tissue relax free of stress since the last sample in contact."""
        step = self.seconds_to(stamp_ns)
        if step < 4.0 * SHORTEST_STEP:
            return
        end = step - SHORTEST_STEP
        first = min(_FIRST_REST, 0.5 * end)
        count = 2 + math.ceil(math.log(end / first) / math.log(_REST_RATIO))
        elapsed = np.geomspace(first, end, count if first == _FIRST_REST else 2)
        steps = tuple(np.diff(elapsed, prepend=0.0).tolist())
        self._integral.relax(steps)
        if self._estimator is not None and self.is_usable:
            self._estimator.rest(end)
        self.last_ns = stamp_ns - round(SHORTEST_STEP * NANOSECONDS)

    # Samples

    def seconds_to(self, stamp_ns: int) -> float:
        """Return the time since the last sample in contact [s]."""
        return (stamp_ns - self.last_ns) / NANOSECONDS

    def compression(self, displacement: float) -> float:
        """Return the compression from the nominal origin [1]."""
        return (displacement - self.origin) / self._config.geometry.length

    def add(
        self,
        pair: Pair,
        compression: float,
        stress: float,
        *,
        is_free: bool,
        learns: bool,
    ) -> None:
        """Take a sample of a contact; `is_free`: the tissue is not on the probe.

        `learns`: the estimator takes it too, not only the memory.
        """
        stamp_ns = pair.stamp_ns
        step = self.seconds_to(stamp_ns)
        estimator = self._estimator if learns and self.is_usable else None
        if estimator is not None:
            estimator.take(step, compression, stress, is_free=is_free)
        if step > 0.0:
            if is_free:
                self._integral.advance(step, 0.0)
            else:
                self._integral.add(step, stress)
        self.last_ns = stamp_ns

    def is_above_surface(self, step: float, compression: float) -> bool:
        """Whether the tissue would have to pull at the probe `step` seconds after the last sample.

        By the newest estimate; without one False.
        """
        estimate = self.estimate
        if estimate is None:
            return False
        weights, _ = self._interpolation(estimate.fractional_order)
        free = float(weights @ self._integral.ahead(step)[_NODES:])
        strain = self._config.geometry.strain(compression - estimate.strain_origin)
        return estimate.is_above_surface(strain, free)

    def change_of_stress(self, before: float, compression: float, elapsed: float) -> float:
        """Return by how much the stress changes [Pa] when the compression does, in some time [s].

        By the newest estimate; without one 0.
        """
        estimate = self.estimate
        if estimate is None or elapsed <= 0.0:
            return 0.0
        strains = np.array([before, compression]) - estimate.strain_origin
        elastic = elastic_responses(
            np.array([self._config.geometry.strain(float(u)) for u in strains]),
            estimate.linear_stiffness,
            estimate.nonlinear_stiffness,
        )
        step = float(elastic.value[1] - elastic.value[0])
        return step * apparent_stiffness_factor(estimate.fractional_order, elapsed)

    # Blocks

    def block_of(self, means: Means) -> Block:
        """Return a block for the estimator: means, and the memory's means since the last."""
        return Block(
            compression=means.compression,
            stress=means.stress,
            memory_time=0.5 * (means.start_ns + means.end_ns - 2 * self.start_ns) / NANOSECONDS,
            size=means.size,
            duration=means.duration,
            fractional_integrals=self._integral.take_sum() / means.size,
        )

    def fractional_stress(self, block: Block) -> float:
        """Return D^-alpha of the stress of a block, at the newest alpha [Pa s^alpha]."""
        integrals = block.fractional_integrals
        order = prior = self._config.estimator.prior.fractional_order
        if self.estimate is not None:
            order = self.estimate.fractional_order
        if order == prior:
            return float(integrals[0])
        return float(self._interpolation(order)[0] @ integrals[_NODES:])

    def update(self, block: Block) -> Innovation:
        """Learn from a block of a site that is learning.

        Raises
        ------
        FloatingPointError
            If the innovation is not finite.
        """
        assert self._estimator is not None
        innovation = self._estimator.update(block)
        _check_finite(innovation.innovation, innovation.variance)
        return innovation

    def skip(self) -> None:
        """Let a block go by."""
        assert self._estimator is not None
        self._estimator.skip()

    def refresh(self) -> None:
        """Bring the estimate up to date.

        Raises
        ------
        FloatingPointError
            If it is not finite.
        """
        assert self._estimator is not None
        estimate = _checked(self._estimator.estimate())
        self.estimate = self._withheld(self._widened(self._as_touched(estimate)))

    def _as_touched(self, estimate: Estimate) -> Estimate:
        """Return an estimate that claims no stiffness where the touch did not show the surface."""
        if self._rise is None:
            return estimate
        geometry = self._config.geometry
        depth = self._rise.depth / geometry.length
        growth = estimate.nonlinear_stiffness * geometry.strain_slope(depth) * depth
        if self._rise.shows_surface(growth):
            return estimate
        return without_surface(estimate, self._config.estimator.prior)

    def withhold(self, flag: Flag) -> None:
        """Take no estimate of this site for converged any more."""
        self.flags |= flag
        if self.estimate is not None:
            self.estimate = self._withheld(self.estimate)

    def _withheld(self, estimate: Estimate) -> Estimate:
        """Return an estimate of which nothing is known where something stands against it."""
        is_withheld = bool(self.flags & WITHHELD)
        return estimate._replace(known=ParameterSet.NONE) if is_withheld else estimate

    def _widened(self, estimate: Estimate) -> Estimate:
        """Return an estimate with the variance that contradictions of its data ask for."""
        if self._variance_factor == 1.0:
            return estimate
        wide = estimate._replace(covariance=self._variance_factor * estimate.covariance)
        sharp = converged(self._config.estimator, wide.deviations, estimate.valid)
        return wide._replace(known=estimate.known & sharp)

    def doubt(self, flag: Flag, variance_factor: float) -> None:
        """Take note of a contradiction: raise a flag and widen the covariance by a factor."""
        self.flags |= flag
        if variance_factor > self._variance_factor:
            self._variance_factor, before = variance_factor, self._variance_factor
            if self.estimate is not None:
                covariance = self.estimate.covariance / before
                self.estimate = self._widened(self.estimate._replace(covariance=covariance))

    def withdraw(self) -> None:
        """Become unusable: the tissue under the probe has a past that was not seen."""
        self.is_usable = False
        self.flags |= Flag.ORIGIN_UNCERTAIN

    def end_contact(self) -> None:
        """Bring the estimate to its best at the end of a contact."""
        if self._estimator is not None and self.is_usable and self.estimate is not None:
            self._estimator.finish()
            self.refresh()
            self._newest_evidence = self._evidence_of_motion(self._estimator)
            if self._newest_evidence is not None:
                self.doubt(Flag.NONE, self.known_rig.motion_factor(self._newest_evidence))
            off = self._estimator.rig_misfit / _CONTRADICTION
            if off > 1.0:
                self.doubt(Flag.HYSTERESIS, 1.0 + off**2)

    def _evidence_of_motion(self, estimator: Estimator) -> list[float] | None:
        """Return the evidence of a contact for the surface's motion where it is of use."""
        if self.teaches_motion or self.known_rig.motion_share < 1.0:
            return estimator.motion_evidence()
        return None

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after a contact; None where it tells nothing."""
        if self._estimator is None or not self.is_usable or self.is_doubtful:
            return None
        known = self._estimator.rig() if self.teaches_rig else None
        if not self.teaches_motion:
            return known
        self._motion_evidence = self._newest_evidence or self._motion_evidence
        if self._motion_evidence is None:
            return known
        return (known or self.known_rig).moved(self._motion_evidence)

    def teach_nothing(self) -> None:
        """Let no other site use what is learned here."""
        self.teaches_rig = self.teaches_motion = self.teaches_drift = False

    def fail(self) -> None:
        """Become unusable after an exception."""
        self.is_usable = False
        self.flags |= Flag.ESTIMATION_FAILED
        self._estimator = self.estimate = None


def prepare(config: PipelineConfig) -> None:
    """Compute the kernels' weights, which takes a moment: not only at the first touch."""
    FractionalIntegral(_orders(config))
    _new_estimator(config, 1.0, 1.0, PathNoise(), RigKnowledge.stated(config.estimator))


def dips(duration_ns: int) -> bool:
    """Whether a probe that was off the tissue for so long may just have dipped out of it."""
    return duration_ns < _DIP_TIME * NANOSECONDS


def _orders(config: PipelineConfig) -> tuple[float, ...]:
    return (*exact_orders(config.estimator), *order_nodes())


def _new_estimator(
    config: PipelineConfig,
    noise_sd: float,
    origin_sd: float,
    noise: PathNoise,
    rig: RigKnowledge,
) -> Estimator:
    geometry = config.geometry
    if config.estimator.observation is not Observation.FRACTIONAL_STRESS:
        path_noise = noise.scaled(geometry.length)
        return PosteriorEstimator(config.estimator, geometry, noise_sd, origin_sd, path_noise, rig)
    return FractionalStressEstimator(config.estimator, geometry, noise_sd, origin_sd)


def _checked(estimate: Estimate) -> Estimate:
    """Return an estimate that is finite throughout.

    Raises
    ------
    FloatingPointError
        If it is not.
    """
    _check_finite(
        estimate.log_linear_stiffness,
        estimate.log_nonlinear_stiffness,
        estimate.fractional_order,
        estimate.strain_origin,
        estimate.strain_origin_sd,
        float(estimate.covariance.sum()),
    )
    return estimate


def _check_finite(*numbers: float) -> None:
    if not math.isfinite(sum(numbers)):
        raise FloatingPointError(f"the estimate is not finite: {numbers}")


def _hidden_strain(onset: Onset, config: PipelineConfig) -> float:
    """Return how much deeper than a line says the probe is where the force is found first [1].

    The surface is found by a line. Where the force rises out of the noise beyond the boundary
    strain 1/Gn only, the line finds it by ln(stress Gn/G)/Gn too late.
    """
    if onset.rise.is_bent:
        return 0.0
    prior = config.estimator.prior
    gn = prior.nonlinear_stiffness
    force = float(np.mean([pair.force for pair in onset.samples[-_DETECTED:]])) - onset.bias
    stress = force * config.geometry.stress_per_force
    return math.log(max(stress * gn / prior.linear_stiffness, 1.0)) / gn
