# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is published of one contact: its flags, largest values, states and summary."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.core.block import BlockSums, ContactSample, PhaseMeter
from fden_ros.core.classification import Answer, Labeller, Labelling
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import Onset
from fden_ros.core.estimation import Estimate, log_stiffness
from fden_ros.core.law import ApparentStiffness, Geometry, log_stiffness_at
from fden_ros.core.oscillation import ComplexModulusMeter
from fden_ros.core.outputs import (
    WITHHELD,
    Classification,
    ContactSummary,
    DynamicModulus,
    Flag,
    Output,
    Phase,
    Signals,
    Status,
    TissueState,
    estimate_flags,
    order_source,
)
from fden_ros.core.plausibility import Plausibility
from fden_ros.core.site import Learned, Site
from fden_ros.core.streams import NANOSECONDS, Reason

#: Largest deviation of ln N/m by the law.
_MOST_SPREAD = 0.5


@dataclass(frozen=True)
class Common:
    """What all contacts share."""

    config: PipelineConfig
    rejected: Counter[str]  #: samples so far, by the reason
    labeller: Labeller
    plausibility: Plausibility  #: of each contact
    sums: BlockSums  #: of the present block


class Account:
    """What is published of one contact, from the touch on."""

    def __init__(self, contact_id: int, onset: Onset, site: Site, common: Common) -> None:
        config = common.config
        self.max_force = 0.0  #: the largest so far [N]
        self._contact_id, self._site = contact_id, site
        self._position, self._start_ns = onset.samples[0].position, onset.samples[0].stamp_ns
        self._common, self._config = common, config
        self._labelling = Labelling(common.labeller, site.site_id, self._start_ns)
        self._own_flags = Flag.NONE
        self._phase = PhaseMeter()
        frequencies, periods = config.dither_frequencies, config.dither_periods
        self._meter = ComplexModulusMeter(frequencies, periods) if frequencies else None
        self._max_strain = self._max_stress = 0.0  # [1, Pa]; the stress at the largest force
        self._deepest: float | None = None  # compression from the nominal origin [1]
        self._sample_count = 0
        self._rejected_before = common.rejected.total()
        self._rejected_after: int | None = None
        self._at_limit_before = _at_limit(common.rejected)

    @property
    def flags(self) -> Flag:
        """The flags of its site, and its own."""
        return self._own_flags | self._site.flags

    # Samples and blocks

    def take(self, sample: ContactSample, *, learns: bool) -> list[DynamicModulus]:
        """Add a sample; return the complex moduli that end with it.

        `learns`: the estimator uses it too.
        """
        self.count(sample.force)
        meter = self._meter
        if meter is None:
            return []
        if sample.is_free or not learns or self.flags & WITHHELD:
            meter.reset()
            return []
        strain = self._strain(sample.compression, self._site.estimate)
        elapsed = (sample.stamp_ns - self._start_ns) / NANOSECONDS
        return [
            DynamicModulus(
                stamp_ns=sample.stamp_ns,
                start_ns=self._start_ns + round(modulus.start * NANOSECONDS),
                site_id=self._site.site_id,
                contact_id=self._contact_id,
                modulus=modulus,
            )
            for modulus in meter.add(elapsed, strain, sample.stress)
        ]

    def count(self, force: float) -> None:
        """Count a sample of net force [N]."""
        self._sample_count += 1
        if force > self.max_force:
            self.max_force = force
            self._max_stress = force * self._config.geometry.stress_per_force

    def skip(self) -> None:
        """Handle missing samples."""
        self.see_missing()
        if self._meter is not None:
            self._meter.reset()

    def see_missing(self) -> None:
        """Flag it if the force's sensor was at its end, or stuck, where samples are missing."""
        if _at_limit(self._common.rejected) > self._at_limit_before:
            self._own_flags |= Flag.SATURATED

    def leave(self) -> None:
        """Count no more rejected samples: the probe has left."""
        self._rejected_after = self._common.rejected.total()

    def close_block(
        self, stamp_ns: int, block: Learned, *, learns: bool, is_silent: bool
    ) -> Iterator[Output]:
        """Add a block that ends at a stamp; yield its state and the label, if it is new.

        `learns`: the estimator used it too; `is_silent`: nothing is returned.
        """
        if block.innovation is not None:
            self._judge()
        phase = self._phase.add(stamp_ns, block.compression)
        if self._deepest is None or block.compression > self._deepest:
            self._deepest = block.compression
        usable = self._site.usable_estimate if learns else None
        strain = self._strain(block.compression, usable)
        self._max_strain = max(self._max_strain, strain)
        if learns:
            self.judge_units(stamp_ns)
        if is_silent:
            return
        live = self._site.live_estimate if learns else None
        state = self._state(stamp_ns, block, live, strain, phase)
        yield state if learns else replace(state, status=Status.UNKNOWN)
        answers = self._labelling.update(
            stamp_ns,
            self._site.usable_estimate if learns else None,
            self._max_strain,
            block=self._common.sums.number,
            has_changed=Flag.TISSUE_CHANGED in self.flags,
            is_mismatch=bool(self.flags & Flag.MODEL_MISMATCH),
        )
        for answer in answers:
            yield self._classification(stamp_ns, answer)

    def _judge(self) -> None:
        """Flag what the site's estimator has found since the touch."""
        # The newest judgement counts: an earlier one had seen less of the tissue.
        self._own_flags &= ~Flag.MODEL_MISMATCH
        if self._site.is_mismatch:
            self._own_flags |= Flag.MODEL_MISMATCH

    def judge_units(self, stamp_ns: int, *, is_over: bool = False) -> None:
        """Withhold the estimate of an implausible contact."""
        # From the touch, not from the estimate's origin.
        strain = self._config.geometry.strain(max(self._deepest or 0.0, 0.0))
        if self._common.plausibility.is_implausible(
            stamp_ns, strain, self.max_force, self._max_stress, is_over=is_over
        ):
            self._site.doubt(Flag.IMPLAUSIBLE)

    # Outputs

    def _strain(self, compression: float, estimate: Estimate | None) -> float:
        """Return the strain from the origin of an estimate [1]."""
        origin = estimate.contact_point if estimate is not None else 0.0
        return self._config.geometry.strain(compression - origin)

    def _stiffness(
        self, estimate: Estimate | None, compression: float | None, stress: float
    ) -> ApparentStiffness | None:
        """Return it about a compression [1] and stress [Pa]; None where the law does not hold."""
        if self._site.is_mismatch:
            return None
        geometry, time_scale = self._config.geometry, self._config.apparent_stiffness_time_scale
        return apparent_stiffness_of(estimate, geometry, compression, stress, time_scale)

    def _state(
        self, stamp_ns: int, block: Learned, estimate: Estimate | None, strain: float, phase: Phase
    ) -> TissueState:
        is_converged = estimate is not None and estimate.converged
        # Where the innovation test failed, N/m was wrong by a factor of up to 50.
        explained = None if self._site.is_doubtful else estimate
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.CONVERGED if is_converged else Status.CONVERGING,
            flags=self.flags | estimate_flags(estimate),
            site_id=self._site.site_id,
            contact_id=self._contact_id,
            phase=phase,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate.stated if estimate is not None else None,
            signals=Signals(strain, block.stress, block.fractional_stress),
            innovation=block.innovation,
            apparent_stiffness=self._stiffness(explained, block.compression, block.stress),
        )

    def unknown(self, stamp_ns: int) -> TissueState:
        """Return the state of a failed estimation."""
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.UNKNOWN,
            flags=self.flags,
            site_id=self._site.site_id,
            contact_id=self._contact_id,
            phase=Phase.NONE,
        )

    def _classification(self, stamp_ns: int, answer: Answer) -> Classification:
        return Classification(
            stamp_ns=stamp_ns,
            decision=answer.decision,
            site_id=self._site.site_id,
            contact_id=self._contact_id,
            flags=self.flags,
            classes=answer.classes,
            library_name=self._common.labeller.library_name,
            decided=answer.decided,
            comparison=answer.comparison,
        )

    def summary(self, end_ns: int, stamp_ns: int, *, complete: bool) -> ContactSummary:
        """Return the summary, made at `stamp_ns`, of the contact that ends at `end_ns`."""
        self._judge()
        estimate = self._site.usable_estimate
        answer = self._labelling.finish(end_ns, estimate, self._max_strain)
        after = self._rejected_after
        count = (self._common.rejected.total() if after is None else after) - self._rejected_before
        rejected = Flag.INPUT_REJECTED if count else Flag.NONE
        return ContactSummary(
            stamp_ns=stamp_ns,
            start_ns=self._start_ns,
            end_ns=end_ns,
            site_id=self._site.site_id,
            contact_id=self._contact_id,
            flags=self.flags | estimate_flags(estimate) | rejected,
            converged=estimate is not None and estimate.converged,
            complete=complete,
            position=self._position,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate.stated if estimate is not None else None,
            max_strain=self._max_strain,
            max_stress=self._max_stress,
            max_force=self.max_force,
            budget=self._site.budget(),
            sample_count=self._sample_count,
            rejected_count=count,
            classes=answer.classes,
            decided=answer.decided,
            comparison=answer.comparison,
            apparent_stiffness=self._stiffness(estimate, self._deepest, self._max_stress),
        )

    def second(self, first: ContactSummary, stamp_ns: int) -> ContactSummary:
        """Return an earlier summary with the present data of the site."""
        estimate = self._site.usable_estimate
        found = replace(
            first,
            stamp_ns=stamp_ns,
            flags=first.flags | self.flags,
            estimate=estimate,
            converged=estimate is not None and estimate.converged,
            order_source=order_source(estimate, self._config.estimator),
            apparent_stiffness=self._stiffness(estimate, self._deepest, self._max_stress),
        )
        if estimate is not None:
            return found
        self._common.labeller.forget(self._site.site_id)
        return replace(found, classes=None, decided=None, comparison=None)


def apparent_stiffness_of(
    estimate: Estimate | None, geometry: Geometry, u: float | None, stress: float, time: float
) -> ApparentStiffness | None:
    """Return N/m at an indentation ratio u [1] and stress [Pa] for a motion of `time` seconds.

    None while it is not known to half of its value, or the estimator has not settled.
    """
    if estimate is None or u is None or not estimate.is_settled:
        return None
    if estimate.small_motions:
        found = log_stiffness(estimate.small_motions, u, stress, time)
    else:
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = estimate.covariance
        covariance[3, :3] = covariance[:3, 3] = estimate.with_origin
        covariance[3, 3] = estimate.contact_point_sd**2
        own = u - estimate.contact_point
        found = log_stiffness_at(estimate.mean, covariance, geometry, own, time)
    if found is None or found[1] > _MOST_SPREAD**2 or found[0] > 50.0:
        return None
    value = math.exp(found[0])
    return ApparentStiffness(value, value * math.sqrt(found[1]), time)


def _at_limit(rejected: Counter[str]) -> int:
    """Return how many forces were rejected because the sensor was stuck or at its end."""
    return rejected[f"force.{Reason.STUCK}"] + rejected[f"force.{Reason.OUT_OF_RANGE}"]
