# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The latest estimate with its age, or the reason why there is none to rely on.

What :class:`fden_ros.tissue_feed.TissueFeed` does with messages this does with states, so that a
closed loop can be simulated without ROS and by the same rules.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from fden_ros.control.prediction import Predictor
from fden_ros.control.tissue_memory import TissueMemory
from fden_ros.core.estimation import (
    NOTHING_UNKNOWN,
    Estimate,
    OtherLaw,
    ParameterSet,
    Uncertainty,
    other_along,
)
from fden_ros.core.law import SHORTEST_STEP, FlatPunch, Geometry
from fden_ros.core.measured_stiffness import NOT_MEASURED, BothWays
from fden_ros.core.outputs import WITHHELD, Flag, Phase, Status, TissueState
from fden_ros.core.streams import NANOSECONDS

#: With one of these the numbers may be wrong in a way that their deviations do not tell.
REFUSED_FLAGS = (
    Flag.GAP
    | Flag.MODEL_MISMATCH
    | Flag.TOUCH_NOT_OBSERVED
    | Flag.TISSUE_CHANGED
    | Flag.SATURATED
    | Flag.ESTIMATION_FAILED
    | Flag.AT_PRIOR_LIMIT
    | Flag.FORCE_DRIFTED
    | Flag.RIG_PRIOR_CONFLICT
    | Flag.ALPHA_PRIOR_CONFLICT
    | WITHHELD
)
#: The stress between two estimates is not known where they are farther apart than this time [s]
#: and than this multiple of the usual step [1], the median of the last steps: slow sensors leave
#: no gap, an estimate that was not heard does.
_LONGEST_STEP = 0.05
_LONGEST_STEP_RATIO, _USUAL_STEPS = 1.5, 9
#: Part of the largest stress of a contact [1] above which the tissue is loaded, whatever the law
#: says.
_UNLOADED_PART = 0.05
#: The force contradicts what was known where three estimates in a row are surprised by more than
#: 20 % of what was predicted and by five deviations.
_SURPRISING_PART = 0.2
_SURPRISING_NIS = 25.0
_SURPRISES = 3
#: How fast the least delay seen is forgotten, as clocks drift [s/s].
_DELAY_LEAK = 1e-4
#: An identifier without input says so once a second; without that for this time it is lost [s].
_STALE_PATIENCE = 3.0


class Refusal(enum.Enum):
    """Why there is no estimate to rely on."""

    NEVER_HEARD = "no estimate has come yet: is the identifier active?"
    LOST = "no estimate within the deadline: the identifier is frozen, killed or unreachable"
    LATE = "the estimates come later than the deadline: the identifier is overloaded"
    STALE = "the identifier has no input: are force and displacement published? is the bag over?"
    UNKNOWN = "the identifier does not know whether the probe touches: lift it and touch again"
    NO_CONTACT = "the probe is in the air"
    NOT_CONVERGED = "the data do not determine the tissue yet: press deeper"
    NOT_OBSERVABLE = "G is known, Gn is not observable: ask for G alone, or press deeper"
    CONTRADICTED = "the force is not what the estimate predicts, for the rest of the contact"
    REJECTED = "the estimate carries a flag that makes it unreliable"


#: In contact, but for what is late in the air.
_PRESSING = (Status.CONVERGING, Status.CONVERGED, Status.LATE)

_BY_STATUS = {
    Status.UNKNOWN: Refusal.UNKNOWN,
    Status.STALE: Refusal.STALE,
    Status.NO_CONTACT: Refusal.NO_CONTACT,
}
#: With these there is no state of this moment.
_WITHOUT_STATE = (Refusal.NEVER_HEARD, Refusal.LOST, Refusal.LATE, Refusal.STALE)


