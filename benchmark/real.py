# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measured tissue: from the ramp and the first 2 s of the hold, predict the rest of the hold.

Every test goes through the online pipeline sample by sample, with wide priors. Nothing is fitted
afterwards. *Error*: root mean square, in percent of the peak force; *short over whole*: by ramp
and 2 s less by the whole record, over the deviation of the former; *alpha off*: from the hold's
own order, where alpha is known. The rows of a day are those of the first part of the tests' names.
The indenter's shape is not known, so G comes in force units: N s^alpha.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, measured, within
from benchmark.score import NAMES, TWO_SIDED_95, Share, rms, share
from benchmark.trial import begun, fed, last_of
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, Prior, StateIndex
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from simulation.simulate import KNOWN_RIG

EPILOG = """\
examples:
  fden benchmark real measured/                     every CSV in the folder that is such a table
  FDEN_DATA=measured fden benchmark real --quick    a few tests of each material

Columns: test, material, time_s, force_N, displacement_mm, gap_mm (others are ignored). Each test
is a ramp and a hold; the displacement is 0 at contact, where the gap is the thickness.
"""

COLUMNS = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
#: Materials by the beginning of their name: which the model describes, and which it does not.
TISSUE, NOT_TISSUE = "beef", "silicone"
_QUICK_TESTS = 4
#: Visible part of the hold [s].
SEEN_HOLD = 2.0
#: The force noise of these tests, as their README states it [N].
FORCE_NOISE = 1e-3
#: The default prior, for G in N s^alpha as of a face of 1 cm^2.
PRIOR_STIFFNESS = 1e-4 * Prior().linear_stiffness
#: The hold begins where the probe is this close to its deepest point [m].
_AT_HOLD = 1e-5
#: Points of a motion to come.
_POINTS = 40
_LEAST_ORDER, _MOST_ORDER = 0.005, 0.9
#: Deviation of a parameter that is given [1]: it does not move.
_TINY = 1e-9


