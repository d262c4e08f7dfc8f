# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One place on the tissue: its strain origin, its memory and its estimator."""

from __future__ import annotations

import copy
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.block import ContactSample, Means
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import Onset
from fden_ros.core.estimation import (
    Block,
    Budget,
    Estimate,
    Estimator,
    EstimatorKind,
    Innovation,
    PosteriorEstimator,
    Reservations,
    reserved,
)
from fden_ros.core.law import SHORTEST_STEP, StressMemory, memory_weights
from fden_ros.core.lift_off import KnownTissue, LiftOff
from fden_ros.core.origin import begins_at_origin, found_sd, origin_of
from fden_ros.core.outputs import Flag
from fden_ros.core.standing import Standing
from fden_ros.core.streams import NANOSECONDS, Pair
from fden_ros.core.whereabouts import Whereabouts

#: A touch elsewhere within this time [s] of a contact whose beginning was not seen continues it: a
#: palpation of 1 Hz leaves the tissue for at most half of its period.
_DIP_TIME = 0.5
#: A contact contradicts the stated rig where one of its quantities is off by more than this
#: many standard deviations: undisturbed rigs reach 1.8, a friction six times as large 2.7.
_CONTRADICTION = 2.5
#: The tissue has changed where the innovations of this many consecutive blocks sum to more than
#: this many standard deviations of their sum, and the newest exceeds this many of its own and this
#: part of the stress [1]. Presses of unchanged tissue reach 15 deviations and 2 %, or 9 deviations
#: and 11 % where the filter is linearised at a solution of less depth. A slide onto tissue that is
#: 1.3 times as stiff reaches 17 and 9 % at 100 Hz, an inclusion more.
_GATE_BLOCKS, _GATE_SUM, _GATE_NEWEST, _GATE_PART = 4, 13.0, 16.0, 0.04
#: Or one block exceeds this many and this part of the largest stress [1]: the probe slips.
_GATE_ONE, _GATE_STEP = 8.0, 0.15


class Learned(NamedTuple):
    """The results of a block."""

    compression: float  #: [1]
    stress: float  #: [Pa]
    fractional_stress: float  #: at the newest alpha [Pa s^alpha]
    innovation: Innovation | None  #: None: the law does not hold for it


