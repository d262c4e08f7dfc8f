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

"""The benchmark of detection: no contact invented, lost or split on a disturbed rig."""

from __future__ import annotations

import json

import pytest

from fden_ros.benchmarks.contact import ROWS, approaches_of, figures_of, run_approaches
from fden_ros.cli import main
from fden_ros.simulation.simulate import simulate

RATIO = 10.0


@pytest.mark.parametrize("case", ROWS.values(), ids=lambda case: case.name)
def test_presses_of_ten_times_the_noise_are_found_once_and_nothing_else_is(case):
    found = figures_of([run_approaches(case, 0, RATIO, {})])
    assert found["presses"] == 3
    for name in ("invented", "missed", "split", "stuck", "off"):
        assert found[name] == 0, name


def test_press_takes_as_many_times_the_noise_as_is_asked_for():
    case = ROWS["vibration_moving_50mN"]
    force = simulate(approaches_of(case, 0, 40.0)).force.value.max()
    # The vibration itself and four deviations of the noise add to it.
    assert 2.0 < force < 2.0 + 0.05 + 0.04


def test_command_counts_and_draws(tmp_path, capsys):
    arguments = ("--cases", "hum_20mN", "--approaches", "1", "--jobs", "1", "--json")
    assert main(["benchmark", "contact", *arguments, "-o", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["figures"]["cases"]["hum_20mN"]["presses"] == 3
    assert all(goal["met"] for goal in shown["goals"])
    assert (tmp_path / "contact.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--cases", "hun"), "there is no case 'hun'"),
        (("--approaches", "0"), "at least 1"),
        (("--ratio", "-1"), "must be positive"),
    ],
)
def test_bad_arguments_end_in_one_line(arguments, words, tmp_path, capsys):
    assert main(["benchmark", "contact", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
