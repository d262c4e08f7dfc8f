# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The motion to make next: a search over depth, speed, hold and oscillation, and what to expect.

A motion is judged by the deviations that are wanted: the geometric mean over tissues of the root
of the summed squares of their ratios to the targets. Of the motions within 5 % of the best the
shortest is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Parts, ended
from fden_ros.errors import InputError
from fden_ros.planning.forecast import Expected, Forecast, Stated
from fden_ros.planning.motion import FREQUENCY, Motion, Sensors
from fden_ros.planning.remedies import WORDS, Case, quantity, remedy, uncover
from fden_ros.planning.tissue import TissueBelief

#: Tissues by which motions are compared, of which the estimator's own deviations are found, for
#: which the probability is stated, and for which forces are limited [1].
_COMPARED, _STATED, _COUNTED, _LIMITED = 4, 1, 12, 24
#: Presses that are planned at most [1].
MOST_PRESSES = 3
#: Part of the tissues in which a limit may be exceeded [1].
_EXCEEDED = 0.05
#: A motion is as good as the best within this [1].
_AS_GOOD = 1.05
#: A target is said to be possible from this probability on [1].
POSSIBLE = 0.8
#: A press is worth it from this probability of the target on [1].
WORTH_IT = 0.25
#: Depths over the largest, slower speeds over the largest [1], and holds [s] that are tried; the
#: second depth shows where the law's own error is larger than the noise.
_DEPTHS, _SLOWER, _HOLDS = (1.0, 0.7), (0.6, 0.2), (0.25, 1.0, 4.0)
#: Oscillation that is tried: over the depth [1], and cycles [1].
_AMPLITUDE, _CYCLES = 0.05, 2
#: Strain beyond which nobody presses unless it is allowed [1], usual largest speed [m/s], longest
#: time [s].
_USUAL_STRAIN, _USUAL_SPEED, _USUAL_TIME = 0.3, 0.02, 10.0
#: White noise of the force [N/sqrt(Hz)] from which a faster press than this [m/s] tells less: 20
#: mN a sample at 500 Hz. Of an arm's simulated presses (docs/ur.md) with 20 and 50 mN, in five
#: cases of depth and hold, the deviation of G was 11 to 61 % larger at 20 mm/s than at 8 mm/s,
#: and its error twice as large. With 10 mN the deviations are alike, with 1 mN fast is better.
_LOUD, _SPEED_OF_LOUD = 0.02 / math.sqrt(500.0), 0.008
NAMES = ("G", "Gn", "alpha")
LIMITS = ("depth", "force", "speed", "time")
#: Times closer than this are the same [s]: a depth that takes just the time allowed is rounded.
_SAME_TIME = 1e-9


@dataclass(frozen=True)
class Limits:
    """What a motion may do.

    Attributes
    ----------
    depth, force, speed, time : float
        Largest depth [m], force [N], speed [m/s] and duration [s].
    """

    depth: float
    force: float
    speed: float = _USUAL_SPEED
    time: float = _USUAL_TIME

    @classmethod
    def usual(cls, config: PipelineConfig, sensors: Sensors | None = None) -> Limits:
        """Return those of a configuration, and of its sensors, that nobody has limited further."""
        depth = config.geometry.length * config.geometry.compression(_USUAL_STRAIN)
        # Rounded: 20 mN as configure writes them are as loud.
        is_loud = sensors is not None and sensors.force_sd >= 0.9 * _LOUD * math.sqrt(sensors.rate)
        speed = _SPEED_OF_LOUD if is_loud else _USUAL_SPEED
        force = min(config.synchronize.force_limit, config.plausibility.most_force)
        return cls(depth, force, speed)

    def stated(self, **limits: float | None) -> Limits:
        """Return these with what is stated of depth, force, speed and time, and is not 0."""
        return replace(self, **{name: value for name, value in limits.items() if value})


@dataclass(frozen=True)
class Target:
    """Standard deviations of ln G, ln Gn and alpha that are wanted [1]; infinite: any."""

    deviations: Sequence[float]

    @classmethod
    def converged(cls, config: PipelineConfig) -> Target:
        """Return what a contact takes to converge."""
        own = config.estimator
        return cls((own.converged_log_g_sd, own.converged_log_gn_sd, math.inf))

    def ratios(self, deviations: Array) -> Array:
        """Return deviations (..., 3) over those that are wanted, (..., 3)."""
        result: Array = deviations / np.array(self.deviations)
        return result


