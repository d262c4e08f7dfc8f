# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One contact of a site: from its samples to what is put out, and the states it goes through."""

from __future__ import annotations

import enum
import itertools
import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from fden_ros.core.air_after import AirAfter
from fden_ros.core.apparent_stiffness import apparent_stiffness_of
from fden_ros.core.block import BlockSums, ContactSample, PhaseMeter
from fden_ros.core.classification.labelling import Answer, Evidence, Labeller, Labelling
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.learned_scales import Evidence as DriftEvidence
from fden_ros.core.estimation.learned_scales import drift_evidence
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
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
from fden_ros.core.site import Learned, Site, SiteState
from fden_ros.core.streams.guard import force_at_limit
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: A first contact that stays below this multiple of the release force is faint.
_FAINT = 4.0
#: Samples from before the detection of a touch are backfilled within about this time [s].
_CATCH_UP_TIME = 0.03
#: A summary is given this long after the release [ns], where the last solution has been found by
#: then, and at the latest after this [ns]: what is left of it is done at once.
_SUMMARY_AFTER_NS, _SUMMARY_BY_NS = 4 * NANOSECONDS // 10, 8 * NANOSECONDS // 10
#: The air behind is judged 1 s after the release [ns], and 0.15 s after it was averaged [ns]: a
#: slow contact that begins before is known by then.
_JUDGED_AFTER_NS, _AVERAGED_BEFORE_NS = NANOSECONDS, 150_000_000
#: It contradicts the air before the contact beyond this many stated standard deviations.
_CONTRADICTION = 5.0
#: Of the summary of a contact that is withdrawn.
_NO_LABEL: dict[str, Any] = {"classes": None, "decided": None, "comparison": None}


class State(enum.Enum):
    """What a contact is at."""

    BACKFILL = "samples from before the detection are backfilled"
    PRESSING = "each block gives a state"
    RELEASED = "the last solution is under way"
    AIR_CHECK = "the air behind it may contradict its summary"
    CLOSED = "nothing more comes of it"
    INTERRUPTED = "samples are missing: states without an estimate until the release"
    FAILED = "by an exception: states that say so until the release"


class Event(enum.Enum):
    """What leads a contact on."""

    CAUGHT_UP = "no sample waits any more"
    RELEASE = "the probe has left"
    BREAK = "a long gap, a jump of the clock, or no more samples come"
    SUMMARY = "the summary is due, the next contact begins, or no more samples come"
    VERDICT = "the air is judged: 1 s after, as the next contact begins, or no more samples come"
    EXCEPTION = "the computation failed"


#: Where an event leads. One that a state has no row for changes nothing and puts nothing out.
TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.BACKFILL, Event.CAUGHT_UP): State.PRESSING,
    (State.BACKFILL, Event.RELEASE): State.RELEASED,
    (State.BACKFILL, Event.BREAK): State.INTERRUPTED,
    (State.PRESSING, Event.RELEASE): State.RELEASED,
    (State.PRESSING, Event.BREAK): State.INTERRUPTED,
    (State.RELEASED, Event.SUMMARY): State.AIR_CHECK,
    (State.AIR_CHECK, Event.VERDICT): State.CLOSED,
    (State.INTERRUPTED, Event.RELEASE): State.CLOSED,
    (State.FAILED, Event.RELEASE): State.CLOSED,
    **{(s, Event.EXCEPTION): State.FAILED for s in State if s is not State.CLOSED},
}
#: The estimator takes samples; no summary has come; the probe is off the tissue.
_LEARNING = {State.BACKFILL, State.PRESSING}
_UNTOLD = {*_LEARNING, State.RELEASED}
_LEFT = {State.RELEASED, State.AIR_CHECK, State.CLOSED}


@dataclass(frozen=True)
class Common:
    """What all contacts share."""

    config: PipelineConfig
    rejected: Counter[str]  #: samples so far, by the reason
    labeller: Labeller
    plausibility: Plausibility  #: judges each contact
    sums: BlockSums  #: of the present block