@dataclass(frozen=True)
class Test:
    """One ramp and hold on one specimen; arrays of shape (n,)."""

    #: Not a test of pytest's.
    __test__ = False

    name: str
    material: str
    times: Array  #: [s]
    forces: Array  #: [N]
    displacements: Array  #: into the tissue, 0 at contact [m]
    thickness: float  #: [m]

    @property
    def kind(self) -> str:
        """Material up to the first underscore: beef for beef_RDG."""
        return self.material.split("_")[0]

    @property
    def hold(self) -> int:
        """Index of the first sample of the hold."""
        return int(np.argmax(self.displacements >= self.displacements.max() - _AT_HOLD))

    @property
    def seen(self) -> int:
        """Number of samples of the ramp and the first 2 s of the hold."""
        last = self.times[self.hold] + SEEN_HOLD
        return int(np.searchsorted(self.times, last, side="right"))

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the identifier: a testing machine with an exactly known rig."""
        rig = {name: value for name, value in KNOWN_RIG.items() if name != "converged.log_gn_sd"}
        return rig | {
            "geometry.kind": "flat_punch",
            # Stress is force: the indenter's shape is not known.
            "geometry.area": 1.0,
            "geometry.thickness": self.thickness,
            # The recording begins in contact, so bias and noise cannot be measured in the air.
            "force.measure_bias": False,
            "force.noise": FORCE_NOISE,
            "origin.source": "given",
            "origin.displacement": 0.0,
            "prior.linear_stiffness": PRIOR_STIFFNESS,
        }


def read_tests(folder: Path) -> list[Test]:
    """Return the tests in every table of a folder."""
    tests = [test for path in sorted(folder.glob("*.csv")) for test in _read(path)]
    if not tests:
        raise InputError(f"{folder}: no CSV file in it has the columns {', '.join(COLUMNS)}")
    return tests


def rows_of_tests(
    path: Path, names: Sequence[str], numbers: Sequence[str]
) -> dict[tuple[str, ...], Array]:
    """Return the numbers (n, k) of each test of a table; none where it has other columns."""
    rows: defaultdict[tuple[str, ...], list[list[float]]] = defaultdict(list)
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if not {*names, *numbers} <= set(reader.fieldnames or ()):
            return {}
        for row in reader:
            try:
                values = [float(row[column]) for column in numbers]
            except (TypeError, ValueError):
                words = f"{path}: line {reader.line_num}: {', '.join(numbers)} must be numbers"
                raise InputError(words) from None
            rows[tuple(row[column] for column in names)].append(values)
    return {key: np.array(values) for key, values in rows.items()}


def _read(path: Path) -> list[Test]:
    tests = []
    for (name, material), samples in rows_of_tests(path, COLUMNS[:2], COLUMNS[2:]).items():
        times, forces, displacements, gaps = samples.T
        test = Test(name, material, times, forces, 1e-3 * displacements, 1e-3 * float(gaps[0]))
        if test.thickness <= 0.0 or np.any(np.diff(test.times) <= 0.0):
            words = "the gap at contact must be positive and the time increase"
            raise InputError(f"{path}: {name}: {words}")
        if test.times.size - test.seen < 2:
            words = f"no hold of more than {SEEN_HOLD:g} s, so nothing to predict"
            raise InputError(f"{path}: {name}: {words}")
        tests.append(test)
    return tests


def _some_of(tests: Sequence[Test]) -> list[Test]:
    """Return a few tests of each kind, of as many specimens as possible."""
    chosen: list[Test] = []
    for kind in sorted({test.kind for test in tests}):
        own = [test for test in tests if test.kind == kind]
        chosen += own[:: math.ceil(len(own) / _QUICK_TESTS)]
    return chosen


@dataclass(frozen=True)
class Outcome:
    """The result of one test; forces in percent of the peak."""

    test: Test
    predicted: Array  #: [N], shape (m,)
    sd: Array  #: [N], shape (m,)
    short: Estimate
    whole: Estimate
    flags: Flag  #: of the whole record
    order: float  #: of the hold itself [1]

    @property
    def off(self) -> Array:
        """By how much the prediction is above the rest of the force [N]."""
        return self.predicted - self.test.forces[self.test.seen :]

    def percent(self, values: Array) -> Array:
        """Return forces in percent of the peak."""
        scaled: Array = 100.0 * values / self.test.forces.max()
        return scaled

    @property
    def moved(self) -> Array:
        """By the visible part less by all, over the deviations of the former, (3,)."""
        moved: Array = self.short.mean - self.whole.mean
        return moved / np.maximum(self.short.deviations, _TINY)


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    tests = read_tests(args.data)
    if args.quick:
        tests = _some_of(tests)
    found = measured(predict, [(test,) for test in tests], "measured tests")
    groups: dict[str, list[Prediction]] = {}
    for test, outcome in zip(tests, found, strict=True):
        kind, day = test.kind, test.name.rpartition("/")[0]
        for name in dict.fromkeys((kind, f"{kind}, {day}" if day else kind)):
            groups.setdefault(name, []).append(outcome)
    rows = {}
    for name in sorted(groups):
        if given := [one.outcome for one in groups[name] if one.outcome is not None]:
            changed = share(one.flags & Flag.TISSUE_CHANGED for one in groups[name])
            rows[name] = {"given": Share(len(given), len(groups[name])), "changed": changed}
            rows[name] |= row_of(given)
    tables = {"materials": Table("The rest of the hold, from the ramp and 2 s", rows)}
    return Report(_goals(rows), tables)


class Prediction(NamedTuple):
    """What a test was found to be, and how its rest was predicted; None: no estimate."""

    flags: Flag
    outcome: Outcome | None


def predict(test: Test) -> Prediction:
    """Return the prediction from the visible part of a test."""
    whole, summary = identify(test)
    flags = summary.flags if summary is not None else Flag.NONE
    pipeline, short = _fed(test, test.seen)
    times = test.times[test.seen :] - test.times[test.seen - 1]
    # The motion is a line between some points.
    points = np.union1d(np.linspace(0.0, times[-1], _POINTS + 1)[1:], times[[0]])
    depths = np.interp(test.times[test.seen - 1] + points, test.times, test.displacements)
    found = pipeline.force_ahead(points, depths)
    estimate = _estimate(short)
    if found is None or estimate is None or whole is None:
        return Prediction(flags, None)
    mean, sd = (np.interp(times, points, values) for values in found)
    return Prediction(flags, Outcome(test, mean, sd, estimate, whole, flags, hold_order(test)))


def identify(test: Test) -> tuple[Estimate | None, ContactSummary | None]:
    """Run the pipeline over all samples; return the last live estimate and the summary."""
    pipeline, outputs = _fed(test, None)
    whole = _estimate(outputs)
    pipeline.finish()
    return whole, last_of(ContactSummary, outputs)


def _fed(test: Test, count: int | None) -> tuple[Pipeline, list[Output]]:
    pipeline, outputs = begun(test.parameters)
    for _ in fed(pipeline, test.times[:count], test.forces[:count], test.displacements[:count]):
        pass
    return pipeline, outputs


def _estimate(outputs: Sequence[Output]) -> Estimate | None:
    state = last_of(TissueState, outputs)
    return None if state is None else state.estimate


def hold_order(test: Test) -> float:
    r"""Return the order by which the force of a test's hold relaxes, whatever the curve.

    It is that of the law with a free curve: every step of phi on the ramp is a parameter of its
    own, not negative,

    .. math:: f_n = \sum_j w_{nj}(\alpha)\, \Delta\varphi_j, \qquad
        w_{nj} = \frac{(t_n-t_{j-1})^{1-\alpha} - (t_n-t_j)^{1-\alpha}}
                      {\Gamma(2-\alpha)\,(t_j-t_{j-1})}

    Any order fits the forces of the ramp, so the hold alone decides, without an estimator.
    """
    ends = test.times[: test.hold + 1]

    def misfit(order: float) -> float:
        since = np.maximum(test.times[1:, None] - ends, 0.0) ** (1.0 - order)
        weights = (since[:, :-1] - since[:, 1:]) / np.diff(ends) / math.gamma(2.0 - order)
        return float(nnls(weights, test.forces[1:])[1])

    limits, how = (_LEAST_ORDER, _MOST_ORDER), {"xatol": 1e-3}
    return float(minimize_scalar(misfit, bounds=limits, method="bounded", options=how).x)


def row_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of some tests."""
    errors = [float(rms(o.percent(o.off))) for o in outcomes]
    widths = [float(np.median(o.percent(TWO_SIDED_95 * o.sd))) for o in outcomes]
    known = [o for o in outcomes if o.whole.knows(StateIndex.FRACTIONAL_ORDER)]
    off = [(o.whole.fractional_order - o.order) / o.whole.fractional_order_sd for o in known]
    laws = [(o.whole.law_error, o.order) for o in outcomes if o.whole.law_error is not None]
    relaxation = [(law.order - order) / law.order_sd for law, order in laws]
    inside = [np.mean(np.abs(o.off) <= TWO_SIDED_95 * o.sd) for o in outcomes]
    return {
        "mismatch": share(o.flags & Flag.MODEL_MISMATCH for o in outcomes),
        "error, median": float(np.median(errors)),
        "error, 90 %": float(np.percentile(errors, 90.0)),
        "in 95 %": float(np.mean(inside)),
        "half width": float(np.median(widths)),
        "short over whole": rms(np.array([o.moved for o in outcomes])),
        "alpha known": Share(len(known), len(outcomes)),
        "alpha off": float(rms(np.array(off))),
        "relaxation off": float(rms(np.array(relaxation))),
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
        moved = float(np.max(silicone["short over whole"]))
        is_reported = silicone["mismatch"].part == silicone["mismatch"].whole
        words = "silicone: short over whole, the largest, unless reported"
        goals += [
            at_least("silicone: in the 95 % interval", silicone["in 95 %"], 0.9),
            at_most(words, 0.0 if is_reported else moved, 1.5),
            at_most("silicone: reported as changed", float(silicone["changed"].part), 0.0),
        ]
    return goals


BENCHMARK = Benchmark(run, EPILOG, data=True)
