# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that presses and leaves: contacts of sites, and the air between."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from fden_ros.core.air_check import AirCheck, Verdict
from fden_ros.core.block import BlockSums
from fden_ros.core.config import PipelineConfig, labeller_of
from fden_ros.core.contact.air import least_noise
from fden_ros.core.contact.detector import ContactDetector, Onset, Release
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.outputs import (
    Flag,
    Output,
    Phase,
    Status,
    TissueState,
    estimate_flags,
    order_source,
)
from fden_ros.core.plausibility import Plausibility, Tilt
from fden_ros.core.press import Common, Press
from fden_ros.core.site import Site, dips, prepare
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position
from fden_ros.core.strokes import Strokes

#: A summary is given this long after the release [ns], where the last solution has been found by
#: then, and at the latest after this [ns]: what is left of it is done at once.
_SUMMARY_AFTER_NS, _SUMMARY_BY_NS = 4 * NANOSECONDS // 10, 8 * NANOSECONDS // 10
#: Sites whose tissue is remembered, so that a place that is pressed again is known [1].
_MOST_VISITED = 16


@dataclass
class _Left:
    """A contact that has ended, and whose summary has not come yet."""

    press: Press
    end_ns: int  #: stamp of the release
    worked_ns: int = 0  #: until when it was worked on the summary; 0: not yet

    def is_due(self, stamp_ns: int) -> bool:
        """Whether the summary is to be given at a stamp."""
        elapsed_ns = stamp_ns - self.end_ns
        is_found = not self.press.site.is_working
        return elapsed_ns >= (_SUMMARY_AFTER_NS if is_found else _SUMMARY_BY_NS)

    def work(self, stamp_ns: int) -> None:
        """Go on with the last solution by the work of the time until a stamp."""
        seconds = (stamp_ns - (self.worked_ns or stamp_ns)) / NANOSECONDS
        self.worked_ns = stamp_ns
        self.press.site.work(seconds)


