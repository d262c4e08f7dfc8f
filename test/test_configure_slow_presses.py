# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""`fden configure` on slow presses by noisy arms: no sign, axis or unit is stated wrongly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from slow_press_rigs import slow_press

from fden_ros.configure.survey import survey


class Verdict(NamedTuple):
    wrong: tuple[str, ...]
    is_open: bool  #: a sign is not told
    is_clear: bool  #: the force exceeds ten times its noise


def verdict(seed: int) -> Verdict:
    rig = slow_press(seed)
    found = survey([rig.streams])
    truths = {"force": rig.force_axis, "displacement": rig.displacement_axis}
    wrong, is_open = [], False
    for name, unit in (("force", "N"), ("displacement", "m")):
        axis, told = found.finding(f"{name} axis"), found.finding(f"{name} unit")
        if told.claim and told.value != unit:
            wrong.append(f"{seed} {name} unit")
        is_open |= axis.value is None
        if axis.claim and float(np.atleast_1d(axis.value) @ truths[name]) < 0.0:
            wrong.append(f"{seed} {name} axis")
    return Verdict(tuple(wrong), is_open, rig.peak > 10.0 * rig.noise)


@pytest.mark.parametrize(
    "seeds", [range(12), pytest.param(range(200), marks=pytest.mark.statistics)]
)
def test_signs_of_slow_presses_are_right_or_left_open(seeds: range) -> None:
    verdicts = [verdict(seed) for seed in seeds]
    assert [name for one in verdicts for name in one.wrong] == []
    clear = [one.is_open for one in verdicts if one.is_clear]
    assert np.mean(clear) <= 0.05