@dataclass(frozen=True)
class Plan:
    """One motion and what to expect of it.

    Attributes
    ----------
    motion : Motion
    deviations : ndarray, shape (3,)
        Medians of those of ln G, ln Gn and alpha that will be stated [1].
    probability : float
        Of the target, after one press [1].
    presses : int
        So many of the same place meet the target; 0: not possible.
    force : float
        That 95 % of the tissues stay below [N].
    cause : str
        What limits the deviations where the target is not possible, and what would change it.
    target : Target
    """

    motion: Motion
    deviations: Array
    probability: float
    presses: int
    force: float
    cause: str
    target: Target

    @property
    def is_possible(self) -> bool:
        """Whether the target can be met."""
        return self.presses > 0

    @property
    def is_worth_it(self) -> bool:
        """Whether the target may well be met, and a press tells whether it is."""
        return self.is_possible or self.probability >= WORTH_IT

    def numbers(self) -> dict[str, Any]:
        """Return what ``fden plan --json`` prints of it; SI units."""
        return {
            "possible": self.is_possible,
            "presses": self.presses,
            "probability": self.probability,
            "deviations": dict(zip(("g", "g_n", "alpha"), self.deviations.tolist(), strict=True)),
            **asdict(self.motion),
            "seconds": self.motion.seconds,
            "force": self.force,
            "cause": self.cause,
        }

    def line(self) -> str:
        """Return the plan in one line."""
        found = ", ".join(
            f"{name} to {100.0 * sd:.2g} %" if name != "alpha" else f"alpha to {sd:.2g}"
            for name, sd in zip(NAMES, self.deviations.tolist(), strict=True)
            if sd > 0.0
        )
        words = f"{_words(self.motion)}: {found}"
        chance = f"the target with {100.0 * self.probability:.0f} %"
        if not self.is_worth_it:
            return f"not possible: {self.cause}; at best {words}"
        if self.presses > 1:
            chance += f", or after {self.presses} such presses"
        return f"{words}; {chance}"


def _words(motion: Motion) -> str:
    """Return a motion in words."""
    parts = [f"press to {quantity(motion.depth, 'm')} at {quantity(motion.speed, 'm')}/s"]
    parts.append(f"hold for {motion.hold:.2g} s")
    if motion.cycles:
        size = quantity(motion.amplitude, "m")
        parts.append(f"swing {motion.cycles} times by {size} at {FREQUENCY:g} Hz")
    parts.append(f"release at {quantity(motion.release, 'm')}/s")
    return f"{', '.join(parts)} ({motion.seconds:.1f} s)"


def plan(
    config: PipelineConfig,
    sensors: Sensors,
    target: Target | None = None,
    limits: Limits | None = None,
    tissue: TissueBelief | None = None,
) -> Plan:
    """Return the motion to make next.

    Parameters
    ----------
    config : PipelineConfig
    sensors : Sensors
    target : Target, optional
        Without one: what a contact takes to converge.
    limits : Limits, optional
    tissue : TissueBelief, optional
        What is known of it; without it the prior.
    """
    return Search(config, sensors, target, limits, tissue).plan()