class Site(Standing):
    """One place on the tissue, from the first touch on.

    `flags` apply to every estimate.

    Attributes
    ----------
    origin, origin_sd : float
        Nominal displacement at zero strain [m]; its standard deviation, as compression [1].
    """

    def __init__(self, site_id: int, onset: Onset, config: PipelineConfig, flags: Flag) -> None:
        super().__init__(config.estimator, flags)
        first = onset.samples[0]
        self.site_id = site_id
        self.start_ns = self._last_ns = first.stamp_ns
        self.position = first.position  #: of the first touch [m]
        self._config = config
        self.whereabouts = Whereabouts(first, config)
        self.origin, self.origin_sd = origin_of(onset, config)
        self._memory = StressMemory()
        self._estimator: Estimator | None = None
        self._lift_off: LiftOff | None = None
        self._recent: deque[tuple[float, bool]] = deque(maxlen=_GATE_BLOCKS)
        self._largest = 0.0  #: stress of the contact [Pa]
        self._before = -math.inf  #: compression of the previous block [1]

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest data fail the innovation test."""
        return self._estimator is not None and self._estimator.is_doubtful

    @property
    def live_estimate(self) -> Estimate | None:
        """The usable estimate, of which nothing is known while the innovation test fails."""
        estimate = self.usable_estimate
        if estimate is None or not self.is_doubtful:
            return estimate
        return reserved(self._config.estimator, estimate, Reservations(is_doubtful=True))

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law."""
        return self._estimator is not None and self._estimator.is_mismatch

    @property
    def _known(self) -> KnownTissue | None:
        """The tissue, where the estimate has converged and the law describes it."""
        estimate = self.usable_estimate
        if estimate is None or not estimate.converged or self.is_mismatch:
            return None
        return KnownTissue(estimate, self._memory, self._config.geometry)

    # Touch

    def is_elsewhere(self, onset: Onset) -> bool | None:
        """Whether a touch is at another site; None: no positions, and after the timeout."""
        first, contact = onset.samples[0], self._config.contact
        if (is_apart := self.whereabouts.is_apart(first.position)) is not None:
            return is_apart
        if contact.without_position != "either":
            return contact.without_position == "other"
        is_late = self._seconds_to(first.stamp_ns) > contact.site_timeout
        return None if is_late else False

    def put_away(self) -> None:
        """Keep what the next contact here needs of the last one: the probe is elsewhere."""
        if self._estimator is not None:
            self._estimator.put_away()

    def leaves_doubt(self, stamp_ns: int) -> bool:
        """Whether a touch elsewhere may be of a probe that has not left the tissue since this.

        A probe that palpates while it slides lifts off briefly. If the beginning of its contact
        was not seen, or the contact went sideways as far as to another site, the next touch is on
        tissue that it has just dragged along.
        """
        has_slid = self.whereabouts.is_apart(self.whereabouts.left)
        has_past = self.flags & (Flag.TOUCH_NOT_OBSERVED | Flag.TISSUE_CHANGED)
        is_doubted = bool(has_past) or bool(has_slid)
        return is_doubted and dips(stamp_ns - self._last_ns)

    def check_history(self, onset: Onset) -> None:
        """Invalidate the estimates: the tissue may have been pressed unseen before a touch."""
        first = onset.samples[0]
        # A site that was pressed before needs no surface, only a rest in between.
        is_followed = onset.seen if first.stamp_ns == self.start_ns else onset.air_seen
        if not is_followed and not begins_at_origin(first, self._config):
            self.withdraw()

    def touch(self, onset: Onset, noise: float, before: Site | None) -> None:
        """Let the tissue relax until a touch, and start the estimator.

        `noise` is that of displacement and surface: variance per sample times the time between
        samples [m^2 s]; `before` the site of the touch before.
        """
        config, first = self._config, onset.samples[0]
        scale = config.geometry.stress_per_force
        is_first = first.stamp_ns == self.start_ns
        self._lift_off = LiftOff(onset.release_force, scale, is_first=is_first)
        if self.is_observed and self._estimator is None:
            noise_sd, origin_sd = onset.noise_sd * scale, self.origin_sd
            new = _new_estimator(config, noise_sd, origin_sd, noise)
            if before is not None and before.is_elsewhere(onset) is None:
                before.may_go_on_as(new, onset, self)
            self._estimator = new
        self._rest_until(first.stamp_ns)
        self._recent.clear()
        self._largest, self._before = 0.0, -math.inf
        self._memory.begin_block()
        if self._estimator is not None:
            times, way, forces = onset.way
            seen = (times, (way - self.origin) / config.geometry.length, scale * forces)
            self._estimator.begin_contact(
                onset.bias_sd * scale, onset.drift_sd * scale, np.array(seen)
            )

    def may_go_on_as(self, new: Estimator, onset: Onset, other: Site) -> None:
        """Pass this tissue to the estimator of another site, of tissue at rest: they may be one.

        It gets a copy: a later touch here continues from the knowledge of this site.
        """
        own = copy.deepcopy(self._estimator) if self.is_observed else None
        if not (isinstance(own, PosteriorEstimator) and isinstance(new, PosteriorEstimator)):
            return
        own.rest(self._pause_until(onset.samples[0].stamp_ns))
        shift = (other.origin - self.origin) / self._config.geometry.length
        found = found_sd(onset, self._config)
        wider = math.log(other.origin_sd / found) if other.origin_sd and found else 0.0
        new.may_be_of(own, shift, wider)

    def _rest_until(self, stamp_ns: int) -> None:
        """Let the tissue relax free of stress since the last sample in contact."""
        pause = self._pause_until(stamp_ns)
        if not pause:
            return
        self._memory.rest(pause)
        if self._estimator is not None and self.is_observed:
            self._estimator.rest(pause)
        self._last_ns = stamp_ns - round(SHORTEST_STEP * NANOSECONDS)

    def _pause_until(self, stamp_ns: int) -> float:
        """Return the time without stress since the last sample in contact [s]."""
        step = self._seconds_to(stamp_ns)
        return step - SHORTEST_STEP if step >= 4.0 * SHORTEST_STEP else 0.0

    def _seconds_to(self, stamp_ns: int) -> float:
        """Return the time since the last sample in contact [s]."""
        return (stamp_ns - self._last_ns) / NANOSECONDS

    # Samples and blocks

    def follow(self, pair: Pair, force: float, *, learns: bool) -> ContactSample:
        """Add a sample of a contact and its force [N] to the memory.

        `learns`: the estimator uses it too.
        """
        assert self._lift_off is not None
        geometry = self._config.geometry
        displacement = self._config.contact.compliance_free(pair, force)
        compression = (displacement - self.origin) / geometry.length
        stress, step = force * geometry.stress_per_force, self._seconds_to(pair.stamp_ns)
        is_free = self._lift_off.is_free(step, force, compression, self._known)
        if not is_free:
            self.whereabouts.left = pair.position
            if self.is_observed and self.whereabouts.is_dragged(pair):
                self.withdraw()
        if learns and self.is_observed and self._estimator is not None:
            is_round = geometry.exponent > 1.0
            is_off = is_free or (is_round and self._lift_off.is_shrinking(compression))
            self._estimator.take(step, compression, stress, is_free=is_off)
        if step > 0.0:
            self._memory.press(step, 0.0 if is_free else stress)
        self._last_ns = pair.stamp_ns
        return ContactSample(pair.stamp_ns, step, force, compression, stress, is_free)

    def learn(self, means: Means, *, learns: bool, is_silent: bool) -> Learned:
        """Add a block of a contact.

        `learns`: the estimator uses it too; `is_silent`: without an estimate.

        Raises
        ------
        FloatingPointError
            If innovation or estimate is not finite.
        """
        assert self._lift_off is not None
        memory, innovation = self._memory.means(means.size), None
        fractional_stress = _fractional_stress(memory, self._config, self.estimate)
        if learns and self.is_observed and self._estimator is not None:
            self._lift_off.see_mean(means.force)
            if not means.has_free:
                block = _block(means, memory, self.start_ns, is_past=is_silent)
                was_explained = not self._estimator.is_doubtful
                innovation = self._estimator.update(block)
                if innovation is not None:
                    _check_finite(innovation.innovation, innovation.variance)
                    # The paper's filter judges by chi squared: its innovations are large at first.
                    if self._config.estimator.kind is EstimatorKind.GRID:
                        self._gate(innovation, means.compression, was_explained=was_explained)
            else:
                self._estimator.skip()
            if not is_silent or self.estimate is None:
                # A contact that is reported only at its end has silent blocks alone.
                self.find(_checked(self._estimator.estimate()))
        return Learned(means.compression, means.stress, fractional_stress, innovation)

    def _gate(self, innovation: Innovation, compression: float, *, was_explained: bool) -> None:
        """Invalidate the site where consecutive blocks do not fit the tissue that was touched.

        `was_explained`: the previous block was. An estimator that has not settled has large
        innovations, so the first of them has to follow an explained block.
        """
        recent, off = self._recent, abs(innovation.innovation)
        recent.append((innovation.innovation / math.sqrt(innovation.variance), was_explained))
        together = abs(sum(deviations for deviations, _ in recent)) / math.sqrt(_GATE_BLOCKS)
        stress = abs(innovation.predicted_stress + innovation.innovation)
        self._largest = max(self._largest, stress)
        newest = abs(recent[-1][0])
        is_beyond = newest > _GATE_NEWEST and off > _GATE_PART * stress
        # A delayed force lags most where the probe retracts.
        advances, self._before = compression >= self._before, compression
        is_step = newest > _GATE_ONE and off > _GATE_STEP * self._largest
        has_slipped = is_step and advances and was_explained
        if has_slipped or (recent[0][1] and together > _GATE_SUM and is_beyond):
            self.withdraw(Flag.TISSUE_CHANGED)

    def fail(self) -> None:
        """Invalidate the site after an exception."""
        super().fail()
        self._estimator = None

    # The end of a contact

    @property
    def _ending(self) -> Estimator | None:
        """The estimator that has a final solution to find."""
        return self._estimator if self.usable_estimate is not None else None

    def begin_leaving(self) -> None:
        """Begin the final solution at the end of a contact."""
        if self._ending is not None:
            self._ending.begin_finish()

    @property
    def is_working(self) -> bool:
        """Whether the final solution is not complete."""
        return self._ending is not None and self._ending.is_working

    def work(self, seconds: float) -> None:
        """Continue the final solution by the work of a time in the air [s]."""
        if self._ending is not None:
            self._ending.work(seconds)

    def leave(self) -> None:
        """Complete the final solution of a contact."""
        estimator = self._ending
        if estimator is None:
            return
        estimator.finish()
        self.find(_checked(estimator.estimate()))
        off = estimator.rig_misfit / _CONTRADICTION
        if off > 1.0:
            self.doubt(Flag.RIG_PRIOR_CONFLICT, 1.0 + off**2)

    def budget(self) -> Budget | None:
        """Return what makes the estimate uncertain where it has not converged; None: not known."""
        estimate, estimator = self.usable_estimate, self._estimator
        if estimator is None or estimate is None or estimate.converged:
            return None
        return estimator.budget()


