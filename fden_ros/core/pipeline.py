# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The whole chain from samples to classified tissue, the same for live, replay and batch.

Samples of force and displacement go in, each stream in its own order; :class:`TissueState`,
:class:`Classification`, :class:`ContactSummary` and, where the probe oscillates,
:class:`DynamicModulus` come out through a callback. Time is taken from the stamps alone.
"""

from __future__ import annotations

import enum
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from fden_ros.core.config import PipelineConfig, labeller_of
from fden_ros.core.contact.detector import ContactDetector, Onset, Release
from fden_ros.core.continuous import ContinuousContact
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.hindsight import Hindsight, Verdict
from fden_ros.core.in_contact import InContact
from fden_ros.core.input_warnings import input_warnings, unusual
from fden_ros.core.outputs import (
    Failure,
    Flag,
    Output,
    Phase,
    Status,
    TissueState,
    estimate_flags,
    failure_of,
    order_source,
)
from fden_ros.core.plausibility import Plausibility, Tilt
from fden_ros.core.press import Press
from fden_ros.core.site import Site, dips, prepare
from fden_ros.core.streams.direction import Direction
from fden_ros.core.streams.frames import StaticLinks
from fden_ros.core.streams.guard import GapGuard
from fden_ros.core.streams.rotation import Quaternion, Transform, Vector
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position
from fden_ros.core.streams.synchronize import Synchronizer

#: Failures are kept up to this number, the newest.
_FAILURES_KEPT = 20


class _Forget(enum.IntEnum):
    """What a reset forgets, each with those before it."""

    SITE = 1  #: the present site: a faint touch may have been noise
    SITES = 2  #: all sites and the contact: the clock jumped; the streams go on in their new epoch
    STREAMS = 3  #: waiting samples and the air's force too: asked for, or the pipeline is new


class Pipeline:
    """From samples to :class:`TissueState`, :class:`Classification` and :class:`ContactSummary`.

    Parameters
    ----------
    config : PipelineConfig
    emit : callable
        Called with every output, in order of stamps. What it raises is not caught.

    Attributes
    ----------
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"<stream>.<reason>"``.
    pair_count, contact_count, site_count : int
        Pairs, contacts and sites so far.
    newest_ns : int
        Stamp of the newest pair.
    failures : deque of Failure
        The newest exceptions of the computation. Each ended one contact and its site, both
        flagged :attr:`Flag.ESTIMATION_FAILED`; the next site begins afresh.
    failure_count : int
        How many there were.
    rig : RigKnowledge
        What is known of the rig.
    problems : tuple of str
        What stands against every estimate from the start, a sentence each.
    standing_flags : Flag
        The flags of that.
    """

    def __init__(self, config: PipelineConfig, emit: Callable[[Output], None]) -> None:
        self.config = config
        self.rejected: Counter[str] = Counter()
        self.pair_count = self.contact_count = self.site_count = 0
        self.newest_ns = 0
        self.failures: deque[Failure] = deque(maxlen=_FAILURES_KEPT)
        self.failure_count = 0
        self._emit_output = emit
        self._listener_error: Exception | None = None
        self._clock_jumps = 0
        self._tare_offset = 0.0
        # They come once, and outlive a reset.
        self._statics = StaticLinks()
        self._max_gap_ns = round(config.synchronize.max_gap * NANOSECONDS)
        self._direction = Direction()
        self._detector = ContactDetector(config.contact, config.estimator.prior.fractional_order)
        self._labeller = labeller_of(config)
        self._plausibility = Plausibility(
            config.plausibility, config.geometry, config.estimator.prior
        )
        words = self._plausibility.standing
        if config.is_continuous and not config.geometry.is_stated:
            words = ""  # a stiffness in N/m needs none
        self.problems = (words,) if words else ()
        self.standing_flags = Flag.NONE
        if words:
            is_stated = config.geometry.is_stated
            self.standing_flags = Flag.IMPLAUSIBLE if is_stated else Flag.GEOMETRY_UNSTATED
        self._hindsight = Hindsight(config)
        self._in_contact = InContact(config, self._plausibility)
        self._forget(_Forget.STREAMS)
        self._tilt = Tilt(config.geometry)
        self.forget_rig()
        prepare(config)

    def _forget(self, scope: _Forget) -> None:
        """Forget what was learned but of the rig; configuration, tare, counts and ids are kept.

        A detector in contact keeps the air's force over a jump of the clock: it waits for the
        release.
        """
        self._site: Site | None = None
        self._press: Press | None = None
        self._continuous = (
            ContinuousContact(self.config, self.site_count + 1)
            if self.config.is_continuous
            else None
        )
        if scope >= _Forget.SITES:
            self._onset: Onset | None = None
            self._hindsight.forget()
            self._labeller.forget()
            self._gaps = GapGuard()
            self._in_contact.forget()
            self._rejected_reported = self.rejected.total()
            if scope is _Forget.STREAMS or not self._detector.in_contact:
                self._detector.reset()
        if scope is _Forget.STREAMS:
            self._restart_streams()

    def _restart_streams(self) -> None:
        self._synchronizer = Synchronizer(
            self.config.synchronize, self._on_pair, self.rejected, self._statics
        )
        self._epoch = 0

    # Inputs

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Take a force sample [N], positive when pressing; with torsion a torque [N m]."""
        try:
            # Where frames move, the force is tared once it is in the base.
            offset = 0.0 if self.config.synchronize.frames is not None else self._tare_offset
            self._synchronizer.add_force(stamp_ns, force - offset)
        except Exception as error:
            self._fail(stamp_ns, error)
            self._restart_streams()

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        """Take a displacement [m], positive into the tissue, and the position where known [m].

        `load` is the part of the tool's weight in the force at this orientation [N], `turn` the
        probe's orientation where it advances along its own axis.
        """
        try:
            self._synchronizer.add_displacement(stamp_ns, displacement, position, load, turn)
        except Exception as error:
            self._fail(stamp_ns, error)
            self._restart_streams()

    def add_force_vector(self, stamp_ns: int, frame: str, force: Vector) -> None:
        """Take a force [N], or with torsion a torque [N m], in a frame that moves."""
        self._feed(stamp_ns, lambda: self._synchronizer.add_force_vector(stamp_ns, frame, force))

    def add_transform(
        self,
        stamp_ns: int,
        parent: str,
        child: str,
        translation: Vector,
        rotation: Quaternion,
        *,
        is_static: bool,
    ) -> None:
        """Take where a frame is in its parent [m], and its rotation as a quaternion."""
        place = Transform(translation, rotation)
        self._feed(
            stamp_ns,
            lambda: self._synchronizer.add_transform(
                stamp_ns, parent, child, place, is_static=is_static
            ),
        )

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        """Take a place of the tissue's surface [m], positive into the tissue; it is taken off."""
        self._feed(stamp_ns, lambda: self._synchronizer.add_surface(stamp_ns, surface))

    def _feed(self, stamp_ns: int, add: Callable[[], None]) -> None:
        try:
            add()
        except Exception as error:
            self._fail(stamp_ns, error)
            self._restart_streams()

    def reject(self, stream: str, reason: str) -> None:
        """Count a sample that could not even be read."""
        self.rejected[f"{stream}.{reason}"] += 1

    def tare(self) -> str | None:
        """Take the present force as zero; return None, or why that cannot be done now."""
        if self._continuous is not None:
            return "contact.mode is continuous: the force's zero plays no part"
        mean = self._detector.mean_air_force()
        if mean is None:
            if self._detector.in_contact:
                return "the probe is in contact: lift it, then tare"
            return "no force has been measured in the air yet: wait for samples, then tare"
        self._tare_offset += mean
        self._detector.reset()
        # The air from now on has another bias than that before the last contact.
        self._hindsight.acquit()
        return None

    def reset(self) -> str | None:
        """Forget what was learned but of the rig; return None, or why that cannot be done now."""
        if self._detector.in_contact:
            return "the probe is in contact: lift it, then reset"
        self._end_continuous()
        self._forget(_Forget.STREAMS)
        return None

    def forget_rig(self) -> None:
        """Let the next site begin with what is stated of the rig."""
        self.rig = RigKnowledge.stated(self.config.estimator)
        # These began with what is forgotten now.
        if self._site is not None:
            self._site.teach_nothing()
        self._hindsight.teach_nothing()

    def finish(self) -> None:
        """No more samples come: report the contact that is still open."""
        try:
            self._end_contact(self._gaps.newest_ns, complete=False)
            self._heed(self._hindsight.judge(self.newest_ns))
            self._end_continuous()
        except Exception as error:
            self._fail(self.newest_ns, error)

    @property
    def transform_problem(self) -> str:
        """Why no force has found its transforms yet, in words; empty: there is nothing to say."""
        frames = self._synchronizer.frames
        if self.pair_count or frames is None or not frames.missing:
            return ""
        known = ", ".join(frames.known) or "none"
        base = self.config.synchronize.frames.base if self.config.synchronize.frames else ""
        return (
            f"no chain of transforms leads from {frames.missing} to {base}: /tf and /tf_static "
            f"name {known}; set frames.base and frames.probe to frames that are connected"
        )

    @property
    def is_failed(self) -> bool:
        """Whether the newest failure is that of the present site, or came without one."""
        if not self.failures:
            return False
        site_id = self._site.site_id if self._site is not None else 0
        if self._continuous is not None:
            site_id = self._continuous.place_count
        return self.failures[-1].site_id == site_id

    @property
    def unusual_rejections(self) -> int:
        """Rejected samples, less the first two without a partner, which are usual."""
        return unusual(self.rejected)

    @property
    def warnings(self) -> dict[str, int]:
        """What was odd about the input, in words, and how often."""
        odd = input_warnings(
            self.config.synchronize,
            self._synchronizer,
            self._detector,
            self._direction,
            self.rejected,
            self._clock_jumps,
        )
        found = {words: count for words, count in self._plausibility.found.items() if count}
        along = self._continuous.warnings if self._continuous is not None else {}
        tilted = {self._tilt.words: self._tilt.count}
        said = {words: n for words, n in {**along, **tilted}.items() if words and n}
        return {**dict.fromkeys(self.problems, 1), **found, **said, **odd}

    # Pairs

    def _on_pair(self, pair: Pair) -> None:
        if self.config.synchronize.frames is not None and self._tare_offset:
            # Only here the force is along the axis.
            pair = pair._replace(force=pair.force - self._tare_offset)
        self._direction.add(pair)
        try:
            self._take(pair)
        except Exception as error:
            self._fail(pair.stamp_ns, error)

    def _take(self, pair: Pair) -> None:
        if pair.epoch != self._epoch:
            self._clock_jumped(pair.epoch)
        self._check_gap(pair.stamp_ns)
        self.pair_count += 1
        self.newest_ns = pair.stamp_ns
        if self._continuous is not None:
            self._take_continuous(pair, self._continuous)
            return
        event = self._detect(pair)
        if isinstance(event, Onset):
            self._touch(event)
        elif self._press is None or self._site is None:
            self._hover(pair)
        elif self._press.flags & Flag.ESTIMATION_FAILED:
            self._pass(pair, self._press)
        else:
            self._emit_all(self._in_contact.add(pair, self._press, self._site))
        if isinstance(event, Release):
            self._end_contact(event.stamp_ns, complete=True)

    def _take_continuous(self, pair: Pair, contact: ContinuousContact) -> None:
        self._emit_all(contact.add(pair, self.rejected.total()))
        self.site_count = self.contact_count = contact.place_count

    def _end_continuous(self, flags: Flag = Flag.NONE) -> None:
        if self._continuous is not None:
            self._emit_all(self._continuous.end(self.newest_ns, self.rejected.total(), flags))

    def _detect(self, pair: Pair) -> Onset | Release | None:
        try:
            return self._detector.add(pair)
        except Exception:
            self._detector.reset()
            raise

    def _clock_jumped(self, epoch: int) -> None:
        self._clock_jumps += 1
        self._end_contact(self._gaps.newest_ns, complete=False)
        self._end_continuous()
        self._forget(_Forget.SITES)
        self._epoch = epoch

    def _check_gap(self, stamp_ns: int) -> None:
        previous_ns = self._gaps.newest_ns
        gap_ns = self._gaps.step(stamp_ns)
        press, site = self._press, self._site
        if gap_ns and self._continuous is not None:
            if gap_ns > self._max_gap_ns:
                self._end_continuous()
            else:
                self._continuous.see_gap()
        if not gap_ns or press is None or site is None:
            return
        press.see_missing(self.rejected)
        press.flags |= Flag.GAP
        site.flags |= Flag.GAP
        self._in_contact.interrupt()
        if gap_ns > self._max_gap_ns:
            # The memory of this site is lost; the present contact says nothing more.
            self._end_contact(previous_ns, complete=False)
            site.is_usable = False

    # Contact

    def _touch(self, onset: Onset) -> None:
        first = onset.samples[0]
        self._heed(self._hindsight.judge(self.newest_ns, before_ns=first.stamp_ns))
        self._onset = onset
        self._tilt.see(onset.samples[-1].tilt)
        site = self._site
        if site is None or site.is_elsewhere(onset):
            before = site
            self.site_count += 1
            site = Site(self.site_count, onset, self.config, self.rig, self.standing_flags)
            self._site = site
            left_ns = self._detector.left_unseen_ns
            is_doubted = left_ns is not None and dips(first.stamp_ns - left_ns)
            if is_doubted or (before is not None and before.leaves_doubt(first.stamp_ns)):
                site.withdraw()
        self.contact_count += 1
        site.check_history(onset)
        press = self._press = Press(
            self.contact_count,
            onset,
            site,
            self._detector.release_threshold,
            self.rejected,
            self._labeller,
            self.config,
        )
        if not site.has_failed:
            site.begin_contact(onset, self._synchronizer.path_noise())
            press.begin(site.change_count)
        self._emit_all(self._in_contact.begin(onset, press, site))

    def _end_contact(self, end_ns: int | None, *, complete: bool) -> None:
        press, site = self._press, self._site
        if press is None or site is None:
            return
        self._emit_all(self._in_contact.take_all(press, site))
        if end_ns is None:
            return
        if not press.has_ended:
            site.end_contact()
            self._in_contact.judge_units(end_ns, press, site, is_over=True)
            if not complete:
                press.see_missing(self.rejected)
            summary = press.summary(end_ns, self.rejected, complete=complete)
            if complete and summary.converged and not press.flags:
                self.rig = replace(site.rig() or self.rig, drift=self.rig.drift)
            summary = replace(summary, rig=self.rig)
            self._emit(summary)
            if complete and self._onset is not None:
                self._hindsight.begin(summary, site, self._onset)
        # An incomplete contact may go on: the probe has not left.
        if complete:
            self._press = None
            self._in_contact.end()
            if press.is_faint and not site.has_failed:
                # What comes next must not inherit its origin.
                self._forget(_Forget.SITE)

    def _heed(self, verdict: Verdict) -> None:
        """Learn from a contact in hindsight, and put out its second summary, if there is one."""
        if verdict.drift is not None:
            self.rig = self.rig.drifted(verdict.drift)
        summary = verdict.summary
        if summary is None:
            return
        if summary.estimate is None:
            self._labeller.forget(summary.site_id)
        self._emit(summary)

    def _hover(self, pair: Pair) -> None:
        """Put out a state in the air, one per duration of a block."""
        self._heed(self._hindsight.add(pair))
        if not self._in_contact.passes(pair.stamp_ns):
            return
        site = self._site
        estimate = site.usable_estimate if site is not None else None
        self._emit(
            TissueState(
                stamp_ns=pair.stamp_ns,
                # After a jump of the clock the probe may press on a tissue without a site.
                status=Status.UNKNOWN if self._detector.in_contact else Status.NO_CONTACT,
                flags=self.standing_flags | estimate_flags(estimate),
                site_id=site.site_id if site is not None else 0,
                contact_id=self.contact_count if site is not None else 0,
                phase=Phase.APPROACH,
                estimate=estimate,
                order_source=order_source(estimate, self.config.estimator),
            )
        )

    def _pass(self, pair: Pair, press: Press) -> None:
        """Let a sample of a contact go by in which the estimation failed."""
        press.count(press.net_force(pair, drifts=False))
        if self._in_contact.passes(pair.stamp_ns):
            self._emit(press.failed_state(pair.stamp_ns))

    # Outputs

    def _emit_all(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            self._emit(output)

    def _emit(self, output: Output) -> None:
        if isinstance(output, TissueState) and self.rejected.total() != self._rejected_reported:
            # Samples were rejected since the last state.
            self._rejected_reported = self.rejected.total()
            output = replace(output, flags=output.flags | Flag.INPUT_REJECTED)
        try:
            self._emit_output(output)
        except Exception as error:
            self._listener_error = error
            raise

    def _fail(self, stamp_ns: int, error: Exception) -> None:
        """Take note of an exception, and end the contact and the site it came from.

        What the listener to the outputs raised is raised again.
        """
        if error is self._listener_error:
            raise error
        press, site = self._press, self._site
        self.failure_count += 1
        site_id = site.site_id if site is not None else 0
        contact_id = press.contact_id if press is not None else 0
        if self._continuous is not None:
            site_id = contact_id = self._continuous.place_count
        self.failures.append(failure_of(error, stamp_ns, site_id, contact_id))
        self._in_contact.drop()
        self._end_continuous(Flag.ESTIMATION_FAILED)
        if site is None:
            return
        site.fail()
        self._labeller.forget(site.site_id)
        if press is None:
            return
        press.flags |= Flag.ESTIMATION_FAILED
        if not press.has_ended:
            self._emit(press.summary(stamp_ns, self.rejected, complete=False))