class ContactSession:
    """One press after the other.

    Parameters
    ----------
    config : PipelineConfig
    rejected : collections.Counter
        Counts of rejected samples so far.
    path_noise : callable
        Returns the noise of the motion so far [m^2 s].
    flags : Flag
        What stands against every estimate.

    Attributes
    ----------
    site_count, contact_count : int
        So far.
    rig : RigKnowledge
        What is known of the rig.
    """

    def __init__(
        self,
        config: PipelineConfig,
        rejected: Counter[str],
        path_noise: Callable[[], float],
        flags: Flag,
    ) -> None:
        self.site_count = self.contact_count = 0
        self._config, self._path_noise, self._flags = config, path_noise, flags
        self._detector = ContactDetector(config.contact, config.estimator.prior.fractional_order)
        self._air = AirCheck(config)
        self._tilt = Tilt(config.geometry)
        self._strokes = Strokes()
        self._common = Common(
            config,
            rejected,
            labeller_of(config),
            Plausibility(config.plausibility, config.geometry, config.estimator.prior),
            BlockSums(config.block_duration, config.block_compression),
        )
        self.forget()
        self.forget_rig()
        prepare(config)

    def forget(self, *, keeps_contact: bool = False) -> None:
        """Forget what was learned but of the rig, and the air's force; ids are kept.

        `keeps_contact`: a detector in contact waits for the release, and keeps the air's force
        until there is air again.
        """
        self._site: Site | None = None
        self._visited: list[Site] = []
        self._press: Press | None = None
        self._left: _Left | None = None
        self._air.forget()
        self._strokes.forget()
        self._common.labeller.forget()
        self._common.sums.forget()
        if not (keeps_contact and self._detector.in_contact):
            self._detector.reset()

    def forget_rig(self) -> None:
        """Let the next site begin with what is stated of the rig."""
        self.rig = RigKnowledge.stated(self._config.estimator)
        # These began with what is forgotten now.
        for site in self._visited:
            site.teach_nothing()
        if self._left is not None:
            self._left.press.site.teach_nothing()
        self._air.teach_nothing()

    @property
    def in_contact(self) -> bool:
        """Whether the probe presses."""
        return self._detector.in_contact

    @property
    def place(self) -> tuple[int, int]:
        """Numbers of the present site and contact; 0: there is none."""
        site_id = self._site.site_id if self._site is not None else 0
        if self._left is not None:
            return self._left.press.site.site_id, self._left.press.contact_id
        return site_id, self._press.contact_id if self._press is not None else 0

    @property
    def air_events(self) -> tuple[int, int, bool]:
        """As :func:`~fden_ros.core.input_warnings.input_warnings` takes them."""
        detector = self._detector
        return detector.below_baseline, detector.drifts, detector.has_seen_air

    @property
    def warnings(self) -> dict[str, int]:
        """What was odd about the contacts, in words, and how often."""
        strokes = self._strokes
        return {
            **self._common.plausibility.found,
            self._tilt.words: self._tilt.count,
            strokes.warning: 1,
            self._floor_warning: 1,
        }

    @property
    def _floor_warning(self) -> str:
        own, floor = self._detector.hidden_above, self._config.contact.noise_floor
        if not own:
            return ""
        return (
            f"force.noise_floor ({floor:.1g} N) hides presses: the air's own noise is {own:.1g} N"
            f"; write force: {{noise_floor: {least_noise(own):.0e}}}"
        )

    @property
    def never_lifts(self) -> bool:
        """Whether the probe palpates without lifting, so that its contacts are none."""
        return self._strokes.prevails

    def zero(self) -> float | str:
        """Measure the force in the air anew; return what it was [N], or why it is not known."""
        mean = self._detector.mean_air_force()
        if mean is None:
            if self._detector.in_contact:
                return "the probe is in contact: lift it, then tare"
            return "no force has been measured in the air yet: wait for samples, then tare"
        self._detector.reset()
        # The air from now on has another bias than that before the last contact.
        self._air.drop()
        return mean

    # Pairs

    def take(self, pair: Pair) -> Iterator[Output]:
        """Take a pair; give what comes of it."""
        event = self._detect(pair)
        self._strokes.add(pair, in_contact=self._detector.in_contact)
        if isinstance(event, Onset):
            self._strokes.touch(event)
            yield from self._report(pair.stamp_ns)
            yield from self._touch(event)
        elif self._press is None:
            yield from self._hover(pair)
            if self._left and self._left.is_due(pair.stamp_ns):
                yield from self._report(pair.stamp_ns)
        else:
            yield from self._press.take(pair)
        if isinstance(event, Release):
            self._strokes.release()
            yield from self._end_press(event.stamp_ns, complete=True)

    def _detect(self, pair: Pair) -> Onset | Release | None:
        try:
            return self._detector.add(pair)
        except Exception:
            self._detector.reset()
            raise

    def _touch(self, onset: Onset) -> Iterator[Output]:
        first, newest = onset.samples[0], onset.samples[-1]
        yield from self._heed(self._air.judge(newest.stamp_ns, before_ns=first.stamp_ns))
        self._tilt.see(newest.tilt)
        site = self._site = self._site_of(onset)
        site.check_history(onset)
        self.contact_count += 1
        release_force = self._detector.release_threshold
        self._press = Press(self.contact_count, onset, site, release_force, self._common)
        yield from self._press.begin(self._path_noise())

    def _site_of(self, onset: Onset) -> Site:
        """Return the site that is touched: the last one, or another."""
        before, first = self._site, onset.samples[0]
        is_elsewhere = before.is_elsewhere(onset) if before is not None else True
        if before is not None and is_elsewhere is False:
            return before
        if before is not None and is_elsewhere:
            before.put_away()
        site = self._visited_before(first.position)
        if site is None:
            self.site_count += 1
            maybe = before if is_elsewhere is None else None
            site = Site(self.site_count, onset, self._config, self.rig, self._flags, maybe)
            self._visited = [*self._visited[1 - _MOST_VISITED :], site]
        left_ns = self._detector.left_unseen_ns
        is_doubted = left_ns is not None and dips(first.stamp_ns - left_ns)
        if is_doubted or (before is not None and before.leaves_doubt(first.stamp_ns)):
            site.withdraw()
        return site

    def _visited_before(self, position: Position | None) -> Site | None:
        """Return the site of an earlier touch at a position; None: there is none to go on from."""
        known = reversed(self._visited)
        return next((site for site in known if site.is_usable and site.is_at(position)), None)

    def _hover(self, pair: Pair) -> Iterator[Output]:
        """Give a state in the air, one per duration of a block."""
        yield from self._heed(self._air.hear(pair))
        if not self._common.sums.passes(pair.stamp_ns):
            return
        if self._left is not None:
            self._left.work(pair.stamp_ns)
        site = self._site
        estimate = site.usable_estimate if site is not None else None
        yield TissueState(
            stamp_ns=pair.stamp_ns,
            # After a jump of the clock the probe may press on a tissue without a site.
            status=Status.UNKNOWN if self._detector.in_contact else Status.NO_CONTACT,
            flags=self._flags | estimate_flags(estimate),
            site_id=site.site_id if site is not None else 0,
            contact_id=self.contact_count if site is not None else 0,
            phase=Phase.APPROACH,
            estimate=estimate,
            order_source=order_source(estimate, self._config.estimator),
        )

    def _heed(self, verdict: Verdict) -> Iterator[Output]:
        """Learn from the air after a contact; give its second summary, if there is one."""
        if verdict.drift is not None:
            self.rig = self.rig.drifted(verdict.drift)
        summary = verdict.summary
        if summary is None:
            return
        if summary.estimate is None:
            self._common.labeller.forget(summary.site_id)
        yield summary

    # Interruption and end

    def _end_press(self, end_ns: int, *, complete: bool) -> Iterator[Output]:
        press = self._press
        if press is None:
            return
        yield from press.take_all()
        # An incomplete contact may go on: the probe has not left.
        if not complete:
            if not press.has_ended:
                yield replace(press.end(end_ns, end_ns, complete=False), rig=self.rig)
            return
        if not press.has_ended:
            press.begin_end()
            self._left = _Left(press, end_ns)
            self._air.watch(end_ns, press.site, press.onset)
        self._press = None
        self._common.sums.clear()
        if press.is_faint and not press.has_failed:
            # What comes next must not inherit its origin.
            self._visited = [site for site in self._visited if site is not self._site]
            self._site = None

    def _report(self, stamp_ns: int) -> Iterator[Output]:
        """Give the summary of a contact that has ended with its release."""
        if self._left is None:
            return
        press, end_ns = self._left.press, self._left.end_ns
        summary = press.end(end_ns, stamp_ns, complete=True)
        self._left = None
        # A site that is visited again began with less than is known of the rig by now.
        is_newest = press.site.site_id == self.site_count
        if summary.converged and not press.flags and is_newest:
            self.rig = replace(press.site.rig() or self.rig, drift=self.rig.drift)
        summary = replace(summary, rig=self.rig)
        self._air.see(summary)
        yield summary

    def see_gap(self, before_ns: int, *, is_long: bool) -> Iterator[Output]:
        """Take note that samples are missing since a stamp.

        `is_long`: the memory of the site is lost; the present contact says nothing more.
        """
        if is_long:
            self._strokes.forget()
        press = self._press
        if press is None:
            return
        press.see_gap()
        if is_long:
            yield from self._end_press(before_ns, complete=False)
            press.site.is_usable = False

    def break_off(self, stamp_ns: int) -> Iterator[Output]:
        """Give the summary of a contact whose samples end at a stamp."""
        yield from self._report(stamp_ns)
        yield from self._end_press(stamp_ns, complete=False)

    def finish(self, stamp_ns: int) -> Iterator[Output]:
        """Give what is left to say where no more samples come."""
        yield from self._report(stamp_ns)
        yield from self._end_press(stamp_ns, complete=False)
        yield from self._heed(self._air.judge(stamp_ns))

    def fail(self, stamp_ns: int) -> Iterator[Output]:
        """End contact and site after an exception."""
        self._common.sums.clear()
        left, self._left = self._left, None
        press = left.press if left is not None else self._press
        site = press.site if press is not None else self._site
        if left is not None:
            self._air.drop()
        if site is None:
            return
        site.fail()
        self._common.labeller.forget(site.site_id)
        if press is not None:
            yield from press.fail(stamp_ns)
