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

"""The benchmark of changing tissue: its truth, what it counts, and that the estimator tells."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from fden_ros.benchmarks.changes import (
    CHANGES,
    NOTHING,
    ROWS,
    Change,
    Told,
    figures_of,
    press,
    run_press,
)
from fden_ros.cli import main

FLAT = ROWS["flat_30"]
SLIDE, INCLUSION = CHANGES[:2]
#: Presses of each cell: enough that a rule which misses one in three shows.
PRESSES = range(4)


@pytest.mark.parametrize("kind", ["slide", "inclusion", "body"])
def test_change_begins_where_it_is_said_to_and_not_before(kind):
    before = press(FLAT.geometry, 1000.0, NOTHING, 3)
    after = press(FLAT.geometry, 1000.0, Change(kind, 2.0), 3)
    added = after.forces - before.forces
    assert np.all(added[after.times < after.changed_at] == 0.0)
    during = (after.times > after.changed_at) & (after.times < after.changed_at + 0.3)
    assert np.all(added[during] >= 0.0)
    assert added[during].max() > 0.05 * before.forces[during].max()


def test_slide_onto_stiffer_tissue_multiplies_the_force():
    before = press(FLAT.geometry, 100.0, NOTHING, 3)
    after = press(FLAT.geometry, 100.0, SLIDE, 3)
    noise = 3.0 * FLAT.geometry.force_per_stress
    later = (after.times > after.changed_at + 0.05) & (before.forces > 10.0 * noise)
    assert later.sum() > 20
    ratio = np.mean(after.forces[later]) / np.mean(before.forces[later])
    # The noise is the same in both.
    assert ratio == pytest.approx(1.3, abs=0.03)


@pytest.mark.parametrize("row", ["flat_30", "sphere_30", "flat_100_arm"])
def test_changes_are_told_in_time_at_slow_rates_too(row):
    own = ROWS[row]
    for change in (SLIDE, INCLUSION):
        told = [run_press(own, change, number, {}) for number in PRESSES]
        assert sum(one.in_time for one in told) >= 3, change.name


def test_nothing_is_told_of_tissue_that_stays_what_it_is():
    narrow = {"prior.alpha_sd": 0.011, "prior.alpha": 0.05}
    for own in ({}, narrow, {**narrow, "alpha.learn": False}):
        told = [run_press(FLAT, NOTHING, number, own) for number in PRESSES]
        assert not any(one.is_false for one in told), own


def test_too_soon_and_too_late_are_not_in_time():
    told = [Told(0.05, False, False), Told(0.2, False, True), Told(-0.1, True, False)]
    told.append(Told(math.inf, False, False))
    figures = figures_of(told)
    counts = {"contacts": 4, "in_time": 1, "late": 1, "false": 1, "mismatch": 1}
    assert {name: figures[name] for name in counts} == counts


def test_command_counts_and_draws(tmp_path, capsys):
    arguments = ("--rows", "flat_30", "--contacts", "1", "--jobs", "1", "--json")
    assert main(["benchmark", "changes", *arguments, "-o", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert set(shown["figures"]["rows"]["flat_30"]) == {change.name for change in CHANGES}
    assert (tmp_path / "changes.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--rows", "flat_31"), "there is no row 'flat_31'"),
        (("--contacts", "0"), "at least 1"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", "changes", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