@dataclass(frozen=True)
class Reading:
    """An estimate that may be relied on at the time it was asked for.

    Of its parameters those that were required, and whatever else is in ``estimate.known``.
    """

    state: TissueState
    estimate: Estimate
    age: float  #: [s] since it arrived, and how much later than usual it did

    @property
    def linear_stiffness(self) -> float:
        """G [Pa s^alpha]."""
        return self.estimate.linear_stiffness

    @property
    def nonlinear_stiffness(self) -> float:
        """Gn [1]."""
        return self.estimate.nonlinear_stiffness

    def stiffness(self, time_scale: float) -> tuple[float, float]:
        """Return dF/dd and its deviation [N/m] for a small motion of `time_scale` seconds."""
        apparent = self.state.apparent_stiffness
        assert apparent is not None
        ratio = (time_scale / apparent.time_scale) ** -self.estimate.fractional_order
        return apparent.value * ratio, apparent.sd * ratio

    @property
    def measured(self) -> BothWays:
        """Slopes of force over displacement of the newest loading and unloading, by no law."""
        return self.state.measured


class LiveTissue:
    """What is known now, from estimates as they arrive.

    Parameters
    ----------
    geometry : Geometry
        As the identifier's: for forces and displacements of predictions.
    uncertainty : Uncertainty
        As the identifier's: what is not known of the rig counts in predictions.
    deadline : float
        An estimate older than this is refused [s].
    required : ParameterSet
        What must have converged: by default G and Gn. G alone is enough for the stiffness about
        the present strain; predictions need both.
    change : float
        `on_change` is called when the apparent stiffness has moved by more than this part.
    real_time : bool
        The stamps advance with the clock; false for bags played at another pace: then an estimate
        that was held up on its way is not told from a fresh one.
    on_change, on_loss : callable or None
        Called with a :class:`Reading`; with the :class:`Refusal`, once per loss.
    """

    def __init__(
        self,
        geometry: Geometry | None = None,
        *,
        uncertainty: Uncertainty = NOTHING_UNKNOWN,
        deadline: float = 0.1,
        required: ParameterSet = ParameterSet.STIFFNESS,
        change: float = 0.05,
        real_time: bool = True,
        on_change: Callable[[Reading], None] | None = None,
        on_loss: Callable[[Refusal], None] | None = None,
    ) -> None:
        self.geometry = geometry if geometry is not None else FlatPunch(area=1e-4, thickness=0.02)
        self._uncertainty = uncertainty
        self.deadline = deadline
        self.on_change = on_change
        self.on_loss = on_loss
        self.restarts = 0
        self._required = required
        self._change = change
        self._real_time = real_time
        self._state: TissueState | None = None
        self._arrival = -math.inf
        self._lag = 0.0
        self._least_delay = math.inf
        self._alive = True
        self._reported: Reading | None = None
        self._forget()

    def _forget(self) -> None:
        self._memory = TissueMemory(self.geometry)
        self._memory_site: int | None = None
        self._memory_ns = 0
        self._memory_whole = False
        self._steps: deque[float] = deque(maxlen=_USUAL_STEPS)
        self._peak_stress = 0.0
        self._surprises = 0
        self._contradicted: int | None = None

    # Input

    def add(self, state: TissueState, now: float) -> None:
        """Take an estimate that arrived at `now` [s], on a clock that never jumps."""
        before = self._state
        if before is not None and _started_again(before, state):
            self.restarts += 1
            self._least_delay = math.inf
            self._forget()
        self._alive = True
        self._watch_delay(state, now)
        self._state, self._arrival = state, now
        if state.status is not Status.STALE:
            self._remember(state)
            self._compare(state)
        self.check(now)

    def miss(self, now: float) -> None:
        """Take note that no estimate came within the deadline."""
        if self._state is not None and self._state.status is not Status.STALE:
            self._alive = False
        self.check(now)

    def lose(self, now: float) -> None:
        """Take note that the identifier is gone: until the next estimate."""
        self._alive = False
        self.check(now)

    def check(self, now: float) -> None:
        """Call back where something has changed; to be called at least once per deadline."""
        reading = self.reading(now)
        before = self._reported
        if reading is None:
            self._reported, refusal = None, self.refusal(now)
            if before is not None and self.on_loss is not None and refusal is not None:
                self.on_loss(refusal)
        elif before is None or self._has_changed(before, reading):
            self._reported = reading
            if self.on_change is not None:
                self.on_change(reading)

    # Output

    def refusal(self, now: float) -> Refusal | None:
        """Return why there is no estimate to rely on, or None if there is one."""
        refusal = self._without_estimate(now, REFUSED_FLAGS)
        if refusal is not None:
            return refusal
        state = self._state
        assert state is not None
        if state.estimate is None or state.apparent_stiffness is None or state.signals is None:
            return Refusal.NOT_CONVERGED
        if not self._is_known(state):
            is_linear = (
                ParameterSet.LINEAR_STIFFNESS in state.estimate.known
                and ParameterSet.NONLINEAR_STIFFNESS not in state.estimate.observable
            )
            return Refusal.NOT_OBSERVABLE if is_linear else Refusal.NOT_CONVERGED
        return Refusal.CONTRADICTED if self._contradicted == state.contact_id else None

    def _without_estimate(self, now: float, refused: Flag) -> Refusal | None:
        """Return why nothing of the present is to be relied on, whatever the estimate is."""
        state = self._state
        if state is None:
            return Refusal.NEVER_HEARD
        is_stale = state.status is Status.STALE
        patience = max(self.deadline, _STALE_PATIENCE) if is_stale else self.deadline
        if not self._alive or now - self._arrival > patience:
            return Refusal.LOST
        if state.status is Status.LATE or max(self._lag, state.lag) > self.deadline:
            return Refusal.LATE
        if state.flags & refused:
            return Refusal.REJECTED
        return _BY_STATUS.get(state.status)

    def reading(self, now: float) -> Reading | None:
        """Return the latest estimate if it may be relied on."""
        state = self._state
        if self.refusal(now) is not None or state is None or state.estimate is None:
            return None
        age = max(now - self._arrival, 0.0) + max(self._lag, state.lag)
        return Reading(state, state.estimate, age)

    def stiffness(self, now: float, time_scale: float) -> tuple[float, float] | None:
        """Return dF/dd and its deviation [N/m] for a small motion of `time_scale` [s], or None.

        Of tissue of another law, MODEL_MISMATCH, it is that law's.
        """
        reading, other = self.reading(now), self._other_law(now)
        if reading is not None:
            return reading.stiffness(time_scale)
        apparent = self._state.apparent_stiffness if self._state is not None else None
        if apparent is None or other is None:
            return None
        law = other_along(self.geometry, other, other.mean)
        ratio = law.relaxation(time_scale) / law.relaxation(apparent.time_scale)
        return apparent.value * ratio, apparent.sd * ratio

    def measured(self, now: float) -> BothWays:
        """Return the newest measured slopes: they need no estimate, but an identifier in time."""
        state = self._state
        if state is None or self.refusal(now) in _WITHOUT_STATE:
            return NOT_MEASURED
        return state.measured

    def predictor(self, now: float) -> Predictor | None:
        """Return the tissue as it is at the latest estimate, for several predictions.

        None if there is no estimate to rely on, if Gn is not known, which says how the tissue
        stiffens, or if its contact was not heard from the touch on: the memory is not known then.
        Tissue of another law, MODEL_MISMATCH, is predicted by that.
        """
        state = self._state
        if state is None or state.estimate is None or state.signals is None:
            return None
        is_known = self.refusal(now) is None and state.estimate.converged
        if not self._memory_whole or not (is_known or self._other_law(now)):
            return None
        return Predictor(
            self.geometry,
            state.estimate,
            self._memory.copy(),
            state.signals.stress,
            state.innovation.variance if state.innovation is not None else 0.0,
            self._uncertainty,
        )

    # Inside

    def _other_law(self, now: float) -> OtherLaw | None:
        """Return the other law that the tissue has, where nothing else is against the estimate."""
        state = self._state
        if state is None or state.estimate is None or not state.flags & Flag.MODEL_MISMATCH:
            return None
        if self._without_estimate(now, REFUSED_FLAGS & ~Flag.MODEL_MISMATCH) is not None:
            return None
        return state.estimate.other_law

    def _is_known(self, state: TissueState) -> bool:
        """Whether what is required has converged."""
        if ParameterSet.STIFFNESS in self._required and state.status is not Status.CONVERGED:
            return False
        return state.estimate is not None and self._required in state.estimate.known

    def _watch_delay(self, state: TissueState, now: float) -> None:
        """Measure how much later than the quickest one an estimate has come."""
        if not self._real_time or state.status is Status.STALE:
            return
        delay = now - state.stamp_ns / NANOSECONDS
        idle = now - self._arrival if math.isfinite(self._arrival) else 0.0
        self._least_delay = min(self._least_delay + _DELAY_LEAK * idle, delay)
        self._lag = delay - self._least_delay

    def _compare(self, state: TissueState) -> None:
        """Take note when a converged estimate is surprised several times in a row."""
        innovation = state.innovation
        if not self._is_known(state) or innovation is None:
            self._surprises = 0
            return
        predicted = innovation.predicted_stress
        if predicted is None:
            predicted = innovation.predicted_fractional_stress
        surprised = (
            abs(innovation.innovation) > _SURPRISING_PART * abs(predicted)
            and innovation.normalized_squared > _SURPRISING_NIS
        )
        self._surprises = self._surprises + 1 if surprised else 0
        if self._surprises >= _SURPRISES:
            self._contradicted = state.contact_id

    def _has_changed(self, old: Reading, new: Reading) -> bool:
        if old.state.contact_id != new.state.contact_id:
            return True
        before, after = old.stiffness(0.1)[0], new.stiffness(0.1)[0]
        return abs(after - before) > self._change * before

    def _remember(self, state: TissueState) -> None:
        """Follow the stress of the present site; nothing touches it between contacts."""
        if state.site_id != self._memory_site:
            # Heard from the air on, nothing of a new site is missed.
            heard = self._memory_site is not None or _is_in_air(state)
            self._memory = TissueMemory(self.geometry)
            self._memory_site = state.site_id
            self._memory_whole = heard and (
                state.site_id == 0 or self._memory_ns > 0 or state.contact_id == 0
            )
            if self._memory_ns == 0:
                self._memory_ns = state.stamp_ns
                return
        step = (state.stamp_ns - self._memory_ns) / NANOSECONDS
        if step < SHORTEST_STEP:
            return
        in_contact = state.status in _PRESSING and not _is_in_air(state)
        if self._is_gap(step) and (in_contact or self._memory.strain > 0.0):
            self._memory_whole = False
        self._steps.append(step)
        signals, estimate = state.signals, state.estimate
        is_free = signals is None or not in_contact
        stress = signals.stress if signals is not None else 0.0
        self._peak_stress = max(self._peak_stress, stress) if in_contact else 0.0
        if signals is not None and estimate is not None and self._is_unloaded(stress):
            is_free |= self._memory.is_free(step, signals.strain, estimate)
        if signals is None or is_free:
            self._memory.rest(step)
        else:
            self._memory.press(step, signals.strain, signals.stress)
        self._memory_ns = state.stamp_ns

    def _is_unloaded(self, stress: float) -> bool:
        """Whether a stress [Pa] is so small that the tissue may have left the probe.

        The law alone does not say so: where it is off by a fifth, pressed tissue would seem free.
        """
        return stress <= _UNLOADED_PART * self._peak_stress

    def _is_gap(self, step: float) -> bool:
        """Whether an estimate may have been missed in the `step` seconds since the last."""
        usual = median(self._steps) if self._steps else 0.0
        return step > max(_LONGEST_STEP, _LONGEST_STEP_RATIO * usual)


def _is_in_air(state: TissueState) -> bool:
    """Return whether a state, late or not, says that nothing is touched."""
    is_late = state.status is Status.LATE and state.phase is Phase.APPROACH
    return is_late or state.status is Status.NO_CONTACT


def _started_again(before: TissueState, after: TissueState) -> bool:
    """Return whether the counts or the stamps began anew."""
    return (
        after.contact_id < before.contact_id
        or after.site_id < before.site_id
        or after.stamp_ns < before.stamp_ns
    )
