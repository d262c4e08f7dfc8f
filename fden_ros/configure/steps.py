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

"""What to do next with the robot, so that everything about the probe is found."""

from __future__ import annotations

from dataclasses import dataclass

from fden_ros.configure.survey import Survey


@dataclass(frozen=True)
class Step:
    """One thing to do.

    Parameters
    ----------
    name, says : str
        Short, and in words.
    subjects : tuple of str
        Findings that are stated once it is done.
    """

    name: str
    says: str
    subjects: tuple[str, ...]

    def is_done(self, found: Survey) -> bool:
        """Whether what it is for is stated."""
        return all(found.finding(subject).claim for subject in self.subjects)


#: In this order: each needs what stands before it.
STEPS = (
    Step("air", "hold the probe still in the air for 3 s", ("force noise",)),
    Step(
        "turn",
        "turn the tool in the air through three orientations 60 degrees apart, half a turn in "
        "2 s, with a second of rest at each, and turn back",
        ("tool mass",),
    ),
    Step(
        "press",
        "press tissue three times by 3 mm or more, hold for 2 s, and lift off by 3 mm in between",
        ("force axis", "displacement axis"),
    ),
    Step(
        "plate",
        "press a rigid plate twice, slowly, to the largest force of your presses",
        ("compliance",),
    ),
    Step(
        "delay",
        "press tissue by 3 mm, wait for 2 s, and move by 0.5 mm in a sine: ten cycles at 1 Hz, "
        "ten at 4 Hz",
        ("delay",),
    ),
)


def steps_for(has_orientation: bool) -> tuple[Step, ...]:
    """Return the steps; without orientations turning the tool shows nothing."""
    return tuple(step for step in STEPS if has_orientation or step.name != "turn")
