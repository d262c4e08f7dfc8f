# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The whole chain from samples to classified tissue, the same for live, replay and batch.

Samples of force and displacement go in, each stream in its own order; :class:`TissueState`,
:class:`Classification`, :class:`ContactSummary` and, where the probe oscillates,
:class:`DynamicModulus` come out through a callback. Time is taken from the stamps alone.
"""

from __future__ import annotations

import math
import reprlib
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact_session import ContactSession
from fden_ros.core.continuous_session import ContinuousSession
from fden_ros.core.input_warnings import Direction, input_warnings
from fden_ros.core.outputs import (
    ContactSummary,
    Failure,
    Flag,
    Output,
    TissueState,
    failure_of,
)
from fden_ros.core.plausibility import stands_against
from fden_ros.core.stiffness import MeasuredSlopes, Slopes
from fden_ros.core.streams import (
    NANOSECONDS,
    Pair,
    Position,
    Quaternion,
    Reason,
    StaticLinks,
    Synchronizer,
    Transform,
    Vector,
    gap_before,
)


class Pipeline:
    """From samples to :class:`TissueState`, :class:`Classification` and :class:`ContactSummary`.

    Parameters
    ----------
    emit : callable
        Called with every output, in order of stamps. Its exceptions are not caught.
    """

    def __init__(self, config: PipelineConfig, emit: Callable[[Output], None]) -> None:
        self.config = config
        #: Counts of rejected samples, keyed ``"<stream>.<reason>"``.
        self.rejected: Counter[str] = Counter()
        self.pair_count = 0  #: pairs so far
        self.newest_ns = 0  #: stamp of the newest pair
        #: The newest exceptions of the computation. Each ended one contact and its site, both
        #: flagged :attr:`Flag.ESTIMATION_FAILED`; the next site starts anew.
        self.failures: deque[Failure] = deque(maxlen=20)
        self.failure_count = 0  #: how many there were
        #: Problems with every estimate from the start, a sentence each, and their flags.
        self.problems, self.standing_flags = _problems(config)
        self._clock_jumps = 0
        self._tare_offset = 0.0
        # They come once, and outlive a reset.
        self._statics = StaticLinks()
        self._max_gap_ns = round(config.synchronize.max_gap * NANOSECONDS)
        self._direction = Direction()
        self._measured = MeasuredSlopes(config)
        self._emit = emit
        self._raised: Exception | None = None  # by the listener to the outputs
        self._restart_streams()
        self._session: ContactSession | ContinuousSession
        if config.is_continuous:
            self._session = ContinuousSession(config, self.rejected)
        else:
            self._session = ContactSession(
                config, self.rejected, self._path_noise, self.standing_flags
            )
        self._begin_epoch(0)

    def _begin_epoch(self, epoch: int) -> None:
        self._epoch = epoch
        self._rejected_before = self.rejected.total()

    def _restart_streams(self) -> None:
        self._synchronizer = Synchronizer(
            self.config.synchronize, self._on_pair, self.rejected, self._statics
        )
        self._epoch = 0

    def _path_noise(self) -> float:
        """Return the noise of the motion so far, from the streams."""
        return self._synchronizer.path_noise()

    @property
    def site_count(self) -> int:
        """Sites so far."""
        return self._session.site_count

    @property
    def contact_count(self) -> int:
        """Contacts so far."""
        return self._session.contact_count

    @property
    def in_contact(self) -> bool:
        """Whether the probe presses."""
        return self._session.in_contact

    def force_ahead(self, times: Array, displacements: Array) -> tuple[Array, Array] | None:
        """Return mean and standard deviation [N] of the force of a motion to come, (n,) each.

        Given the data, with the errors of law and rig (kriging). None: the probe is not in
        contact, or nothing is known of the tissue.

        Parameters
        ----------
        times : ndarray, shape (n,)
            From the newest sample [s], increasing.
        displacements : ndarray, shape (n,)
            As they would be measured [m].
        """
        session = self._session
        if isinstance(session, ContinuousSession):
            return None
        return session.force_ahead(times, displacements)

    @property
    def measured_unseen(self) -> Slopes:
        """Slopes of force over displacement outside of any contact, where it was deepest."""
        return self._measured.unseen

    @property
    def never_lifts(self) -> bool:
        """Whether the probe palpates without lifting, so that its contacts do not count."""
        return self._session.never_lifts

    @property
    def is_air_doubted(self) -> bool:
        """Whether the force fell below its value in the air, as with the wrong sign.

        With the right signs it did so where a touch was not observed.
        """
        return self._session.air_events[0] > 0 and self._direction.cause != "touch"

    # Inputs

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N], positive when pressing; with torsion a torque [N m]."""
        _check(stamp_ns, force)
        # Where frames move, the force is tared after its projection into the base.
        offset = 0.0 if self.config.synchronize.frames is not None else self._tare_offset
        self._feed(self._synchronizer.add_force, stamp_ns, force - offset)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        """Add a displacement [m], positive into the tissue, and the position where known [m].

        `load` is the part of the tool's weight in the force at this orientation [N], `turn` the
        probe's orientation where it advances along its own axis.
        """
        _check(stamp_ns, displacement)
        add = self._synchronizer.add_displacement
        self._feed(add, stamp_ns, displacement, position, load, turn)

    def add_force_vector(self, stamp_ns: int, frame: str, force: Vector) -> None:
        """Add a force [N], or with torsion a torque [N m], in a frame that moves."""
        self._feed(self._synchronizer.add_force_vector, stamp_ns, frame, force)

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
        """Add where a frame is in its parent [m], and its rotation as a quaternion."""
        place = Transform(translation, rotation)
        add = self._synchronizer.add_transform
        self._feed(add, stamp_ns, parent, child, place, is_static=is_static)

    def _feed(self, add: Callable[..., None], stamp_ns: int, *sample: Any, **named: Any) -> None:
        try:
            add(stamp_ns, *sample, **named)
        except Exception as error:
            self._fail(stamp_ns, error)
            self._restart_streams()

    def reject(self, stream: str, reason: str) -> None:
        """Count a sample that could not be read."""
        self.rejected[f"{stream}.{reason}"] += 1

    def tare(self) -> str | None:
        """Take the present force as zero; return None, or why that is not possible now."""
        zero = self._session.zero()
        if isinstance(zero, str):
            return zero
        self._tare_offset += zero
        self._measured.skip()
        return None

    def reset(self) -> str | None:
        """Reset all that was learned; return None, or why that is not possible now."""
        if self._session.in_contact:
            return "the probe is in contact: lift it, then reset"
        self._put(self._session.break_off(self.newest_ns))
        self._session.forget()
        self._measured.forget()
        self._restart_streams()
        self._begin_epoch(0)
        return None

    def finish(self) -> None:
        """End the input: report the contact that is still open."""
        try:
            self._put(self._session.finish(self.newest_ns))
        except Exception as error:
            self._fail(self.newest_ns, error)

    @property
    def transform_problem(self) -> str:
        """Why no force has found its transforms yet, in words; empty: no problem."""
        frames = self._synchronizer.frames
        return "" if self.pair_count or frames is None else frames.problem

    @property
    def is_failed(self) -> bool:
        """Whether the newest failure is of the present site, or of none."""
        return bool(self.failures) and self.failures[-1].site_id == self._session.place[0]

    @property
    def unusual_rejections(self) -> int:
        """Rejected samples, without the usual first two that have no partner."""
        return self.rejected.total() - min(self.rejected[f"force.{Reason.UNPAIRED}"], 2)

    @property
    def warnings(self) -> dict[str, int]:
        """Problems of the input, in words, with counts."""
        odd = input_warnings(
            self.config.synchronize,
            self._synchronizer,
            self._session.air_events,
            self._direction,
            self.rejected,
            self._clock_jumps,
        )
        found = {words: n for words, n in self._session.warnings.items() if words and n}
        # Of what was no air, a sign that is wrong comes first.
        first, then = (odd, found) if self.is_air_doubted else (found, odd)
        return {**dict.fromkeys(self.problems, 1), **first, **then}

    # Pairs

    def _on_pair(self, pair: Pair) -> None:
        if self.config.synchronize.frames is not None and self._tare_offset:
            # Only here is the force along the axis.
            pair = pair._replace(force=pair.force - self._tare_offset)
        self._direction.add(pair)
        try:
            if pair.epoch != self._epoch:
                self._clock_jumps += 1
                self._put(self._session.break_off(self.newest_ns))
                self._session.forget(keeps_contact=True)
                self._measured.forget()
                self._begin_epoch(pair.epoch)
            gap_ns = gap_before(pair, self.newest_ns) if self.pair_count else 0
            if gap_ns:
                is_long = gap_ns > self._max_gap_ns
                self._put(self._session.see_gap(self.newest_ns, is_long=is_long))
                self._measured.skip()
            self.pair_count += 1
            self.newest_ns = pair.stamp_ns
            self._measured.add(pair)
            self._put(self._session.take(pair))
            session = self._session
            if self._measured.is_saturated and session.in_contact:
                session.withdraw(Flag.SATURATED)
            self._measured.assign(
                session.contact_count, session.air, session.surface, in_contact=session.in_contact
            )
        except Exception as error:
            self._fail(pair.stamp_ns, error)

    def _put(self, outputs: Iterable[Output]) -> None:
        """Pass outputs to the listener, with the rejections and slopes so far."""
        for output in map(self._completed, outputs):
            try:
                self._emit(output)
            except Exception as error:
                self._raised = error
                raise

    def _completed(self, output: Output) -> Output:
        if isinstance(output, ContactSummary):
            slopes = self._measured.of(output.contact_id)
            # The surface may have turned out to be none.
            hidden = Flag.TOUCH_NOT_OBSERVED in output.flags
            return replace(output, measured=slopes.below(math.nan) if hidden else slopes)
        if not isinstance(output, TissueState):
            return output
        if self.rejected.total() != self._rejected_before:
            self._rejected_before = self.rejected.total()
            output = replace(output, flags=output.flags | Flag.INPUT_REJECTED)
        return replace(output, measured=self._measured.newest)

    def _fail(self, stamp_ns: int, error: Exception) -> None:
        """Record an exception, and end the contact and the site that it came from.

        An exception of the listener to the outputs is raised again.
        """
        if error is self._raised:
            raise error
        self.failure_count += 1
        self.failures.append(failure_of(error, stamp_ns, *self._session.place))
        self._put(self._session.fail(stamp_ns))


def _problems(config: PipelineConfig) -> tuple[tuple[str, ...], Flag]:
    """Return the problems with every estimate, in words and as flags."""
    is_stated = config.geometry.is_stated
    words = stands_against(config.geometry)
    if not words or (config.is_continuous and not is_stated):
        return (), Flag.NONE  # a stiffness in N/m needs no geometry
    return (words,), Flag.IMPLAUSIBLE if is_stated else Flag.GEOMETRY_UNSTATED


def _check(stamp_ns: object, value: object) -> None:
    """Refuse a stamp that is no whole number, and arrays."""
    if type(stamp_ns) is int and type(value) is float:
        return  # as nearly always: a check of an abstract class takes five times as long
    if not isinstance(stamp_ns, Integral):
        raise TypeError(
            f"stamp_ns is {_brief(stamp_ns)}: give whole nanoseconds, round(1e9 * seconds)"
        )
    if not isinstance(value, Real):
        raise TypeError(f"a sample is {_brief(value)}: give one number at a time")


def _brief(value: object) -> str:
    """Return a value in one line, a long one without its middle."""
    return " ".join(reprlib.repr(value).split())
