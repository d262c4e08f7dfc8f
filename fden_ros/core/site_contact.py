# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One contact of a site: its states, and the outputs made of its samples."""

from __future__ import annotations

import enum
import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator

from fden_ros.core.air_after import AirAfter
from fden_ros.core.contact import SMALL, Onset
from fden_ros.core.outputs import ContactSummary, Flag, Output
from fden_ros.core.report import Account, Common
from fden_ros.core.site import Site
from fden_ros.core.standing import SiteState
from fden_ros.core.streams import NANOSECONDS, Pair

#: A summary is given this long after the release [ns].
_SUMMARY_AFTER_NS = 4 * NANOSECONDS // 10
#: So that no sample waits for all of a longer work, samples from before the detection of a touch
#: are backfilled within about this time [ns], and the estimator does a part of its last work each
#: time that half of it has passed since the release.
_PART_NS = 3 * NANOSECONDS // 100


class State(enum.Enum):
    """States of a contact."""

    BACKFILL = "samples from before the detection are backfilled"
    PRESSING = "each block gives a state"
    RELEASED = "the summary is to come"
    AIR_CHECK = "the air behind it may contradict its summary"
    CLOSED = "nothing more comes of it"
    INTERRUPTED = "samples are missing: states without an estimate until the release"
    FAILED = "by an exception: states that say so until the release"

    @property
    def is_learning(self) -> bool:
        """Whether the estimator uses samples."""
        return self in (State.BACKFILL, State.PRESSING)

    @property
    def has_left(self) -> bool:
        """Whether the probe is off the tissue."""
        return self in (State.RELEASED, State.AIR_CHECK, State.CLOSED)

    @property
    def is_open(self) -> bool:
        """Whether the probe presses, or the summary is pending."""
        return self not in (State.AIR_CHECK, State.CLOSED)

    @property
    def lacks_summary(self) -> bool:
        """Whether no summary has been given."""
        return self.is_learning or self is State.RELEASED


class Event(enum.Enum):
    """What changes the state of a contact."""

    CAUGHT_UP = "no sample waits any more"
    RELEASE = "the probe has left"
    BREAK = "a long gap, a jump of the clock, or no more samples come"
    SUMMARY = "the summary is due, the next contact begins, or no more samples come"
    VERDICT = "the air is judged: 1 s after, as the next contact begins, or no more samples come"
    EXCEPTION = "the computation failed"


#: The next state by event. An event without a row in a state changes nothing and gives no output.
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


