# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One place on the tissue: its strain origin, its memory and its estimator."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.block import ContactSample, Means
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import Onset
from fden_ros.core.estimation import (
    Budget,
    Estimate,
    Estimator,
    EstimatorKind,
    GridEstimator,
    Innovation,
    ParameterSet,
    Setting,
    Touch,
    stress_ahead,
)
from fden_ros.core.law import SHORTEST_STEP, StressMemory, memory_weights
from fden_ros.core.lift_off import KnownTissue, LiftOff
from fden_ros.core.noise_filter import LONGEST_FILTER
from fden_ros.core.origin import begins_at_origin, found_sd, origin_of
from fden_ros.core.outputs import Flag
from fden_ros.core.standing import Standing
from fden_ros.core.streams import BRIEF_NS, NANOSECONDS, Pair
from fden_ros.core.whereabouts import Whereabouts

#: A contact contradicts the stated rig where one of its quantities is off by more than this
#: many standard deviations: undisturbed rigs reach 1.8, a friction six times as large 2.7.
_CONTRADICTION = 2.5
#: Tissue has forgotten a press after a rest of this multiple of its duration. A press that takes
#: it to be at rest is then 0.4 % off in Gn where alpha is 0.13, and 1.3 % where it is 0.3; after a
#: rest as long as the press 9 % and 40 %.
_FORGOTTEN = 100.0


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
        self._is_pressed = False  #: the estimator's press is open
        self._pause = self._elapsed = 0.0  #: before the next touch, and since the last [s]
        self._pressed = 0.0  #: time in contact so far [s]
        #: Of the next block: times since the touch, indentations, stresses, on the tissue.
        self._samples: list[tuple[float, float, float, bool]] = []

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
        return estimate._replace(known=ParameterSet.NONE)

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law."""
        return self._estimator is not None and self._estimator.is_mismatch

    def _known(self) -> KnownTissue | None:
        """Return the tissue, where the estimate has converged and the law describes it."""
        estimate = self.usable_estimate
        if estimate is None or not estimate.converged or self.is_mismatch:
            return None
        return KnownTissue(estimate, self._memory, self._config.geometry)

    # Touch

    def is_elsewhere(self, onset: Onset) -> bool | None:
        """Whether a touch is at another site; None: no positions, and after the timeout."""
        first, config = onset.samples[0], self._config.site
        if (is_apart := self.whereabouts.is_apart(first.position)) is not None:
            return is_apart
        if config.without_position != "either":
            return config.without_position == "other"
        is_late = self._seconds_to(first.stamp_ns) > config.timeout
        return None if is_late else False

    @property
    def misses_samples(self) -> bool:
        """Whether a part of a press was not measured."""
        return bool(self.flags & (Flag.GAP | Flag.SATURATED))

    def misses_past(self, stamp_ns: int) -> bool:
        """Whether what was not measured still matters at a stamp."""
        return self.misses_samples and self._seconds_to(stamp_ns) < _FORGOTTEN * self._pressed

    def begins_anew(self, stamp_ns: int) -> bool:
        """Whether a touch here makes a new site, which takes the tissue to be at rest."""
        if Flag.TISSUE_CHANGED in self.flags:
            return True
        if not self.misses_samples:
            return False
        if self.is_observed:
            return not self.misses_past(stamp_ns)
        return self._seconds_to(stamp_ns) >= self._pressed

    def put_away(self) -> None:
        """End the press that is open: the probe is elsewhere."""
        if self._estimator is not None and self._is_pressed:
            self._is_pressed = False
            self._estimator.release()

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
        self._lift_off = LiftOff(onset, scale, is_first=is_first)
        if onset.filter_time > LONGEST_FILTER:
            self.withdraw(Flag.MODEL_MISMATCH)
        elif onset.filter_time > _CONTRADICTION * config.estimator.uncertainty.delay_sd > 0.0:
            self.doubt(Flag.RIG_PRIOR_CONFLICT)
        if self.is_observed and self._estimator is None:
            noise_sd, origin_sd = onset.noise_sd * scale, self.origin_sd
            new = _new_estimator(_filtered(config, onset), noise_sd, origin_sd, noise)
            if before is not None and before.is_elsewhere(onset) is None:
                before.may_go_on_as(new, onset, self)
            self._estimator = new
        self._rest_until(first.stamp_ns)
        self._memory.begin_block()
        if self._estimator is not None:
            self.put_away()
            times, way, forces = onset.way
            seen = (times, (way - self.origin) / config.geometry.length, scale * forces)
            zero = onset.bias_sd * scale, onset.drift_sd * scale
            self._estimator.touch(Touch(*zero, np.array(seen)), self._pause)
            self._is_pressed, self._pause, self._elapsed = True, 0.0, 0.0
            self._samples.clear()

    def may_go_on_as(self, new: Estimator, onset: Onset, other: Site) -> None:
        """Pass this tissue to the estimator of another site, of tissue at rest: they may be one.

        A later touch here continues from the knowledge of this site.
        """
        own = self._estimator if self.is_observed else None
        if not (isinstance(own, GridEstimator) and isinstance(new, GridEstimator)):
            return
        other._pause = self._pause + self._pause_until(onset.samples[0].stamp_ns)
        shift = (other.origin - self.origin) / self._config.geometry.length
        found = found_sd(onset, self._config)
        wider = math.log(other.origin_sd / found) if other.origin_sd and found else 0.0
        new.may_continue(own, shift, wider)

    def _rest_until(self, stamp_ns: int) -> None:
        """Let the tissue relax free of stress since the last sample in contact."""
        pause = self._pause_until(stamp_ns)
        if not pause:
            return
        self._memory.rest(pause)
        self._pause += pause
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
            self._elapsed += step
            self._samples.append((self._elapsed, compression, stress, not is_off))
        self._pressed += step
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
        weights = _memory_weights(self._config, self.estimate)
        fractional_stress = float(weights @ memory)
        if learns and self.is_observed and self._estimator is not None:
            self._lift_off.see_mean(means.force)
            samples = zip(*self._samples, strict=True)
            estimate = self._estimator.add(*samples, is_behind=is_silent)
            self._samples.clear()
            found = None if means.has_free else self._estimator.innovation
            if found is not None:
                _check_finite(found.innovation, found.variance)
                # The stress before is measured: the newest alone differs from its prediction.
                predicted = fractional_stress - float(weights[-1]) * found.innovation
                innovation = found._replace(predicted_fractional_stress=predicted)
            if self._estimator.is_changed:
                self.withdraw(Flag.TISSUE_CHANGED)
            if not is_silent or self.estimate is None:
                self.find(_checked(estimate))
        return Learned(means.compression, means.stress, fractional_stress, innovation)

    def force_ahead(self, times: Array, displacements: Array) -> tuple[Array, Array] | None:
        """Return mean and deviation of the force of a motion to come; None: it is not known."""
        estimate, geometry = self.live_estimate, self._config.geometry
        if estimate is None or not estimate.small_motions or not estimate.is_settled:
            return None
        indentations = (displacements - self.origin) / geometry.length
        mean, variance = stress_ahead(estimate.small_motions, times, indentations)
        scale = geometry.stress_per_force
        return np.maximum(mean, 0.0) / scale, np.sqrt(variance) / scale

    def fail(self) -> None:
        """Invalidate the site after an exception."""
        super().fail()
        self._estimator = None

    # The end of a contact

    def work(self) -> None:
        """Do what the newest block has made due, once its state is published."""
        if self._estimator is not None:
            self._estimator.work()

    def settle(self) -> None:
        """Do a part of what the end of a contact takes."""
        if self._estimator is not None and self._is_pressed:
            self._estimator.settle()

    def leave(self) -> None:
        """Bring the estimate to its best at the end of a contact."""
        estimator = self._estimator
        if estimator is None or not self._is_pressed:
            return
        self._is_pressed = False
        estimate = estimator.release()
        if self.usable_estimate is None:
            return
        self.find(_checked(estimate))
        off = estimator.rig_misfit / _CONTRADICTION
        if off > 1.0:
            self.doubt(Flag.RIG_PRIOR_CONFLICT, 1.0 + off**2)

    def budget(self) -> Budget | None:
        """Return what makes the estimate uncertain where it has not converged; None: not known."""
        estimate, estimator = self.usable_estimate, self._estimator
        if estimator is None or estimate is None or estimate.converged:
            return None
        return estimator.budget()


def _memory_weights(config: PipelineConfig, estimate: Estimate | None) -> Array:
    """Return the weights of the memory at the newest alpha."""
    order = config.estimator.prior.fractional_order
    return memory_weights(estimate.fractional_order if estimate is not None else order)


def prepare(config: PipelineConfig) -> None:
    """Import and compute what takes a moment, before the first touch."""
    config.geometry.compression(0.1)
    _new_estimator(config, 1.0, 1.0, 0.0)


def dips(duration_ns: int) -> bool:
    """Whether a probe that was off the tissue for this time may only have lifted off briefly."""
    return duration_ns < BRIEF_NS


def _filtered(config: PipelineConfig, onset: Onset) -> PipelineConfig:
    """Return a configuration whose delay is as uncertain as a filter of the force makes it."""
    if not onset.filter_time:
        return config
    unsure = config.estimator.uncertainty
    unsure = replace(unsure, delay_sd=math.hypot(unsure.delay_sd, onset.filter_time))
    return replace(config, estimator=replace(config.estimator, uncertainty=unsure))


def _new_estimator(
    config: PipelineConfig, noise_sd: float, origin_sd: float, noise: float
) -> Estimator:
    variance = noise / config.geometry.length**2
    setting = Setting(config.estimator, config.geometry, noise_sd, origin_sd, variance)
    if config.estimator.kind is EstimatorKind.EKF:
        # filterpy takes as long to import as all the rest of the core.
        from fden_ros.core.paper_filter import PaperFilter

        return PaperFilter(setting)
    return GridEstimator(setting)


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
