# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One press of a site, from onset to release."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

from fden_ros.core.block import Means
from fden_ros.core.classification.labelling import Answer, Evidence, Labeller, Labelling
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.estimate import Estimate, ParameterSet
from fden_ros.core.estimation.estimator import Block, Innovation
from fden_ros.core.oscillation.complex_modulus import ComplexModulusMeter
from fden_ros.core.outputs import (
    WITHHELD,
    ApparentStiffness,
    Classification,
    ContactSummary,
    DynamicModulus,
    Flag,
    Phase,
    Signals,
    Status,
    TissueState,
    apparent_stiffness_of,
    estimate_flags,
    order_source,
)
from fden_ros.core.site import Site
from fden_ros.core.streams.guard import force_at_limit
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: Multiples of the release force: beyond the first the probe meets the tissue (it leaves it below
#: 1, so that noise does neither); a first contact that stays below the second is faint.
_CLEAR, _FAINT = 2.0, 4.0
#: A probe has moved back, or in again, when it has by this share of its compression [1].
_RETREAT = 0.02


class Press:
    """What one contact has of its own.

    Parameters
    ----------
    contact_id : int
    onset : Onset
    site : Site
    release_force : float
        Force below which the probe is no longer pressing [N].
    rejected : Counter
        Counts of rejected samples so far.
    labeller : Labeller
    config : PipelineConfig

    Attributes
    ----------
    has_ended : bool
        It has been reported, after a gap or a failure; the probe has not left yet.
    max_strain, max_stress, max_force : float
        The largest so far [1, Pa, N]; the stress is that at the largest force.
    """

    def __init__(
        self,
        contact_id: int,
        onset: Onset,
        site: Site,
        release_force: float,
        rejected: Counter[str],
        labeller: Labeller,
        config: PipelineConfig,
    ) -> None:
        first = onset.samples[0]
        self.contact_id = contact_id
        self.start_ns = first.stamp_ns
        self.position = first.position
        self.flags = site.flags
        self.has_ended = False
        self.max_strain = self.max_stress = self.max_force = 0.0
        self.sample_count = 0
        self._deepest: float | None = None  # compression from the nominal origin [1]
        self._config = config
        self._site = site
        self._library_name = labeller.library_name
        self._labelling = Labelling(labeller, site.site_id, site.position, self.start_ns)
        self._bias, self._drift = onset.bias, onset.drift
        self._release_force = release_force
        self._is_first = first.stamp_ns == site.start_ns
        self._is_pressed = False
        self._is_free = True
        #: Least compression since the tissue let go of the probe.
        self._lowest = math.inf
        #: Compression and force of the newest sample whose force noise does not make, the time
        #: since, and the compression at which the tissue stayed behind.
        self._pressed: tuple[float, float] | None = None
        self._since_pressed = 0.0
        self._left_at: float | None = None
        self._changes_before = 0
        self._rejected_before = rejected.total()
        self._at_limit_before = force_at_limit(rejected)

    def begin(self, change_count: int) -> None:
        """Begin with a site whose tissue has changed `change_count` times before."""
        self._changes_before = change_count
        self._labelling.begin(change_count)

    @property
    def is_faint(self) -> bool:
        """Whether it is the site's first, below 4 release forces: perhaps noise."""
        return self._is_first and self.max_force < _FAINT * self._release_force

    @property
    def nominal_strain(self) -> float:
        """Largest strain so far from where the touch was found, not from the estimate's origin."""
        return self._config.geometry.strain(max(self._deepest or 0.0, 0.0))

    def net_force(self, pair: Pair, *, drifts: bool = True) -> float:
        """Return the force less its bias and, unless `drifts` is False, its drift [N]."""
        if not drifts:
            return pair.force - self._bias
        elapsed = (pair.stamp_ns - self.start_ns) / NANOSECONDS
        return pair.force - self._bias - self._drift * elapsed

    def count(self, force: float) -> None:
        """Count a sample of net force [N]."""
        self.sample_count += 1
        if force > self.max_force:
            self.max_force = force
            self.max_stress = force * self._config.geometry.stress_per_force

    def leaves_tissue(self, step: float, force: float, compression: float) -> bool:
        """Whether the tissue has left the probe, or has not met it yet, at the next sample.

        The first touch says where the origin is, so there the law holds from the origin on; later
        ones meet a surface that still recovers.
        """
        site, clear = self._site, _CLEAR * self._release_force
        hidden = 2.0 * clear if self._is_free else clear
        self._since_pressed += step
        if self._is_first and not self._is_pressed:
            self._is_free = False
        elif step > 0.0 and site.is_known and abs(force) <= hidden:
            # Where noise hides the force, the law says where the surface is.
            self._is_free = self._is_hidden_free(step, compression)
        elif self._is_free:
            self._is_free = force <= clear
        else:
            self._is_free = force <= self._release_force and self._has_retreated(compression)
        if force > clear:
            self._since_pressed, self._pressed, self._left_at = 0.0, (compression, force), None
        self._lowest = min(self._lowest, compression) if self._is_free else math.inf
        return self._is_free

    def _is_hidden_free(self, step: float, compression: float) -> bool:
        """Whether the law says that the tissue is off the probe, where noise hides the force.

        It knows the stress to a few deviations of the noise, not to none: near the surface it
        would change its mind from sample to sample, and each time the memory would take what noise
        makes for a touch or a release. So the probe has to move on: back since the last force that
        noise does not make, or in again since the tissue let go.
        """
        if self._is_free and not self._has_returned(compression):
            return True
        if self._is_left_behind(compression):
            return True
        is_settled = self._is_free or self._has_retreated(compression)
        return is_settled and self._site.is_above_surface(step, compression)

    def _has_returned(self, compression: float) -> bool:
        """Whether the probe has moved in again since the tissue let go of it."""
        return compression > self._lowest + _RETREAT * abs(self._lowest)

    def _has_retreated(self, compression: float) -> bool:
        """Whether the probe has moved back since a force that noise does not make.

        Tissue leaves no probe that holds still; to drop the samples of a hold that noise makes
        small would leave those that it makes large.
        """
        if self._pressed is None:
            return True
        before = self._pressed[0]
        return compression < before - _RETREAT * abs(before)

    def _is_left_behind(self, compression: float) -> bool:
        """Whether the tissue would pull, from the last force that noise does not make.

        The law of that motion alone says where the tissue stays behind; by the whole past a
        stiffness one percent too low finds the surface two percent of the depth too far out.
        """
        if self._pressed is None:
            return False
        if self._left_at is None:
            before, force = self._pressed
            by_stress = self._config.geometry.stress_per_force
            stress = force * by_stress + self._site.change_of_stress(
                before, compression, self._since_pressed
            )
            if stress < -_CLEAR * self._release_force * by_stress:
                self._left_at = compression
        return self._left_at is not None and compression <= self._left_at

    def is_informative(self, means: Means, *, by_stress: bool) -> bool:
        """Whether the law holds for a block: not behind the surface, nor while letting go.

        `by_stress`: the stress is observed, not the fractional stress, which needs the compression
        to be above the origin's deviation as well.
        """
        if by_stress:
            self._is_pressed |= means.force > _CLEAR * self._release_force
            return not means.has_free
        return means.force > self._release_force and means.compression > self._site.origin_sd

    def judge(self) -> None:
        """Flag what the site's estimator has found since the touch."""
        if self._site.change_count > self._changes_before:
            self.flags |= Flag.TISSUE_CHANGED
        # The newest judgement counts: an earlier one had seen less of the tissue.
        self.flags &= ~Flag.MODEL_MISMATCH
        if self._site.is_mismatch:
            self.flags |= Flag.MODEL_MISMATCH
        self.flags |= self._site.flags & Flag.HYSTERESIS

    def see_missing(self, rejected: Counter[str]) -> None:
        """Flag it if the force's sensor was at its end, or stuck, where samples are missing."""
        if force_at_limit(rejected) > self._at_limit_before:
            self.flags |= Flag.SATURATED

    # Outputs

    @property
    def _estimate(self) -> Estimate | None:
        return self._site.usable_estimate if not self.has_ended else None

    def signals(self, block: Block, fractional_stress: float) -> Signals:
        """Return a block's means, the strain from the estimate's origin, and keep the largest."""
        strain = self._config.geometry.strain(block.compression - self._origin())
        self.max_strain = max(self.max_strain, strain)
        if self._deepest is None or block.compression > self._deepest:
            self._deepest = block.compression
        return Signals(strain, block.stress, fractional_stress)

    def _origin(self) -> float:
        estimate = self._estimate
        return estimate.strain_origin if estimate is not None else 0.0

    def state(
        self,
        stamp_ns: int,
        signals: Signals,
        compression: float,
        phase: Phase,
        innovation: Innovation | None,
    ) -> TissueState:
        """Return the state after a block."""
        config, estimate = self._config, self._estimate
        if estimate is not None and self._site.is_doubtful:
            estimate = estimate._replace(known=ParameterSet.NONE)
        return TissueState(
            stamp_ns=stamp_ns,
            status=(
                Status.CONVERGED
                if estimate is not None and estimate.converged
                else Status.CONVERGING
            ),
            flags=self.flags | estimate_flags(estimate),
            site_id=self._site.site_id,
            contact_id=self.contact_id,
            phase=phase,
            order_source=order_source(estimate, config.estimator),
            estimate=estimate,
            signals=signals,
            innovation=innovation,
            apparent_stiffness=self._apparent_stiffness(estimate, compression),
        )

    def _apparent_stiffness(
        self, estimate: Estimate | None, compression: float | None
    ) -> ApparentStiffness | None:
        """Return it about a compression from the nominal origin [1]; None while not known."""
        if estimate is None or compression is None:
            return None
        return apparent_stiffness_of(
            estimate,
            self._config.geometry,
            compression - estimate.strain_origin,
            self._config.apparent_stiffness_time_scale,
        )

    def failed_state(self, stamp_ns: int) -> TissueState:
        """Return the state of a contact in which the estimation failed."""
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.UNKNOWN,
            flags=self.flags,
            site_id=self._site.site_id,
            contact_id=self.contact_id,
            phase=Phase.NONE,
        )

    def label(self, stamp_ns: int, block: int) -> Iterator[Answer]:
        """Give what is to be said of the tissue after the block of a number."""
        evidence = Evidence(
            stamp_ns=stamp_ns,
            block=block,
            estimate=self._estimate,
            max_strain=self.max_strain,
            change_count=self._site.change_count,
            is_mismatch=bool(self.flags & Flag.MODEL_MISMATCH),
        )
        return self._labelling.update(evidence)

    def classification(self, stamp_ns: int, answer: Answer) -> Classification:
        """Return an answer as an output."""
        return Classification(
            stamp_ns=stamp_ns,
            decision=answer.decision,
            site_id=self._site.site_id,
            contact_id=self.contact_id,
            flags=self.flags,
            classes=answer.classes,
            library_name=self._library_name,
            decided=answer.decided,
            comparison=answer.comparison,
        )

    def moduli(
        self,
        meter: ComplexModulusMeter,
        stamp_ns: int,
        compression: float,
        stress: float,
        is_free: bool,
    ) -> list[DynamicModulus]:
        """Return the complex moduli that end with a sample."""
        if is_free or self.has_ended or self.flags & WITHHELD:
            # A modulus carries no flag.
            meter.reset()
            return []
        estimate = self._site.estimate
        origin = estimate.strain_origin if estimate is not None else 0.0
        strain = self._config.geometry.strain(compression - origin)
        elapsed = (stamp_ns - self.start_ns) / NANOSECONDS
        return [
            DynamicModulus(
                stamp_ns=stamp_ns,
                start_ns=self.start_ns + round(modulus.start * NANOSECONDS),
                site_id=self._site.site_id,
                contact_id=self.contact_id,
                modulus=modulus,
            )
            for modulus in meter.add(elapsed, strain, stress)
        ]

    def summary(self, end_ns: int, rejected: Counter[str], *, complete: bool) -> ContactSummary:
        """End the contact and return its summary."""
        self.judge()
        self.has_ended = True
        estimate = self._site.usable_estimate
        answer = self._labelling.finish(end_ns, estimate, self.max_strain)
        count = rejected.total() - self._rejected_before
        return ContactSummary(
            stamp_ns=end_ns,
            start_ns=self.start_ns,
            end_ns=end_ns,
            site_id=self._site.site_id,
            contact_id=self.contact_id,
            flags=self.flags
            | estimate_flags(estimate)
            | (Flag.INPUT_REJECTED if count else Flag.NONE),
            converged=estimate is not None and estimate.converged,
            complete=complete,
            position=self.position,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate,
            max_strain=self.max_strain,
            max_stress=self.max_stress,
            max_force=self.max_force,
            sample_count=self.sample_count,
            rejected_count=count,
            classes=answer.classes,
            decided=answer.decided,
            comparison=answer.comparison,
            apparent_stiffness=self._apparent_stiffness(estimate, self._deepest),
        )