class Contact:
    """One contact: what happens to it is an event of :data:`TRANSITIONS`; a reset drops it.

    `is_air_proved`: air behind an earlier contact has shown that the air before is no contact.
    """

    def __init__(
        self, contact_id: int, onset: Onset, site: Site, common: Common, is_air_proved: bool
    ) -> None:
        self.contact_id, self.onset, self.site = contact_id, onset, site
        self.start_ns = onset.samples[0].stamp_ns
        self.state = State.BACKFILL
        self._common, self._config = common, common.config
        self._account = Account(contact_id, onset, site, common)
        self._behind: deque[Pair] = deque()  # samples that are still to be added
        self._pace = 1
        # From the release on
        self._end_ns = self._settled_ns = 0
        self._summary: ContactSummary | None = None
        self._air: AirAfter | None = None  # None: it cannot be compared with the air before
        self._was_air_proved = is_air_proved

    @property
    def flags(self) -> Flag:
        """The flags of its site, and its own."""
        return self._account.flags

    @property
    def is_faint(self) -> bool:
        """Whether it is the site's first, below twice its clear force: perhaps noise."""
        is_first = self.start_ns == self.site.start_ns
        is_weak = self._account.max_force < 2.0 * self.onset.clear_force
        return is_first and is_weak and self.site.state is not SiteState.FAILED

    @property
    def is_air_proved(self) -> bool:
        """Whether the air after a contact, up to this one, has been compared with that before."""
        is_judged = self.state is State.CLOSED and self._air is not None
        return self._was_air_proved or is_judged

    def _may(self, event: Event) -> bool:
        return (self.state, event) in TRANSITIONS

    def _go(self, event: Event) -> None:
        self.state = TRANSITIONS[self.state, event]

    # Samples

    def begin(self, noise: float, before: Site | None) -> Iterator[Output]:
        """Begin on the site, as :meth:`~.site.Site.touch` does, with the approach before it."""
        samples, common = self.onset.samples, self._common
        if self.site.state is not SiteState.FAILED:
            self.site.touch(self.onset, noise, before)
            self._behind.extend(samples)
        common.plausibility.begin(self.onset)
        common.sums.restart(self.start_ns)
        # As many samples at a time that a touch delays no later sample for long.
        self._pace = 1 + math.ceil((samples[-1].stamp_ns - self.start_ns) / _PART_NS)
        return self._backfill()

    def take(self, pair: Pair) -> Iterable[Output]:
        """Add a sample."""
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
        """Add samples that wait since the touch; only the newest gives an output.

        States of the time before the detection would contradict the earlier ones, in the air.
        `count`: at most this number.
        """
        behind = self._behind
        for _ in range(len(behind) if count is None else min(count, len(behind))):
            pair = behind.popleft()
            yield from self._follow(pair, is_silent=bool(behind))

    def _follow(self, pair: Pair, *, is_silent: bool = False) -> Iterable[Output]:
        learns, sums = self.state.is_learning, self._common.sums
        elapsed = (pair.stamp_ns - self.start_ns) / NANOSECONDS
        force = pair.force - self.onset.bias - self.onset.drift * elapsed
        if self.onset.clearance < SMALL * (pair.displacement - self.onset.displacement):
            # The air before was a contact, or a sign is wrong: the probe turned, and met nothing.
            self.site.withdraw()
        sample = self.site.follow(pair, force, learns=learns)
        moduli = self._account.take(sample, learns=learns)
        outputs: Iterable[Output] = () if is_silent else moduli
        if not sums.take(sample):
            return outputs
        means = sums.close(pair.stamp_ns)
        block = self.site.learn(means, learns=learns, is_silent=is_silent)
        results = self._account.close_block(
            pair.stamp_ns, block, learns=learns, is_silent=is_silent
        )
        return itertools.chain(outputs, results, () if is_silent else self._work())

    def _work(self) -> Iterator[Output]:
        """Let the estimator work, last of a chain: the outputs before do not wait for it."""
        self.site.work()
        yield from ()

    def _pass(self, pair: Pair) -> Iterator[Output]:
        """Skip a sample of a contact in which the estimation failed."""
        self._account.count(pair.force - self.onset.bias)
        if self._common.sums.passes(pair.stamp_ns):
            yield self._account.unknown(pair.stamp_ns)

    # Interruption and end

    def see_gap(self, before_ns: int, *, is_long: bool) -> Iterator[Output]:
        """Handle samples missing since a stamp; a long gap interrupts."""
        if self.state.has_left:
            return
        self._account.skip()
        self.site.flags |= Flag.GAP
        if is_long:
            yield from self.interrupt(before_ns)
            self.site.withdraw(Flag.GAP)

    def interrupt(self, stamp_ns: int) -> Iterator[Output]:
        """Give the summary of a contact whose samples end at a stamp; it is incomplete."""
        if self._may(Event.BREAK):
            yield from self._catch_up()
            yield self._end(Event.BREAK, stamp_ns, stamp_ns)

    def release(self, stamp_ns: int) -> Iterator[Output]:
        """Begin the summary, unless it has been given: the probe has left."""
        if not self._may(Event.RELEASE):
            return
        yield from self._catch_up()
        self._go(Event.RELEASE)
        if self.state is State.RELEASED:
            self._end_ns = stamp_ns
            self._account.leave()
            if self._config.contact.measure_bias:
                drift_sd = self._config.estimator.uncertainty.force_drift_sd
                self._air = AirAfter(self.onset, stamp_ns, drift_sd)

    def is_due(self, stamp_ns: int) -> bool:
        """Whether the summary is to be given at a stamp."""
        return self.state is State.RELEASED and stamp_ns - self._end_ns >= _SUMMARY_AFTER_NS

    def summarize(self, stamp_ns: int) -> Iterator[ContactSummary]:
        """Give the summary of a contact that has ended with its release."""
        if self._may(Event.SUMMARY):
            yield self._end(Event.SUMMARY, self._end_ns, stamp_ns)

    def _end(self, event: Event, end_ns: int, stamp_ns: int) -> ContactSummary:
        """Return the summary, made at `stamp_ns`, of the contact that ends with an event."""
        self.site.leave()
        self._account.judge_units(end_ns, is_over=True)
        is_complete = event is Event.SUMMARY
        if not is_complete:
            self._account.see_missing()
        self._summary = self._account.summary(end_ns, stamp_ns, complete=is_complete)
        self._go(event)
        return self._summary

    def fail(self, stamp_ns: int) -> Iterator[ContactSummary]:
        """End with an exception; give the summary unless it has been given."""
        if not self._may(Event.EXCEPTION):
            return
        before = self.state
        self._behind.clear()
        self._air = None
        self._go(Event.EXCEPTION)
        if before.has_left:
            self._go(Event.RELEASE)
        if before.lacks_summary:
            yield self._account.summary(stamp_ns, stamp_ns, complete=False)

    # The air after the contact

    def drop_air(self) -> None:
        """Stop the comparison: the next samples cannot be compared with the air before."""
        if self.state is not State.CLOSED:
            self._air = None

    def hover(self, pair: Pair) -> Iterable[ContactSummary]:
        """Add a sample in the air; give a second summary once it contradicts the contact."""
        if self._air is None or self.state is State.CLOSED:
            return ()
        self._air.average(pair)
        return self.judge(pair.stamp_ns) if self._air.is_due(pair.stamp_ns) else ()

    def settle(self, stamp_ns: int) -> None:
        """Let the estimator do a part of its last work, once no output waits."""
        if self.state is State.RELEASED and stamp_ns - self._settled_ns >= _PART_NS:
            self._settled_ns = stamp_ns
            self.site.settle()

    def judge(self, stamp_ns: int, *, before_ns: int | None = None) -> Iterator[ContactSummary]:
        """Judge the contact by the air after it; give a second summary if that contradicts it.

        The covariance of its site is widened by as much as the air contradicts the stated values.
        If the first contact was taken for air, the site is invalidated.
        `before_ns`: when the next contact began.
        """
        if not self._may(Event.VERDICT):
            return
        self._go(Event.VERDICT)
        if self._air is None or not self._air.is_known(before_ns or stamp_ns):
            self._air = None
            return
        found, site, was_observed = self._air.change(), self.site, self.site.is_observed
        if found is None:
            return
        if found.has_fallen and not self._was_air_proved:
            # A contact was taken for the first air: there is neither an origin nor a history.
            site.withdraw()
        else:
            if not found.has_drifted:
                return
            if was_observed:
                site.doubt(Flag.FORCE_DRIFTED, 1.0 + found.deviations**2)
        if was_observed:
            assert self._summary is not None
            yield self._account.second(self._summary, stamp_ns)