class Contact:
    """One contact: what happens to it is an event of :data:`TRANSITIONS`; a reset drops it.

    Parameters
    ----------
    contact_id : int
    onset : Onset
    site : Site
    release_force : float
        Force below which the probe is no longer pressing [N].
    common : Common
    is_air_proved : bool
        The air behind an earlier contact has shown that the air before is no contact.
    """

    def __init__(
        self,
        contact_id: int,
        onset: Onset,
        site: Site,
        release_force: float,
        common: Common,
        *,
        is_air_proved: bool = False,
    ) -> None:
        config, first = common.config, onset.samples[0]
        self.contact_id, self.onset, self.site = contact_id, onset, site
        self.start_ns = first.stamp_ns
        self.state = State.BACKFILL
        self._own_flags = Flag.NONE
        self._common, self._config = common, config
        self._labelling = Labelling(
            common.labeller, site.site_id, site.position, self.start_ns, site.change_count
        )
        self._release_force = release_force
        self._behind: deque[Pair] = deque()  # samples that are not taken yet
        self._pace = 1
        self._phase = PhaseMeter()
        frequencies, periods = config.dither_frequencies, config.dither_periods
        self._meter = ComplexModulusMeter(frequencies, periods) if frequencies else None
        #: The largest so far [1, Pa, N]; the stress is that at the largest force.
        self._max_strain = self._max_stress = self._max_force = 0.0
        self._deepest: float | None = None  # compression from the nominal origin [1]
        self._sample_count = 0
        self._changes_before = site.change_count
        self._rejected_before = common.rejected.total()
        self._rejected_after: int | None = None
        self._at_limit_before = force_at_limit(common.rejected)
        # From the release on
        self._end_ns = self._worked_ns = 0
        self._summary: ContactSummary | None = None
        self._air: AirAfter | None = None  # None: it cannot be compared with the air before
        self._was_air_proved = is_air_proved
        self._drift: DriftEvidence | None = None

    @property
    def flags(self) -> Flag:
        """What to know of it: what stands against its site, and what it has shown itself."""
        return self._own_flags | self.site.flags

    @property
    def has_left(self) -> bool:
        """Whether the probe is off the tissue."""
        return self.state in _LEFT

    @property
    def is_open(self) -> bool:
        """Whether the probe presses, or the summary is still to come."""
        return self.state not in (State.AIR_CHECK, State.CLOSED)

    @property
    def is_faint(self) -> bool:
        """Whether it is the site's first, below 4 release forces: perhaps noise."""
        is_first = self.start_ns == self.site.start_ns
        is_weak = self._max_force < _FAINT * self._release_force
        return is_first and is_weak and self.site.state is not SiteState.FAILED

    @property
    def is_air_proved(self) -> bool:
        """Whether air behind a contact, up to this one, has been compared with that before."""
        is_judged = self.state is State.CLOSED and self._air is not None
        return self._was_air_proved or is_judged

    def _may(self, event: Event) -> bool:
        return (self.state, event) in TRANSITIONS

    def _go(self, event: Event) -> None:
        self.state = TRANSITIONS[self.state, event]

    # Samples

    def begin(self, noise: float, before: Site | None) -> Iterator[Output]:
        """Begin on the site, as :meth:`~.site.Site.touch` takes it, with what comes before."""
        samples, common = self.onset.samples, self._common
        if self.site.state is not SiteState.FAILED:
            self.site.touch(self.onset, self._release_force, noise, before)
            self._behind.extend(samples)
        common.plausibility.begin(self.onset)
        common.sums.restart(self.start_ns)
        # As many samples at a time that a touch delays no later sample for long.
        lasted = (samples[-1].stamp_ns - self.start_ns) / NANOSECONDS
        self._pace = 1 + math.ceil(lasted / _CATCH_UP_TIME)
        return self._backfill()

    def take(self, pair: Pair) -> Iterable[Output]:
        """Take a sample."""
        if self.site.state is SiteState.FAILED:
            return self._pass(pair)
        if self.state is not State.BACKFILL:
            return self._follow(pair)
        self._behind.append(pair)
        return self._backfill()

    def _backfill(self) -> Iterator[Output]:
        yield from self._catch_up(self._pace)
        if not self._behind:
            self._go(Event.CAUGHT_UP)

    def _catch_up(self, count: int | None = None) -> Iterator[Output]:
        """Take samples that wait since the touch; only of the newest an output is made.

        States of the time before the detection would contradict those put out then, in the air.
        `count`: at most so many.
        """
        behind = self._behind
        for _ in range(len(behind) if count is None else min(count, len(behind))):
            pair = behind.popleft()
            yield from self._follow(pair, is_silent=bool(behind))

    @property
    def _is_learning(self) -> bool:
        return self.state in _LEARNING

    def _follow(self, pair: Pair, *, is_silent: bool = False) -> Iterable[Output]:
        elapsed = (pair.stamp_ns - self.start_ns) / NANOSECONDS
        force = pair.force - self.onset.bias - self.onset.drift * elapsed
        sample = self.site.follow(pair, force, learns=self._is_learning)
        moduli = self._moduli(sample, self._meter) if self._meter is not None else []
        self._count(force)
        outputs: Iterable[Output] = () if is_silent else moduli
        if not self._common.sums.take(sample):
            return outputs
        return itertools.chain(outputs, self._close_block(pair.stamp_ns, is_silent=is_silent))

    def _moduli(self, sample: ContactSample, meter: ComplexModulusMeter) -> list[DynamicModulus]:
        """Return the complex moduli that end with a sample."""
        if sample.is_free or not self._is_learning or self.flags & WITHHELD:
            meter.reset()
            return []
        strain = self._strain(sample.compression, self.site.estimate)
        elapsed = (sample.stamp_ns - self.start_ns) / NANOSECONDS
        return [
            DynamicModulus(
                stamp_ns=sample.stamp_ns,
                start_ns=self.start_ns + round(modulus.start * NANOSECONDS),
                site_id=self.site.site_id,
                contact_id=self.contact_id,
                modulus=modulus,
            )
            for modulus in meter.add(elapsed, strain, sample.stress)
        ]

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
        block = self.site.learn(means, learns=self._is_learning, is_silent=is_silent)
        if block.innovation is not None:
            self._judge()
        phase = self._phase.add(stamp_ns, block.compression)
        if self._deepest is None or block.compression > self._deepest:
            self._deepest = block.compression
        strain = self._strain(block.compression, self._estimate)
        self._max_strain = max(self._max_strain, strain)
        if self._is_learning:
            self._judge_units(stamp_ns)
        if is_silent:
            return
        yield self._state(stamp_ns, block, strain, phase)
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
            self._own_flags |= Flag.TISSUE_CHANGED
        # The newest judgement counts: an earlier one had seen less of the tissue.
        self._own_flags &= ~Flag.MODEL_MISMATCH
        if self.site.is_mismatch:
            self._own_flags |= Flag.MODEL_MISMATCH

    def _judge_units(self, stamp_ns: int, *, is_over: bool = False) -> None:
        """Withhold the estimate of a contact that cannot be what its units say."""
        # From where the touch was found, not from the estimate's origin.
        strain = self._config.geometry.strain(max(self._deepest or 0.0, 0.0))
        if self._common.plausibility.is_implausible(
            stamp_ns, strain, self._max_force, self._max_stress, is_over=is_over
        ):
            self.site.doubt(Flag.IMPLAUSIBLE)

    # Interruption and end

    def see_gap(self, before_ns: int, *, is_long: bool) -> Iterator[Output]:
        """Take note that samples are missing since a stamp; a long gap interrupts."""
        if self.has_left:
            return
        self._see_missing()
        self.site.flags |= Flag.GAP
        if self._meter is not None:
            self._meter.reset()
        if is_long:
            yield from self.interrupt(before_ns)
            self.site.withdraw(Flag.GAP)

    def _see_missing(self) -> None:
        """Flag it if the force's sensor was at its end, or stuck, where samples are missing."""
        if force_at_limit(self._common.rejected) > self._at_limit_before:
            self._own_flags |= Flag.SATURATED

    def interrupt(self, stamp_ns: int) -> Iterator[Output]:
        """Give the summary of a contact whose samples end at a stamp; it is incomplete."""
        if self._may(Event.BREAK):
            yield from self._catch_up()
            self.site.begin_leaving()
            yield self._end(Event.BREAK, stamp_ns, stamp_ns)

    def release(self, stamp_ns: int) -> Iterator[Output]:
        """Begin to make the summary, if it has not come before: the probe has left."""
        if not self._may(Event.RELEASE):
            return
        yield from self._catch_up()
        self._go(Event.RELEASE)
        if self.state is State.RELEASED:
            self._end_ns = stamp_ns
            self._rejected_after = self._common.rejected.total()
            if self._config.contact.measure_bias:
                drift_sd = self._config.estimator.uncertainty.force_drift_sd
                self._air = AirAfter(self.onset, drift_sd)
            self.site.begin_leaving()

    def work(self, stamp_ns: int) -> None:
        """Go on with the last solution by the work of the time until a stamp."""
        if self.state is State.RELEASED:
            seconds = (stamp_ns - (self._worked_ns or stamp_ns)) / NANOSECONDS
            self._worked_ns = stamp_ns
            self.site.work(seconds)

    def is_due(self, stamp_ns: int) -> bool:
        """Whether the summary is to be given at a stamp."""
        if self.state is not State.RELEASED:
            return False
        least_ns = _SUMMARY_BY_NS if self.site.is_working else _SUMMARY_AFTER_NS
        return stamp_ns - self._end_ns >= least_ns

    def summarize(self, stamp_ns: int) -> Iterator[ContactSummary]:
        """Give the summary of a contact that has ended with its release."""
        if self._may(Event.SUMMARY):
            yield self._end(Event.SUMMARY, self._end_ns, stamp_ns)

    def _end(self, event: Event, end_ns: int, stamp_ns: int) -> ContactSummary:
        """Return the summary, made at `stamp_ns`, of the contact that ends with an event."""
        self.site.leave()
        self._judge_units(end_ns, is_over=True)
        is_complete = event is Event.SUMMARY
        if not is_complete:
            self._see_missing()
        self._summary = self._summarized(end_ns, stamp_ns, complete=is_complete)
        self._go(event)
        return self._summary

    def fail(self, stamp_ns: int) -> Iterator[ContactSummary]:
        """End with an exception; the summary comes if it has not come before."""
        if not self._may(Event.EXCEPTION):
            return
        before = self.state
        self._behind.clear()
        self._air = None
        self._go(Event.EXCEPTION)
        if before in _LEFT:
            self._go(Event.RELEASE)
        if before in _UNTOLD:
            yield self._summarized(stamp_ns, stamp_ns, complete=False)

    # The air behind

    def drop_air(self) -> None:
        """Let it stand: what comes now cannot be compared with the air before."""
        if self.state is not State.CLOSED:
            self._air = None

    def hover(self, pair: Pair) -> Iterable[ContactSummary]:
        """Take a sample in the air; give a second summary once it contradicts the contact."""
        air = self._air
        if air is None or self.state is State.CLOSED:
            return ()
        air.average(pair)
        due_ns = max(self._end_ns + _JUDGED_AFTER_NS, air.end_ns + _AVERAGED_BEFORE_NS)
        return self.judge(pair.stamp_ns) if pair.stamp_ns > due_ns else ()

    def judge(self, stamp_ns: int, *, before_ns: int | None = None) -> Iterator[ContactSummary]:
        """Judge the contact by the air behind it; give a second summary if that contradicts it.

        Its site is doubted: the covariance is widened by as much as the air contradicts what is
        stated, or what was learned; or, where the first contact was taken for air, withdrawn.
        `before_ns`: when the next contact began.
        """
        if not self._may(Event.VERDICT):
            return
        self._go(Event.VERDICT)
        air, site = self._air, self.site
        if air is None or not air.is_complete or air.end_ns > (before_ns or stamp_ns):
            self._air = None
            return
        found = air.change()
        if found is None:
            return
        was_observed, flag = site.is_observed, Flag.NONE
        if found.deviations < -_CONTRADICTION and not self._was_air_proved:
            # What was taken for the first air was a contact: there is no origin, nor a history.
            site.withdraw()
            if was_observed:
                yield self._second(stamp_ns)
            return
        teaches = self._config.learns_drift and site.teaches and found.drift_variance
        drift = drift_evidence(*found) if teaches else None
        factor = site.known_rig.drift_factor(drift) if drift is not None else 1.0
        self._drift = drift if self._is_claimed else None
        if abs(found.deviations) > _CONTRADICTION:
            flag, factor = Flag.FORCE_DRIFTED, max(1.0 + found.deviations**2, factor)
        if factor != 1.0 and was_observed:
            site.doubt(flag, factor)
            yield self._second(stamp_ns)

    def _second(self, stamp_ns: int) -> ContactSummary:
        """Return the summary with what the site says now."""
        first, estimate = self._summary, self.site.usable_estimate
        assert first is not None
        if estimate is None:
            self._common.labeller.forget(self.site.site_id)
        return replace(
            first,
            stamp_ns=stamp_ns,
            flags=first.flags | self.flags,
            estimate=estimate,
            converged=estimate is not None and estimate.converged,
            order_source=order_source(estimate, self._config.estimator),
            **({} if estimate is not None else _NO_LABEL),
        )

    # What it teaches

    @property
    def _is_claimed(self) -> bool:
        """Whether its summary has converged, and nothing stands against it."""
        return self._summary is not None and self._summary.converged and not self.flags

    def taught(self, rig: RigKnowledge, *, is_newest: bool) -> RigKnowledge:
        """Return what is known of the rig once a contact has entered its state.

        Only one that is claimed teaches: delay, friction and the surface's motion with its
        summary, the force's drift with the air behind it. `is_newest`: the site is; one that is
        visited again began with less than is known of the rig by now.
        """
        if self.state is State.AIR_CHECK and is_newest and self._is_claimed:
            return replace(self.site.rig() or rig, drift=rig.drift)
        return rig.drifted(self._drift) if self._drift is not None else rig

    # Outputs

    @property
    def _estimate(self) -> Estimate | None:
        return self.site.usable_estimate if self._is_learning else None

    def _strain(self, compression: float, estimate: Estimate | None) -> float:
        """Return the strain from the origin of an estimate [1]."""
        origin = estimate.strain_origin if estimate is not None else 0.0
        return self._config.geometry.strain(compression - origin)

    def _state(self, stamp_ns: int, block: Learned, strain: float, phase: Phase) -> TissueState:
        estimate = self.site.live_estimate if self._is_learning else None
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
            signals=Signals(strain, block.stress, block.fractional_stress),
            innovation=block.innovation,
            apparent_stiffness=self._stiffness(estimate, block.compression, block.stress),
        )

    def _stiffness(
        self, estimate: Estimate | None, compression: float | None, stress: float
    ) -> ApparentStiffness | None:
        """Return it about a compression [1] and stress [Pa]; None while not known."""
        geometry, time_scale = self._config.geometry, self._config.apparent_stiffness_time_scale
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

    def _summarized(self, end_ns: int, stamp_ns: int, *, complete: bool) -> ContactSummary:
        self._judge()
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
