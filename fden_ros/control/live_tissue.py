# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The latest reliable estimate with its age, or the reason why there is none.

It works on states, as :class:`fden_ros.tissue_feed.TissueFeed` does on messages, so a closed loop
can be simulated without ROS by the same rules.
"""

from __future__ import annotations

import copy
import enum
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from fden_ros.control.prediction import Predictor, TissueMemory
from fden_ros.core.estimation import NOTHING_UNKNOWN, Estimate, Uncertainty
from fden_ros.core.law import SHORTEST_STEP, Geometry
from fden_ros.core.outputs import Flag, Phase, Status, TissueState
from fden_ros.core.stiffness import NOT_MEASURED, Slopes
from fden_ros.core.streams import NANOSECONDS
from fden_ros.errors import InputError

#: With these the numbers of the law may be off by more than their sd; a measured slope holds.
LAW_FLAGS = (
    Flag.MODEL_MISMATCH
    | Flag.AT_PRIOR_LIMIT
    | Flag.RIG_PRIOR_CONFLICT
    | Flag.ALPHA_PRIOR_CONFLICT
    | Flag.GEOMETRY_UNSTATED
)
#: With one of the other statuses there is no reliable estimate.
REFUSED_FLAGS = ~Flag.INPUT_REJECTED
#: N/m is stated from this number of its standard deviations on, as the measured slope is.
_STATED_FROM = 4.0
#: The stress between two estimates is not known where they are farther apart than this time [s]
#: and than this multiple of the step before [1]: a slow sensor leaves no gap, a lost estimate
#: does.
_LONGEST_STEP, _LONGEST_STEP_RATIO = 0.05, 1.5
#: Part of the largest stress of a contact [1] above which the tissue is loaded, whatever the law
#: says: where the law is off by a fifth, pressed tissue would seem free.
_UNLOADED_PART = 0.05
#: Rate at which the least delay is forgotten, because clocks drift [s/s].
_DELAY_LEAK = 1e-4
#: An identifier without input reports so once a second; after this time of silence it is lost [s].
_STALE_PATIENCE = 3.0


class Cause(enum.Enum):
    """Why there is no reliable estimate."""

    NEVER_HEARD = "no estimate has come yet: is the identifier active?"
    LOST = "no estimate within the deadline: the identifier is frozen, killed or unreachable"
    LATE = "the estimates come later than the deadline: the identifier is overloaded"
    STALE = "the identifier has no input: are force and displacement published? is the bag over?"
    TWO_PUBLISHERS = "two nodes publish the estimate: stop one, or give it another name"
    UNKNOWN = "the identifier does not know whether the probe touches: lift it and touch again"
    NO_CONTACT = "the probe is in the air"
    NOT_CONVERGED = "the data do not determine the tissue yet: press on, deeper, or hold for 2 s"
    NOT_OBSERVABLE = "G is known, Gn is not observable: press deeper; stiffness() gives N/m"
    REJECTED = "the estimate carries a flag that makes it unreliable"


@dataclass(frozen=True)
class Refusal:
    """Why there is no reliable estimate, with the flags of the newest one."""

    cause: Cause
    flags: Flag = Flag.NONE  #: those that make an estimate unreliable

    def __str__(self) -> str:
        names = ", ".join(str(flag.name) for flag in Flag if flag & self.flags)
        return f"{self.cause.value} ({names})" if names else self.cause.value


class Stiffness(NamedTuple):
    """dF/dd, from the law or measured."""

    value: float  #: [N/m]
    sd: float  #: its standard deviation [N/m]
    #: Of a measured slope: its depth below the surface [m]; None: it is the present N/m from the
    #: law.
    depth: float | None = None


_BY_STATUS = {s: Cause[s.name] for s in (Status.UNKNOWN, Status.STALE, Status.NO_CONTACT)}
#: With these there is no state of this moment.
_WITHOUT_STATE = (Cause.NEVER_HEARD, Cause.LOST, Cause.LATE, Cause.STALE, Cause.TWO_PUBLISHERS)
#: With these N/m or a measured slope may be known.
_WITH_STIFFNESS = (None, Cause.NOT_CONVERGED, Cause.NOT_OBSERVABLE, Cause.REJECTED)


@dataclass(frozen=True)
class Reading:
    """A reliable estimate at the time of the request: G and Gn are known."""

    state: TissueState
    estimate: Estimate
    age: float  #: [s] since its arrival, with its extra delay


class LiveTissue:
    """The present data, from estimates as they arrive; calls from several threads are safe.

    `now` is the time by a clock that never jumps [s], or ``time.monotonic``. Parameters are those
    of :class:`fden_ros.tissue_feed.TissueFeed`; `restarts` counts restarts of the identifier,
    each of which erases its memory of the tissue.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        *,
        uncertainty: Uncertainty = NOTHING_UNKNOWN,
        deadline: float = 0.1,
        real_time: bool = True,
        on_loss: Callable[[Refusal], None] | None = None,
    ) -> None:
        self.deadline, self.restarts = deadline, 0
        self._geometry, self._uncertainty = geometry, uncertainty
        self._real_time, self._on_loss = real_time, on_loss
        self._lock = threading.RLock()
        self._state: TissueState | None = None
        self._arrival = -math.inf
        self._lag, self._least_delay = 0.0, math.inf
        self._publishers = 1
        self._is_relied_on = False
        self._forget()

    def _forget(self) -> None:
        self._memory, self._memory_site, self._memory_ns = TissueMemory(), -1, 0
        self._is_memory_whole, self._step, self._peak_stress = False, 0.0, 0.0

    # Input

    def add(self, state: TissueState, now: float | None = None) -> None:
        """Add an estimate that arrived at `now`."""
        now = _time(now)
        with self._lock:
            # Counts or stamps that begin again show a restart of the identifier.
            order = [(s.contact_id, s.site_id, s.stamp_ns) for s in (self._state or state, state)]
            if any(new < old for old, new in zip(*order, strict=True)):
                self.restarts += 1
                self._least_delay = math.inf
                self._forget()
            self._watch_delay(state, now)
            self._state, self._arrival = state, now
            if state.status is not Status.STALE:
                self._remember(state)
            self.check(now)

    def count_publishers(self, alive: int, now: float | None = None) -> None:
        """Set the number of nodes that publish the estimate; 0: the identifier is gone."""
        with self._lock:
            self._publishers = alive
            self.check(now)

    def check(self, now: float | None = None) -> None:
        """Call back after a loss; to be called at least once per deadline."""
        with self._lock:
            before, refusal = self._is_relied_on, self.refusal(now)
            self._is_relied_on = refusal is None
            if before and refusal is not None and self._on_loss is not None:
                self._on_loss(refusal)

    # Output

    def refusal(self, now: float | None = None) -> Refusal | None:
        """Return why there is no reliable estimate; None if there is one."""
        with self._lock:
            state, cause = self._state, self._cause(_time(now))
            flags = state.flags & REFUSED_FLAGS if state is not None else Flag.NONE
            return Refusal(cause, flags) if cause is not None else None

    def reading(self, now: float | None = None) -> Reading | None:
        """Return the latest estimate if it is reliable, else None."""
        now = _time(now)
        with self._lock:
            state = self._state
            if state is None or state.estimate is None or self._cause(now) is not None:
                return None
            age = max(now - self._arrival, 0.0) + max(self._lag, state.lag)
            return Reading(state, state.estimate, age)

    def stiffness(self, time_scale: float = 0.1, now: float | None = None) -> Stiffness | None:
        """Return dF/dd for a small motion of `time_scale` [s], or None.

        N/m from the law if that is known, else the slope of the newest loading if that is.
        """
        with self._lock:
            state, cause = self._state, self._cause(_time(now))
            if state is None or cause not in _WITH_STIFFNESS:
                return None
            refused, slope = state.flags & REFUSED_FLAGS, state.measured.loading
            law, estimate = state.apparent_stiffness, state.estimate
            if law is not None and estimate is not None and not refused:
                ratio = (time_scale / law.time_scale) ** -estimate.fractional_order
                if law.value > _STATED_FROM * law.sd:
                    return Stiffness(law.value * ratio, law.sd * ratio)
            if slope is None or refused & ~LAW_FLAGS:
                return None
            return Stiffness(slope.value, slope.sd, slope.depth)

    def measured(self, now: float | None = None) -> Slopes:
        """Return the measured slopes; none while no estimate arrives in time."""
        with self._lock:
            if self._state is None or self._cause(_time(now)) in _WITHOUT_STATE:
                return NOT_MEASURED
            return self._state.measured

    def predictor(self, now: float | None = None) -> Predictor | None:
        """Return the tissue as it is at the latest estimate, for several predictions.

        None if there is no reliable estimate, or the memory is not known because estimates since
        the touch are missing. :class:`InputError` if there is no geometry.
        """
        if self._geometry is None:
            raise InputError("a prediction needs a geometry: give parameters= or geometry=")
        with self._lock:
            reading = self.reading(now)
            if reading is None or not self._is_memory_whole:
                return None
            innovation = reading.state.innovation
            return Predictor(
                self._geometry,
                reading.estimate,
                copy.deepcopy(self._memory),
                innovation.variance if innovation is not None else 0.0,
                self._uncertainty,
            )

    # Private

    def _cause(self, now: float) -> Cause | None:
        state = self._state
        if self._publishers > 1:
            return Cause.TWO_PUBLISHERS
        if state is None:
            return Cause.NEVER_HEARD
        is_stale = state.status is Status.STALE
        patience = max(self.deadline, _STALE_PATIENCE) if is_stale else self.deadline
        if not self._publishers or now - self._arrival > patience:
            return Cause.LOST
        if state.status is Status.LATE or max(self._lag, state.lag) > self.deadline:
            return Cause.LATE
        if state.flags & REFUSED_FLAGS:
            return Cause.REJECTED
        if state.status in _BY_STATUS:
            return _BY_STATUS[state.status]
        own = state.estimate
        has_content = own and state.apparent_stiffness and state.signals
        if state.status is Status.CONVERGED and has_content:
            return None
        is_linear = own is not None and own.knows(0) and not own.determines(1)
        return Cause.NOT_OBSERVABLE if is_linear else Cause.NOT_CONVERGED

    def _watch_delay(self, state: TissueState, now: float) -> None:
        """Measure how much later than the quickest one an estimate arrived."""
        if not self._real_time or state.status is Status.STALE:
            return
        delay = now - state.stamp_ns / NANOSECONDS
        idle = now - self._arrival if math.isfinite(self._arrival) else 0.0
        self._least_delay = min(self._least_delay + _DELAY_LEAK * idle, delay)
        self._lag = delay - self._least_delay

    def _remember(self, state: TissueState) -> None:
        """Follow the stress of the present site; nothing touches it between contacts."""
        is_late_air = state.status is Status.LATE and state.phase is Phase.APPROACH
        is_air = is_late_air or state.status is Status.NO_CONTACT
        if state.site_id != self._memory_site:
            # If estimates since the air arrived, none of a new site is missing.
            is_first = self._memory_site < 0
            self._is_memory_whole = is_air or not is_first
            self._memory, self._memory_site = TissueMemory(), state.site_id
            if is_first:
                self._memory_ns = state.stamp_ns
                return
        step = (state.stamp_ns - self._memory_ns) / NANOSECONDS
        if step < SHORTEST_STEP:
            return
        in_contact = not is_air and state.status is not Status.UNKNOWN
        is_gap = step > max(_LONGEST_STEP, _LONGEST_STEP_RATIO * self._step)
        if is_gap and (in_contact or self._memory.strain > 0.0):
            self._is_memory_whole = False
        self._step, self._memory_ns = step, state.stamp_ns
        signals, estimate = state.signals, state.estimate
        if signals is None or not in_contact:
            self._peak_stress = 0.0
            self._memory.press(step, 0.0, 0.0)
            return
        self._peak_stress = max(self._peak_stress, signals.stress)
        is_unloaded = signals.stress <= _UNLOADED_PART * self._peak_stress
        if is_unloaded and estimate and self._memory.is_free(step, signals.strain, estimate):
            self._memory.press(step, 0.0, 0.0)
        else:
            self._memory.press(step, signals.strain, signals.stress)


def _time(now: float | None) -> float:
    return time.monotonic() if now is None else now
