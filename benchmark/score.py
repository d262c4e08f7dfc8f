# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The statistics of all benchmarks: errors beyond the limits, undetected ones, and intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import Flag

#: Of the parameters, in the order of errors and deviations.
NAMES = ("ln G", "ln Gn", "alpha")
#: Standard deviations of a normal variable that hold 95 % of it, on both sides [1].
TWO_SIDED_95 = 1.959964
_NOTHING = np.full(3, np.nan)
#: An error counts from this many stated deviations, and these sizes of ln G, ln Gn, alpha.
_DEVIATIONS, _SIZES = 5.0, np.array([0.03, 0.03, 0.01])
#: Summaries and states with a flag other than these report a problem.
_HARMLESS = Flag.INPUT_REJECTED
#: Flags of a tissue that the law does not describe, or that has changed.
ALARMS = Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED


class Share(NamedTuple):
    """A share of a count."""

    part: int
    whole: int

    @property
    def value(self) -> float:
        """From 0 to 1; NaN: of none."""
        return self.part / self.whole if self.whole else math.nan

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval (Clopper and Pearson 1934)."""
        from scipy.stats import binomtest

        found = binomtest(self.part, self.whole).proportion_ci(0.95)
        return float(found.low), float(found.high)


_NONE = Share(0, 0)


def share(values: Iterable[object]) -> Share:
    """Return how many of the values are true."""
    known = [bool(value) for value in values]
    return Share(sum(known), len(known))


def total(shares: Iterable[Share]) -> Share:
    """Return the sum of shares."""
    parts = list(shares)
    return Share(sum(s.part for s in parts), sum(s.whole for s in parts))


def warns(flags: Flag) -> bool:
    """Return whether a flag reports a problem."""
    return bool(flags & ~_HARMLESS)


class Judged(NamedTuple):
    """The summary of one contact, compared with the truth."""

    converged: bool
    flags: Flag
    error: Array  #: of (ln G, ln Gn, alpha), shape (3,); NaN: there is no estimate
    deviation: Array  #: as stated, shape (3,)
    number: int = 0  #: of the press, from 0; -1: there was none
    estimate: Estimate | None = None

    @property
    def is_off(self) -> bool:
        """Whether a parameter is off by more than the stated deviation allows."""
        return bool(np.any(np.abs(self.error) > np.maximum(_DEVIATIONS * self.deviation, _SIZES)))

    @property
    def is_undetected(self) -> bool:
        """Whether it is off without a flag."""
        return self.claims and self.is_off

    @property
    def claims(self) -> bool:
        """Whether it is converged, without a warning flag."""
        return self.converged and not warns(self.flags)


def judged(
    estimate: Estimate | None, truth: Array, converged: bool, flags: Flag, number: int = 0
) -> Judged:
    """Return an estimate compared with the true (ln G, ln Gn, alpha), shape (3,)."""
    if estimate is None:
        return Judged(converged, flags, _NOTHING, _NOTHING, number)
    return Judged(converged, flags, estimate.mean - truth, estimate.deviations, number, estimate)


@dataclass(frozen=True)
class Outcome:
    """The results of one recording."""

    presses: int  #: Made
    contacts: tuple[Judged, ...]  #: By the last summary of each
    claims: Share  #: Of the unflagged CONVERGED states those that are off
    live: Flag  #: All flags of the states
    #: Of the measured slopes of the contacts those whose 95 % interval holds that of the
    #: motion without noise
    measured: Share = _NONE


def figures_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of some recordings by the heading of their column.

    *undetected*: presses whose contact is converged, unflagged and off; *live*: states alike;
    *error over sd*: root mean square; *in 95 %*: share of the intervals that hold; *live alarm*:
    recordings of which any state reports a mismatch or a change; *sd*: median, as stated.
    """
    every = [contact for outcome in outcomes for contact in outcome.contacts]
    pressed = [contact for contact in every if contact.number >= 0]
    known = [contact for contact in pressed if contact.estimate is not None]
    error = np.array([contact.error for contact in known]).reshape(-1, 3)
    deviation = np.array([contact.deviation for contact in known]).reshape(-1, 3)
    inside = np.abs(error) <= TWO_SIDED_95 * deviation
    finite = deviation[np.isfinite(deviation).all(axis=1)]
    return {
        "undetected": Share(sum(c.is_undetected for c in every), sum(o.presses for o in outcomes)),
        "live": total(outcome.claims for outcome in outcomes),
        "error over sd": rms(error / np.maximum(deviation, 1e-12)),
        "in 95 %": np.mean(inside, axis=0) if len(known) else _NOTHING,
        "changed": share(c.flags & Flag.TISSUE_CHANGED for c in pressed),
        "mismatch": share(c.flags & Flag.MODEL_MISMATCH for c in pressed),
        "live alarm": share(outcome.live & ALARMS for outcome in outcomes),
        "converged": share(c.converged for c in pressed),
        "unflagged": share(c.claims for c in pressed),
        "no estimate": share(c.estimate is None for c in pressed),
        "sd": np.median(finite, axis=0) if len(finite) else _NOTHING,
    }


def rms(values: Array) -> Array:
    """Return the root mean square over the first axis; NaN of nothing."""
    if not len(values):
        return np.full(np.shape(values)[1:], np.nan)
    root: Array = np.sqrt(np.mean(np.square(values), axis=0))
    return root


def mean_of(values: Iterable[float]) -> float:
    """Return the mean of the values that are finite; NaN of none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else math.nan