class Search:
    """The search of :func:`plan`, and what it was given."""

    def __init__(
        self,
        config: PipelineConfig,
        sensors: Sensors,
        target: Target | None = None,
        limits: Limits | None = None,
        tissue: TissueBelief | None = None,
    ) -> None:
        self._config = config
        self.target = target or Target.converged(config)
        self.limits = limits or Limits.usual(config, sensors)
        known = tissue or TissueBelief.stated(config.estimator.prior)
        self._draws = known.draws(_LIMITED)
        self.forecast = Forecast(config, sensors, known)
        #: Of each motion that was tried how far it is from the target [1]; infinite: not allowed.
        self.scores: dict[Motion, float] = {}
        #: Whether noise hides the surface of a tissue that it was compared on.
        self._hides: dict[Motion, bool] = {}
        fastest = Motion(self.limits.depth, self.limits.speed, 0.0, self.limits.speed)
        depths = self.forecast.depth_of_force(fastest, self.limits.force, self._draws)
        self._depth_in_time = 0.5 * self.limits.speed * (self.limits.time - _HOLDS[0])
        if self._depth_in_time <= 0.0:
            raise InputError(f"a press takes longer than {self.limits.time:g} s")
        #: Largest depth within the limits of depth, force and time [m].
        self.depth = min(
            self.limits.depth, float(np.quantile(depths, _EXCEEDED)), self._depth_in_time
        )

    def plan(self) -> Plan:
        """Return the best motion and what to expect."""
        return ended(self.in_parts())

    def in_parts(self) -> Parts[Plan]:
        """Return that in parts."""
        motion = yield from self._chosen()
        stated = yield from self.forecast.stated(motion, self._draws[:_STATED])
        known = yield from self.counted(motion, MOST_PRESSES)
        if not stated or not known:
            raise InputError("no tissue that may be there has a finite stress")
        pairs = zip(stated, known, strict=False)
        wider = np.median(
            [np.sqrt(one.variances / two.variances[0]) for one, two in pairs], axis=0
        )
        after = np.array([one.deviations(wider) for one in known])
        is_met = np.all(self.target.ratios(after) <= 1.0, axis=-1)
        likely = np.flatnonzero(is_met.mean(axis=0) >= POSSIBLE)
        return Plan(
            motion=motion,
            deviations=np.median(after[:, 0], axis=0),
            probability=float(is_met[:, 0].mean()),
            presses=int(likely[0]) + 1 if likely.size else 0,
            force=float(np.quantile([one.force for one in known], 1.0 - _EXCEEDED)),
            cause="" if likely.size else self._cause(motion, stated[0], known, after),
            target=self.target,
        )

    def compared(self, motion: Motion) -> Parts[list[Expected]]:
        """Return what a motion tells of a few tissues."""
        return self.forecast.compared(motion, self._draws[:_COMPARED])

    def counted(self, motion: Motion, presses: int = 1) -> Parts[list[Expected]]:
        """Return what a motion tells of the tissues for which a plan is stated."""
        return self.forecast.compared(motion, self._draws[:_COUNTED], presses)

    def _chosen(self) -> Parts[Motion]:
        limits = self.limits
        hold = min(1.0, limits.time - 2.0 * self.depth / limits.speed)
        best = Motion(self.depth, limits.speed, hold, limits.speed)
        best = yield from self._best([replace(best, depth=part * self.depth) for part in _DEPTHS])
        for part in _SLOWER:
            # Slower is worse, but for a touch that shows more of the surface.
            if not self._hides[best]:
                break
            best = yield from self._best([best, replace(best, speed=part * limits.speed)])
        best = yield from self._best([best, *(replace(best, hold=hold) for hold in _HOLDS)])
        depth = min(best.depth, self.depth / (1.0 + _AMPLITUDE))
        swing = replace(best, depth=depth, amplitude=_AMPLITUDE * depth, cycles=_CYCLES)
        best = yield from self._best([best, swing])
        least = _AS_GOOD * self.scores[best]
        good = [motion for motion, score in self.scores.items() if score <= least]
        return min(good, key=lambda motion: motion.seconds)

    def _best(self, motions: Sequence[Motion]) -> Parts[Motion]:
        """Return the motion that comes nearest to the target, the first of several."""
        for motion in motions:
            yield from self._weigh(motion)
        return min(motions, key=lambda motion: self.scores[motion])

    def score(self, motion: Motion) -> float:
        """Return how far a motion is from the target [1]; infinite: it is not allowed."""
        ended(self._weigh(motion))
        return self.scores[motion]

    def _weigh(self, motion: Motion) -> Parts[None]:
        """Find how far a motion is from the target [1]; infinite: it is not allowed."""
        if motion not in self.scores:
            found = yield from self.compared(motion)
            self._hides[motion] = any(one.is_hidden for one in found)
            is_allowed = found and self._is_allowed(motion, found)
            self.scores[motion] = self._distance(found) if is_allowed else math.inf

    def _distance(self, found: list[Expected]) -> float:
        """Return the geometric mean over tissues."""
        after = np.array([one.deviations()[0] for one in found])
        squares = np.sum(self.target.ratios(after) ** 2, axis=-1)
        return float(np.exp(0.5 * np.mean(np.log(squares))))

    def _is_allowed(self, motion: Motion, found: list[Expected]) -> bool:
        if motion.seconds > self.limits.time + _SAME_TIME or motion.deepest > 1.001 * self.depth:
            return False
        return sum(one.is_left for one in found) <= _EXCEEDED * len(found)

    def _cause(self, motion: Motion, typical: Stated, known: list[Expected], after: Array) -> str:
        """Return what keeps the target away, and what would change it."""
        geometry, config = self._config.geometry, self._config.estimator
        strain = geometry.strain(motion.depth / geometry.length)
        gn = float(np.exp(self.forecast.tissue.mean[1]))
        if strain * gn < 1.2 and self.depth < 0.95 * self.limits.depth:
            most, depth = quantity(self.limits.force, "N"), quantity(self.depth, "m")
            if self.depth == self._depth_in_time:
                return f"no more than {depth} are reached in {self.limits.time:g} s (--max-time)"
            return (
                f"with {most} no more than {depth} are safe while so little is known of the "
                "tissue: press, and plan again with --after"
            )
        index = int(np.argmax(self.target.ratios(np.median(after[:, 0], axis=0))))
        if index == 2:
            return "alpha shows in time alone: a longer hold (--max-time)"
        budget = typical.budget
        if not typical.touch.is_told or budget is None:
            return "the noise hides the contact: a quieter sensor or a larger face"
        if typical.touch.is_hidden and index == 0:
            linear = float(np.exp(self.forecast.tissue.mean[0])) / gn
            return f"noise hides the linear part: {uncover(budget, geometry, linear)}"
        wanted = self.target.deviations[index]
        if config.uncertainty.thickness_sd >= wanted:
            return f"{WORDS['thickness']}: state geometry.thickness_sd"
        force = float(np.median([one.force for one in known]))
        case = Case(self._config, budget, index, wanted, gn, force, strain)
        largest = budget.largest(index)
        named = f"{NAMES[index]} by {WORDS[largest[0]]}" if largest else NAMES[index]
        return f"{named}; {remedy(case)}"
