# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measured tissue: from the ramp and the first 2 s of the hold, predict the rest of the hold.

Every test goes through the online pipeline sample by sample, with wide priors. Nothing is fitted
afterwards. *Error*: root mean square, in percent of the peak force; *score*: of the 95 % interval
(Gneiting and Raftery 2007), likewise;
*short over whole*: by ramp and 2 s less by the whole record, over the deviation of the former;
*alpha off*: from the hold's own order, where alpha is known. The rows of a day are those of the
first part of the tests' names.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, measured, within
from benchmark.measured import Test, foretell, hold_order, identify, read_tests, some_of
from benchmark.score import NAMES, TWO_SIDED_95, Share, mean_of, rms, share
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, StateIndex
from fden_ros.core.outputs import ContactSummary, Flag
from fden_ros.errors import InputError

EPILOG = """\
examples:
  fden benchmark real measured/                     every CSV in the folder that is such a table
  FDEN_DATA=measured fden benchmark real --quick    a few tests of each material

Columns: test, material, time_s, force_N, displacement_mm, gap_mm (others are ignored).
"""

#: Materials by the beginning of their name: which the model describes, and which it does not.
TISSUE, NOT_TISSUE = "beef", "silicone"
_QUICK_TESTS = 4
#: Times of separate looks at the interval [s ahead], each to the next.
AHEAD = (0.5, 2.0, 5.0, 9.0)
_NEAR = 0.5
#: Deviation of a parameter that is given [1]: it does not move.
_TINY = 1e-9


@dataclass(frozen=True)
class Outcome:
    """The result of one test; forces in percent of the peak."""

    test: Test
    predicted: Array  #: [N], shape (m,)
    sd: Array  #: [N], shape (m,)
    short: Estimate
    whole: Estimate
    summary: ContactSummary | None  #: of the whole record
    order: float  #: of the hold itself [1]

    @property
    def rest(self) -> Array:
        """The force that was to be predicted [N]."""
        return self.test.forces[self.test.seen :]

    def percent(self, values: Array) -> Array:
        """Return forces in percent of the peak."""
        scaled: Array = 100.0 * values / self.test.forces.max()
        return scaled

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Whether each sample lies in the interval, shape (m,)."""
        return np.abs(self.predicted - self.rest) <= TWO_SIDED_95 * self.sd

    @property
    def score(self) -> float:
        """Mean interval score of the 95 % interval."""
        reach = TWO_SIDED_95 * self.sd
        beyond = np.maximum(np.abs(self.predicted - self.rest) - reach, 0.0)
        return float(np.mean(self.percent(2.0 * reach + 2.0 / 0.05 * beyond)))

    @property
    def moved(self) -> Array:
        """By the visible part less by all, over the deviations of the former, (3,)."""
        moved: Array = (self.short.mean - self.whole.mean) / np.maximum(
            self.short.deviations, _TINY
        )
        return moved

    def inside_at(self, ahead: float) -> float:
        """Return the share of the samples about a time ahead that lie inside; NaN: none."""
        times = self.test.times[self.test.seen :] - self.test.times[self.test.seen - 1]
        near = np.abs(times - ahead) <= _NEAR * min(ahead, 1.0)
        return float(self.inside[near].mean()) if near.any() else math.nan


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    tests = read_tests(args.data)
    if args.quick:
        tests = some_of(tests, _QUICK_TESTS)
    found = measured(predict, [(test,) for test in tests], what="measured tests")
    groups: dict[str, list[Outcome | None]] = {}
    for test, outcome in zip(tests, found, strict=True):
        kind, day = test.kind, test.name.rpartition("/")[0]
        for name in dict.fromkeys((kind, f"{kind}, {day}" if day else kind)):
            groups.setdefault(name, []).append(outcome)
    rows = {}
    for name in sorted(groups):
        given = [outcome for outcome in groups[name] if outcome is not None]
        if given:
            rows[name] = {"given": Share(len(given), len(groups[name]))} | row_of(given)
    tables = {"materials": Table("The rest of the hold, from the ramp and 2 s", rows)}
    return Report(_goals(rows), tables)


def predict(test: Test) -> Outcome | None:
    """Return the prediction from the visible part of a test; None: no estimate."""
    try:
        whole, _, summary = identify(test)
        short, mean, sd = foretell(test)
    except InputError:
        return None
    return Outcome(test, mean, sd, short, whole, summary, hold_order(test))


def row_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of some tests."""
    errors = [float(rms(o.percent(o.predicted - o.rest))) for o in outcomes]
    widths = [float(np.median(o.percent(TWO_SIDED_95 * o.sd))) for o in outcomes]
    known = [o for o in outcomes if o.whole.knows(StateIndex.FRACTIONAL_ORDER)]
    off = [(o.whole.fractional_order - o.order) / o.whole.fractional_order_sd for o in known]
    laws = [(o.whole.law_error, o.order) for o in outcomes if o.whole.law_error is not None]
    relaxation = [(law.order - order) / law.order_sd for law, order in laws]
    flags = [o.summary.flags if o.summary is not None else Flag.NONE for o in outcomes]
    return {
        "changed": share(f & Flag.TISSUE_CHANGED for f in flags),
        "mismatch": share(f & Flag.MODEL_MISMATCH for f in flags),
        "error, median": float(np.median(errors)),
        "error, 90 %": float(np.percentile(errors, 90.0)),
        "in 95 %": float(np.mean([o.inside.mean() for o in outcomes])),
        "at 0.5, 2, 5, 9 s": [mean_of(o.inside_at(at) for o in outcomes) for at in AHEAD],
        "half width": float(np.median(widths)),
        "score": float(np.mean([o.score for o in outcomes])),
        "short over whole": rms(np.array([o.moved for o in outcomes])),
        "alpha known": share(o in known for o in outcomes),
        "alpha off": float(rms(np.array(off))) if off else math.nan,
        "relaxation off": float(rms(np.array(relaxation))) if relaxation else math.nan,
        "converged": share(o.whole.converged for o in outcomes),
        "sd": np.median([o.whole.deviations for o in outcomes], axis=0),
    }