def _fractional_stress(memory: Array, config: PipelineConfig, estimate: Estimate | None) -> float:
    """Return D^-alpha of the stress at the newest alpha [Pa s^alpha]."""
    order = config.estimator.prior.fractional_order
    if estimate is not None:
        order = estimate.fractional_order
    return float(memory_weights(order) @ memory)


def _block(means: Means, memory: Array, start_ns: int, *, is_past: bool) -> Block:
    """Return a block for the estimator, its time counted from the site's first touch."""
    return Block(
        compression=means.compression,
        stress=means.stress,
        memory_time=0.5 * (means.start_ns + means.end_ns - 2 * start_ns) / NANOSECONDS,
        size=means.size,
        duration=means.duration,
        memory=memory,
        is_past=is_past,
    )


def prepare(config: PipelineConfig) -> None:
    """Import and compute what takes a moment, before the first touch."""
    config.geometry.compression(0.1)
    _new_estimator(config, 1.0, 1.0, 0.0)


def dips(duration_ns: int) -> bool:
    """Whether a probe that was off the tissue for this time may only have lifted off briefly."""
    return duration_ns < _DIP_TIME * NANOSECONDS


def _new_estimator(
    config: PipelineConfig, noise_sd: float, origin_sd: float, noise: float
) -> Estimator:
    geometry, variance = config.geometry, noise / config.geometry.length**2
    if config.estimator.kind is EstimatorKind.EKF:
        # filterpy takes as long to import as all the rest of the core.
        from fden_ros.core.paper_filter import PaperFilter

        return PaperFilter(config.estimator, geometry, noise_sd, origin_sd, variance)
    return PosteriorEstimator(config.estimator, geometry, noise_sd, origin_sd, variance)


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
        estimate.contact_point,
        estimate.contact_point_sd,
        float(estimate.covariance.sum()),
    )
    return estimate


def _check_finite(*numbers: float) -> None:
    if not math.isfinite(sum(numbers)):
        raise FloatingPointError(f"the estimate is not finite: {numbers}")
