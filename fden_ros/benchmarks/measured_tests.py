# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Measured ramps and holds on specimens, from tables."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError

COLUMNS = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
#: How much of the hold is seen [s].
SEEN_HOLD = 2.0
#: The hold begins where the probe is this close to its deepest point [m].
_AT_HOLD = 1e-5


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
    def specimen(self) -> str:
        """First word of the name: other places on the same piece share it."""
        return self.name.split()[0]

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
        """How many samples the estimators get: the ramp and the first 2 s of the hold."""
        last = self.times[self.hold] + SEEN_HOLD
        return int(np.searchsorted(self.times, last, side="right"))

    def error(self, predicted: Array) -> float:
        """Return the RMS error of the rest of the hold, in percent of the peak force."""
        rest = self.forces[self.seen :]
        return 100.0 * float(np.sqrt(np.mean((predicted - rest) ** 2)) / self.forces.max())


def read_tests(folder: Path) -> list[Test]:
    """Return the tests in every table of a folder.

    Raises
    ------
    InputError
        If there is no such folder, no such table in it, or a number that cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the one with the measured tests")
    tests: list[Test] = []
    for path in sorted(folder.glob("*.csv")):
        tests += _read_table(path)
    if not tests:
        raise InputError(f"{folder}: no CSV file in it has the columns {', '.join(COLUMNS)}")
    return tests


def _read_table(path: Path) -> list[Test]:
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
        _check(test, path)
        tests.append(test)
    return tests


def _check(test: Test, path: Path) -> None:
    if test.thickness <= 0.0 or np.any(np.diff(test.times) <= 0.0):
        raise InputError(
            f"{path}: {test.name}: the gap at contact must be positive and the time increase"
        )
    if test.times.size - test.seen < 2:
        raise InputError(
            f"{path}: {test.name}: no hold of more than {SEEN_HOLD:g} s, so nothing to predict"
        )
