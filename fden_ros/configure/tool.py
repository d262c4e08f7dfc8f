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

"""The tool's weight while a robot turns it in the air: what has come, and what that tells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fden_ros.configure.finding import Finding
from fden_ros.configure.reading import Column, reading_of
from fden_ros.configure.weight import find_weight, weight_finding
from fden_ros.errors import InputError
from fden_ros.recording.reader import Topic
from fden_ros.recording.source import Selection


@dataclass(frozen=True)
class ToolAnswer:
    """What the turns tell of the tool by now.

    Parameters
    ----------
    is_known : bool
        ``tool.*`` can be set by it.
    words : str
        The answer in one line; where it is not known, why, and the motion that would tell.
    mass, centre : Finding, optional
        Of all that the sensor carries [kg], and of its mass in the sensor's frame [m].
    """

    is_known: bool
    words: str
    mass: Finding | None = None
    centre: Finding | None = None


class ToolCollection:
    """Forces and orientations since the collection began.

    Parameters
    ----------
    force, displacement : Topic
        Where they come from: a wrench, and a pose or a transform of the sensor.
    needs_centre : bool
        Whether the centre of mass counts, as for a torque.

    Raises
    ------
    InputError
        If one of the types says nothing of a tool's weight.
    """

    def __init__(self, force: Topic, displacement: Topic, *, needs_centre: bool) -> None:
        needed = {
            force: ("geometry_msgs/msg/WrenchStamped",),
            displacement: ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"),
        }
        for topic, types in needed.items():
            if topic.type_name not in types:
                raise InputError(
                    f"{topic.name} is a {topic.type_name.replace('/msg/', '/')}: the tool's "
                    "weight wants a wrench and the orientation of a pose or transform "
                    "(force.message, displacement.message)"
                )
        self._needs_centre = needs_centre
        self._columns = {
            "force": Column(force, None, "force"),
            "displacement": Column(displacement, None, "displacement"),
        }

    def add(self, what: str, data: bytes) -> None:
        """Take a message of ``force`` or ``displacement`` as CDR bytes."""
        self._columns[what].add(data, 0)

    @property
    def seconds(self) -> float:
        """From the first stamp of the force to its last [s]."""
        stamps = self._columns["force"].stamps
        return 1e-9 * (stamps[-1] - stamps[0]) if stamps else 0.0

    def answer(self) -> ToolAnswer:
        """Return what is known by now."""
        force, displacement = self._columns["force"], self._columns["displacement"]
        inputs = {what: column.topic.name for what, column in self._columns.items()}
        try:
            reading = reading_of(Path("live"), force, displacement, Selection(), inputs)
        except InputError as error:
            return ToolAnswer(False, f"{error}".removeprefix("live: "))
        streams = [reading.streams]
        mass, centre = weight_finding(find_weight(streams), streams, 1.0)
        if not mass.claim:
            return ToolAnswer(False, f"{mass.evidence}: {mass.motion}; then ask again")
        if not mass.parameters:
            return ToolAnswer(False, mass.evidence, mass)
        if not mass.value:
            return ToolAnswer(True, f"tool.mass: 0 kg; {mass.evidence}", mass)
        if self._needs_centre and not centre.claim:
            words = f"{_words(mass)}, but {centre.evidence}: {centre.motion}; then ask again"
            return ToolAnswer(False, words, mass)
        said = [_words(mass), *([_words(centre)] if centre.claim else [])]
        words = f"{', '.join(said)}: put them into the parameter file and configure anew"
        return ToolAnswer(True, words, mass, centre if centre.claim else None)


def _words(finding: Finding) -> str:
    """Return the parameters that a finding sets, as in ``tool.mass: 0.3 ± 0.001 kg``."""
    said = []
    for name, value in finding.parameters.items():
        is_own = name != "tool.gravity"
        said.append(f"{name}: {value}" + (f" ± {finding.deviation:.2g}" if is_own else ""))
        said[-1] += f" {finding.unit if is_own else 'm/s^2'}"
    return ", ".join(said)