def _goals(rows: dict[str, dict[str, Any]]) -> list[Goal]:
    goals = []
    if beef := rows.get(TISSUE):
        goals += [
            at_most("beef: error, median, % of peak", beef["error, median"], 0.75),
            at_most("beef: error, 90th percentile, % of peak", beef["error, 90 %"], 2.0),
            within("beef: in the 95 % interval", beef["in 95 %"], (0.92, 1.0)),
            *(
                at_least(f"beef: in the interval {at:g} s ahead", inside, 0.88)
                for at, inside in zip(AHEAD, beef["at 0.5, 2, 5, 9 s"], strict=True)
            ),
            at_most("beef: half width, % of peak", beef["half width"], 2.9),
            *(
                at_most(f"beef: {name}, short over whole, rms", value, 1.0)
                for name, value in zip(NAMES, beef["short over whole"], strict=True)
            ),
            at_most("beef: alpha off the hold's own order, rms", beef["alpha off"], 1.5),
            at_most("beef: reported as changed", float(beef["changed"].part), 0.0),
            at_least("beef: converged", beef["converged"].value, 0.9),
        ]
    if silicone := rows.get(NOT_TISSUE):
        goals.append(at_least("silicone: in the 95 % interval", silicone["in 95 %"], 0.9))
        is_reported = silicone["mismatch"].part == silicone["mismatch"].whole
        moved = float(np.max(silicone["short over whole"]))
        words = "silicone: short over whole, the largest, unless reported"
        goals.append(at_most(words, 0.0 if is_reported else moved, 1.5))
        goals.append(
            at_most("silicone: reported as changed", float(silicone["changed"].part), 0.0)
        )
    return goals


BENCHMARK = Benchmark(run, EPILOG, data=True)
