# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One press of a site, from onset to release: from its samples to what is put out."""

from __future__ import annotations

import itertools
import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from fden_ros.core.apparent_stiffness import apparent_stiffness_of
from fden_ros.core.block import BlockSums, ContactSample, PhaseMeter
from fden_ros.core.classification.labelling import Answer, Evidence, Labeller, Labelling
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.oscillation.complex_modulus import ComplexModulusMeter
from fden_ros.core.outputs import (
    WITHHELD,
    ApparentStiffness,
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
from fden_ros.core.streams.guard import force_at_limit
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: A first contact that stays below this multiple of the release force is faint.
_FAINT = 4.0
#: Samples from before the detection of a touch are made up for within about this time [s].
_CATCH_UP_TIME = 0.03


@dataclass(frozen=True)
class Common:
    """What all presses share.

    Attributes
    ----------
    config : PipelineConfig
    rejected : collections.Counter
        Counts of rejected samples so far.
    labeller : Labeller
    plausibility : Plausibility
        Judges each contact.
    sums : BlockSums
        Of the present block.
    """

    config: PipelineConfig
    rejected: Counter[str]
    labeller: Labeller
    plausibility: Plausibility
    sums: BlockSums


class _Oscillation:
    """Complex moduli of a press, where the probe oscillates."""

    def __init__(self, contact_id: int, site: Site, start_ns: int, config: PipelineConfig) -> None:
        self._contact_id, self._site, self._start_ns = contact_id, site, start_ns
        self._geometry = config.geometry
        frequencies, periods = config.dither_frequencies, config.dither_periods
        self._meter = ComplexModulusMeter(frequencies, periods) if frequencies else None

    def interrupt(self) -> None:
        """Begin anew: samples are missing, or do not count."""
        if self._meter is not None:
            self._meter.reset()

    def moduli(self, sample: ContactSample, *, is_withheld: bool) -> list[DynamicModulus]:
        """Return the complex moduli that end with a sample."""
        if self._meter is None:
            return []
        if sample.is_free or is_withheld:
            self.interrupt()
            return []
        estimate = self._site.estimate
        origin = estimate.strain_origin if estimate is not None else 0.0
        strain = self._geometry.strain(sample.compression - origin)
        elapsed = (sample.stamp_ns - self._start_ns) / NANOSECONDS
        return [
            DynamicModulus(
                stamp_ns=sample.stamp_ns,
                start_ns=self._start_ns + round(modulus.start * NANOSECONDS),
                site_id=self._site.site_id,
                contact_id=self._contact_id,
                modulus=modulus,
            )
            for modulus in self._meter.add(elapsed, strain, sample.stress)
        ]


class Press:
    """One contact.

    Parameters
    ----------
    contact_id : int
    onset : Onset
    site : Site
    release_force : float
        Force below which the probe is no longer pressing [N].
    common : Common

    Attributes
    ----------
    has_ended : bool
        It has been reported, after a gap or a failure; the probe has not left yet.
    """

    def __init__(
        self, contact_id: int, onset: Onset, site: Site, release_force: float, common: Common
    ) -> None:
        config, first = common.config, onset.samples[0]
        self.contact_id, self.onset, self.site = contact_id, onset, site
        self.start_ns = first.stamp_ns
        self.flags = site.flags
        self.has_ended = False
        self._common, self._config = common, config
        self._labelling = Labelling(
            common.labeller, site.site_id, site.position, self.start_ns, site.change_count
        )
        self._release_force = release_force
        self._behind: deque[Pair] = deque()  # samples that are not taken yet
        self._pace = 1
        self._phase = PhaseMeter()
        self._oscillation = _Oscillation(contact_id, site, self.start_ns, config)
        #: The largest so far [1, Pa, N]; the stress is that at the largest force.
        self._max_strain = self._max_stress = self._max_force = 0.0
        self._deepest: float | None = None  # compression from the nominal origin [1]
        self._sample_count = 0
        self._changes_before = site.change_count
        self._rejected_before = common.rejected.total()
        self._rejected_after: int | None = None
        self._at_limit_before = force_at_limit(common.rejected)

    @property
    def has_failed(self) -> bool:
        """Whether the computation failed, here or before at this site."""
        return bool(self.flags & Flag.ESTIMATION_FAILED)

    @property
    def _is_withheld(self) -> bool:
        """Whether nothing is said that carries no flag."""
        return self.has_ended or bool(self.flags & WITHHELD)

    @property
    def is_faint(self) -> bool:
        """Whether it is the site's first, below 4 release forces: perhaps noise."""
        is_first = self.start_ns == self.site.start_ns
        return is_first and self._max_force < _FAINT * self._release_force

    # Samples

    def begin(self, noise: float) -> Iterator[Output]:
        """Begin on the site; the samples from before the detection are made up for."""
        samples, common = self.onset.samples, self._common
        if not self.has_failed:
            self.site.touch(self.onset, self._release_force, noise)
        common.plausibility.begin(self.onset)
        common.sums.restart(self.start_ns)
        if self.has_failed:
            return
        self._behind.extend(samples)
        # As many samples at a time that a touch delays no later sample for long.
        lasted = (samples[-1].stamp_ns - self.start_ns) / NANOSECONDS
        self._pace = 1 + math.ceil(lasted / _CATCH_UP_TIME)
        yield from self._catch_up(self._pace)

    def take(self, pair: Pair) -> Iterable[Output]:
        """Take a sample."""
        if self.has_failed:
            return self._pass(pair)
        if not self._behind:
            return self._follow(pair)
        self._behind.append(pair)
        return self._catch_up(self._pace)

    def _catch_up(self, count: int) -> Iterator[Output]:
        """Take samples that wait since the touch; only of the newest an output is made.

        States of the time before the detection would contradict those put out then, in the air.
        """
        behind = self._behind
        for _ in range(min(count, len(behind))):
            pair = behind.popleft()
            yield from self._follow(pair, is_silent=bool(behind))

    def _follow(self, pair: Pair, *, is_silent: bool = False) -> Iterable[Output]:
        elapsed = (pair.stamp_ns - self.start_ns) / NANOSECONDS
        force = pair.force - self.onset.bias - self.onset.drift * elapsed
        sample = self.site.follow(pair, force, learns=not self.has_ended)
        moduli = self._oscillation.moduli(sample, is_withheld=self._is_withheld)
        self._count(force)
        outputs: Iterable[Output] = () if is_silent else moduli
        if not self._common.sums.take(sample):
            return outputs
        return itertools.chain(outputs, self._close_block(pair.stamp_ns, is_silent=is_silent))

    def _count(self, force: float) -> None:
        """Count a sample of net force [N]."""
        self._sample_count += 1
        if force > self._max_force:
            self._max_force = force
            self._max_stress = force * self._config.geometry.stress_per_force

    def _pass(self, pair: Pair) -> Iterator[Output]:
        """Let a sample of a contact go by in which the estimation failed."""
        self._count(pair.force - self.onset.bias)
        if self._common.sums.passes(pair.stamp_ns):
            yield TissueState(
                stamp_ns=pair.stamp_ns,
                status=Status.UNKNOWN,
                flags=self.flags,
                site_id=self.site.site_id,
                contact_id=self.contact_id,
                phase=Phase.NONE,
            )

    # Blocks

    def _close_block(self, stamp_ns: int, *, is_silent: bool) -> Iterator[Output]:
        means = self._common.sums.close(stamp_ns)
        block = self.site.learn(means, learns=not self.has_ended, is_silent=is_silent)
        self.flags |= self.site.flags & Flag.ORIGIN_UNCERTAIN
        if block.innovation is not None:
            self._judge()
        phase = self._phase.add(stamp_ns, block.compression)
        if self._deepest is None or block.compression > self._deepest:
            self._deepest = block.compression
        signals = self._signals(block)
        self._judge_units(stamp_ns)
        if is_silent:
            return
        yield self._state(stamp_ns, block, signals, phase)
        evidence = Evidence(
            stamp_ns=stamp_ns,
            block=self._common.sums.number,
            estimate=self._estimate,
            max_strain=self._max_strain,
            change_count=self.site.change_count,
            is_mismatch=bool(self.flags & Flag.MODEL_MISMATCH),
        )
        for answer in self._labelling.update(evidence):
            yield self._classification(stamp_ns, answer)

    def _judge(self) -> None:
        """Flag what the site's estimator has found since the touch."""
        if self.site.change_count > self._changes_before:
            self.flags |= Flag.TISSUE_CHANGED
        # The newest judgement counts: an earlier one had seen less of the tissue.
        self.flags &= ~Flag.MODEL_MISMATCH
        if self.site.is_mismatch:
            self.flags |= Flag.MODEL_MISMATCH
        self.flags |= self.site.flags & Flag.HYSTERESIS

    def _judge_units(self, stamp_ns: int, *, is_over: bool = False) -> None:
        """Withhold the estimate of a contact that cannot be what its units say."""
        if self.has_ended:
            return
        # From where the touch was found, not from the estimate's origin.
        strain = self._config.geometry.strain(max(self._deepest or 0.0, 0.0))
        if self._common.plausibility.is_implausible(
            stamp_ns, strain, self._max_force, self._max_stress, is_over=is_over
        ):
            self.flags |= Flag.IMPLAUSIBLE
            self.site.doubt(Flag.IMPLAUSIBLE)

    # Interruption and end

    def see_gap(self) -> None:
        """Take note that samples are missing before the next."""
        self._see_missing()
        self.flags |= Flag.GAP
        self.site.flags |= Flag.GAP
        self._oscillation.interrupt()

    def _see_missing(self) -> None:
        """Flag it if the force's sensor was at its end, or stuck, where samples are missing."""
        if force_at_limit(self._common.rejected) > self._at_limit_before:
            self.flags |= Flag.SATURATED

    def take_all(self) -> Iterator[Output]:
        """Take every sample that waits."""
        return self._catch_up(len(self._behind))

    def begin_end(self) -> None:
        """Begin to make the summary, at the release."""
        self._rejected_after = self._common.rejected.total()
        self.site.begin_leaving()

    def end(self, end_ns: int, stamp_ns: int, *, complete: bool) -> ContactSummary:
        """Return the summary, made at `stamp_ns`, of the contact that has ended."""
        self.site.leave()
        self._judge_units(end_ns, is_over=True)
        if not complete:
            self._see_missing()
        return self._summary(end_ns, stamp_ns, complete=complete)

    def fail(self, stamp_ns: int) -> Iterator[ContactSummary]:
        """End the contact with an exception; the summary comes if it has not come before."""
        self._behind.clear()
        self.flags |= Flag.ESTIMATION_FAILED
        if not self.has_ended:
            yield self._summary(stamp_ns, stamp_ns, complete=False)

    # Outputs

    @property
    def _estimate(self) -> Estimate | None:
        return self.site.usable_estimate if not self.has_ended else None

    def _signals(self, block: Learned) -> Signals:
        """Return a block's means, the strain from the estimate's origin, and keep the largest."""
        estimate = self._estimate
        origin = estimate.strain_origin if estimate is not None else 0.0
        strain = self._config.geometry.strain(block.compression - origin)
        self._max_strain = max(self._max_strain, strain)
        return Signals(strain, block.stress, block.fractional_stress)

    def _state(self, stamp_ns: int, block: Learned, signals: Signals, phase: Phase) -> TissueState:
        estimate = self.site.live_estimate if not self.has_ended else None
        is_converged = estimate is not None and estimate.converged
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.CONVERGED if is_converged else Status.CONVERGING,
            flags=self.flags | estimate_flags(estimate),
            site_id=self.site.site_id,
            contact_id=self.contact_id,
            phase=phase,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate.stated if estimate is not None else None,
            signals=signals,
            innovation=block.innovation,
            apparent_stiffness=self._stiffness(estimate, block.compression, block.stress),
        )

    def _stiffness(
        self, estimate: Estimate | None, compression: float | None, stress: float
    ) -> ApparentStiffness | None:
        """Return it about a compression [1] and stress [Pa]; None while not known."""
        config = self._config
        time_scale = config.apparent_stiffness_time_scale
        geometry = config.geometry
        return apparent_stiffness_of(estimate, geometry, compression, stress, time_scale)

    def _classification(self, stamp_ns: int, answer: Answer) -> Classification:
        return Classification(
            stamp_ns=stamp_ns,
            decision=answer.decision,
            site_id=self.site.site_id,
            contact_id=self.contact_id,
            flags=self.flags,
            classes=answer.classes,
            library_name=self._common.labeller.library_name,
            decided=answer.decided,
            comparison=answer.comparison,
        )

    def _summary(self, end_ns: int, stamp_ns: int, *, complete: bool) -> ContactSummary:
        self._judge()
        self.has_ended = True
        estimate = self.site.usable_estimate
        answer = self._labelling.finish(end_ns, estimate, self._max_strain)
        after = self._rejected_after
        count = (self._common.rejected.total() if after is None else after) - self._rejected_before
        rejected = Flag.INPUT_REJECTED if count else Flag.NONE
        return ContactSummary(
            stamp_ns=stamp_ns,
            start_ns=self.start_ns,
            end_ns=end_ns,
            site_id=self.site.site_id,
            contact_id=self.contact_id,
            flags=self.flags | estimate_flags(estimate) | rejected,
            converged=estimate is not None and estimate.converged,
            complete=complete,
            position=self.onset.samples[0].position,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate.stated if estimate is not None else None,
            max_strain=self._max_strain,
            max_stress=self._max_stress,
            max_force=self._max_force,
            budget=self.site.budget(),
            sample_count=self._sample_count,
            rejected_count=count,
            classes=answer.classes,
            decided=answer.decided,
            comparison=answer.comparison,
            apparent_stiffness=self._stiffness(estimate, self._deepest, self._max_stress),
        )
