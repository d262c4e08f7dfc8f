# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Measured ramps and holds on specimens, from tables, and the order that a hold itself shows.

A table (CSV) has the columns of :data:`COLUMNS`; each test is a ramp and a hold, the displacement
is 0 at contact, and the gap at contact is the thickness. The indenter's shape is not known, so G
comes in force units: N s^alpha.

The order of a hold is that of the law with a free curve: every step of phi on the ramp is a
parameter of its own, not negative,

.. math:: f_n = \sum_j w_{nj}(\alpha)\, \Delta\varphi_j, \qquad
    w_{nj} = \frac{(t_n-t_{j-1})^{1-\alpha} - (t_n-t_j)^{1-\alpha}}
                  {\Gamma(2-\alpha)\,(t_j-t_{j-1})}

Any order fits the forces of the ramp, so the hold alone decides, without an estimator, a
prior or an exponential.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from benchmark.harness import DATA_VARIABLE
from benchmark.trial import fed
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, Prior
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from simulation.simulate import KNOWN_RIG

COLUMNS = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
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


def read_tests(folder: Path | None) -> list[Test]:
    """Return the tests in every table of a folder.

    Raises
    ------
    InputError
        If there is no such folder, no such table in it, or a number that cannot be read.
    """
    if folder is None:
        raise InputError(
            f"no data: name the folder with the measured tests, or set {DATA_VARIABLE}"
        )
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the one with the measured tests")
    tests = [test for path in sorted(folder.glob("*.csv")) for test in read_table(path)]
    if not tests:
        raise InputError(f"{folder}: no CSV file in it has the columns {', '.join(COLUMNS)}")
    return tests


def some_of(tests: Sequence[Test], count: int) -> list[Test]:
    """Return a few tests of each kind, of as many specimens as possible."""
    chosen: list[Test] = []
    for kind in sorted({test.kind for test in tests}):
        own = [test for test in tests if test.kind == kind]
        chosen += own[:: math.ceil(len(own) / count)]
    return chosen


def read_table(path: Path) -> list[Test]:
    """Return the tests of one table; none where it has other columns."""
    rows: defaultdict[tuple[str, str], list[list[float]]] = defaultdict(list)
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if not set(COLUMNS) <= set(reader.fieldnames or ()):
            return []
        for row in reader:
            try:
                numbers = [float(row[column]) for column in COLUMNS[2:]]
            except (TypeError, ValueError):
                raise InputError(
                    f"{path}: line {reader.line_num}: {', '.join(COLUMNS[2:])} must be numbers"
                ) from None
            rows[row["test"], row["material"]].append(numbers)
    tests = []
    for (name, material), samples in rows.items():
        times, forces, displacements, gaps = np.array(samples).T
        test = Test(name, material, times, forces, 1e-3 * displacements, 1e-3 * float(gaps[0]))
        if test.thickness <= 0.0 or np.any(np.diff(test.times) <= 0.0):
            raise InputError(
                f"{path}: {name}: the gap at contact must be positive and the time increase"
            )
        if test.times.size - test.seen < 2:
            words = f"no hold of more than {SEEN_HOLD:g} s, so nothing to predict"
            raise InputError(f"{path}: {name}: {words}")
        tests.append(test)
    return tests


def identify(
    test: Test, count: int | None = None, parameters: Mapping[str, Any] | None = None
) -> tuple[Estimate, TissueState, ContactSummary | None]:
    """Run the pipeline over the first samples; return the last live estimate, state and summary.

    Raises
    ------
    InputError
        If the pipeline finds no contact that it can use.
    """
    pipeline, outputs = _fed(test, count, parameters)
    state = _newest(test, outputs)
    pipeline.finish()
    summaries = [output for output in outputs if isinstance(output, ContactSummary)]
    assert state.estimate is not None
    return state.estimate, state, summaries[-1] if summaries else None


def foretell(test: Test) -> tuple[Estimate, Array, Array]:
    """Identify from what is seen of a test; return also the force of the rest of its motion.

    As mean and standard deviation [N], shape (m,) each.

    Raises
    ------
    InputError
        If nothing is known of the tissue by then.
    """
    seen = test.seen
    pipeline, outputs = _fed(test, seen, None)
    estimate = _newest(test, outputs).estimate
    times = test.times[seen:] - test.times[seen - 1]
    # The motion is a line between some points.
    points = np.union1d(np.linspace(0.0, times[-1], _POINTS + 1)[1:], times[[0]])
    before, after = test.times[seen - 1] + points, test.displacements
    found = pipeline.force_ahead(points, np.interp(before, test.times, after))
    if found is None or estimate is None:
        raise InputError(f"{test.name}: nothing is known of the tissue after 2 s of the hold")
    mean, sd = (np.interp(times, points, values) for values in found)
    return estimate, mean, sd


def _fed(
    test: Test, count: int | None, parameters: Mapping[str, Any] | None
) -> tuple[Pipeline, list[Output]]:
    outputs: list[Output] = []
    pipeline = Pipeline(
        pipeline_config(check(test.parameters | dict(parameters or {}))), outputs.append
    )
    for _ in fed(pipeline, test.times[:count], test.forces[:count], test.displacements[:count]):
        pass
    return pipeline, outputs


def _newest(test: Test, outputs: Sequence[Output]) -> TissueState:
    states = [output for output in outputs if isinstance(output, TissueState)]
    if not states or states[-1].estimate is None:
        raise InputError(
            f"{test.name}: no estimate; the displacement must begin at 0, in contact or before it"
        )
    return states[-1]


def hold_order(test: Test) -> float:
    """Return the order by which the force of a test's hold relaxes, whatever the curve."""
    ends = test.times[: test.hold + 1]

    def misfit(order: float) -> float:
        since = np.maximum(test.times[1:, None] - ends, 0.0) ** (1.0 - order)
        weights = (since[:, :-1] - since[:, 1:]) / np.diff(ends) / math.gamma(2.0 - order)
        return float(nnls(weights, test.forces[1:])[1])

    found = minimize_scalar(
        misfit, bounds=(_LEAST_ORDER, _MOST_ORDER), method="bounded", options={"xatol": 1e-3}
    )
    return float(found.x)
