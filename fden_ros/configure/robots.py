# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Robots by name: topics, types and sign conventions, from files that name their sources."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import yaml

from fden_ros.configure.reading import MESSAGES
from fden_ros.configure.survey import Survey
from fden_ros.errors import InputError
from fden_ros.parameters import LIVE_LINE
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.source import Selection
from fden_ros.shipped import shipped

#: A found axis agrees with the convention within this cosine, or is its opposite.
_ALIKE = 0.9


@dataclass(frozen=True)
class Quantity:
    """Where a robot has force or displacement.

    Parameters
    ----------
    topics : tuple of str
        Patterns of names, the best first.
    type : str
    reliability : str
        That the driver offers.
    convention : str
        Frame and sign in words.
    older_type : str
        Of older drivers; empty: none.
    axis : list of float or None
        Direction in the frame in which the force grows as the tool presses along its own z; None
        where no source says.
    field : str
        Field of a type that is not a standard one; empty: the type is read as a whole.
    """

    topics: Sequence[str]
    type: str
    reliability: str
    convention: str
    older_type: str = ""
    axis: list[float] | None = None
    field: str = ""

    @property
    def example(self) -> str:
        """Name of a topic as it may be."""
        return self.topics[0].removeprefix("*").replace("*", "NAME_", 1)


@dataclass(frozen=True)
class Robot:
    """A kind of robot."""

    name: str
    says: str
    force: Quantity
    displacement: Quantity
    notes: Sequence[str]
    sources: Sequence[str]

    @property
    def quantities(self) -> Mapping[str, Quantity]:
        """Force and displacement by name."""
        return {"force": self.force, "displacement": self.displacement}


def robot_names() -> tuple[str, ...]:
    """Return the names of all robots."""
    return tuple(sorted(path.stem for path in shipped("config/robots").glob("*.yaml")))


def robot_named(name: str) -> Robot:
    """Return the robot called `name`.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in robot_names():
        raise InputError(f"no robot {name} is known: {', '.join(robot_names())}")
    path = shipped("config/robots") / f"{name}.yaml"
    content: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    force, displacement = (Quantity(**content.pop(stream)) for stream in ("force", "displacement"))
    return Robot(name, force=force, displacement=displacement, **content)


def robot_selection(
    robot: Robot, where: str, topics: Sequence[Topic], selection: Selection
) -> Selection:
    """Return which topics have the robot's force and displacement; what is given stays.

    Parameters
    ----------
    robot : Robot
    where : str
        What has the topics, for the line that says what is wrong.
    topics : sequence of Topic
    selection : Selection

    Raises
    ------
    InputError
        If none of the topics is the robot's, or those of several arms.
    """
    names, fields = dict(selection.topics), dict(selection.fields)
    for stream, quantity in robot.quantities.items():
        if stream not in names:
            names[stream] = _topic(robot, stream, where, topics)
            if quantity.field:
                fields.setdefault(stream, quantity.field)
    return replace(selection, topics=names, fields=fields)


def _topic(robot: Robot, stream: str, where: str, present: Sequence[Topic]) -> str:
    quantity = robot.quantities[stream]
    types = (quantity.type, quantity.older_type)
    usable = [topic.name for topic in present if topic.type_name in types and topic.message_count]
    for pattern in quantity.topics:
        names = [name for name in usable if fnmatchcase(name, pattern)]
        if len(names) > 1:
            raise InputError(
                f"{where}: several topics of {robot.says} carry the {stream}: "
                f"{', '.join(names)}; name it with --{stream}-topic"
            )
        if names:
            return names[0]
    listed = ", ".join(f"{topic.name} ({topic.type_name})" for topic in present) or "none"
    raise InputError(
        f"{where}: no topic {' or '.join(quantity.topics)} of {quantity.type}, where "
        f"{robot.says} has its {stream}: it has {listed}; name it with --{stream}-topic"
    )


def robot_notes(robot: Robot, survey: Survey) -> list[str]:
    """Return how what was found goes with the robot's convention, a line each."""
    finding, axis = survey.finding("force axis"), robot.force.axis
    if axis is None or not finding.claim or not isinstance(finding.value, tuple):
        return list(robot.notes)
    cosine = float(np.dot(finding.value, axis))
    if cosine > _ALIKE:
        line = f"the force's axis is that of {robot.says}: {robot.force.convention}"
    elif cosine < -_ALIKE:
        line = (
            f"the force's axis is the OPPOSITE of that of {robot.says} "
            f"({robot.force.convention}): does the probe press backwards, or is it another "
            "driver? The recording's is used"
        )
    else:
        line = (
            f"the probe does not press along the tool's z, for which {robot.says} has "
            f"{axis}: the recording's axis is used"
        )
    return [line, *robot.notes]


def robot_file(robot: Robot) -> str:
    """Return the beginning of a parameter file, from the robot's conventions alone."""
    remaps = " ".join(f"-r {stream}:={one.example}" for stream, one in robot.quantities.items())
    lines = [
        f"# {robot.says}: what its driver's conventions say, before any recording.",
        f"{LIVE_LINE}{remaps}",
    ]
    for stream, one in robot.quantities.items():
        lines.append(f"# {stream}: {one.type}, {one.reliability}; {one.convention}")
    lines += [f"# {note}" for note in robot.notes]
    lines += [f"# source: {' '.join(source.split())}" for source in robot.sources]
    lines += ["/**:", "  ros__parameters:", "    force:"]
    lines.append(f'      message: "{MESSAGES.get(robot.force.type, "wrench")}"')
    if robot.force.axis is not None:
        lines += [
            "      # Where the tool presses along its own z.",
            f"      axis: {robot.force.axis}",
        ]
    else:
        lines.append("    # force.axis: CANNOT TELL from the driver: record a press")
    if robot.displacement.type in MESSAGES:
        lines += ["    displacement:", f'      message: "{MESSAGES[robot.displacement.type]}"']
    lines.append(
        "    # displacement.axis: CANNOT TELL without a recording: into the tissue, in the"
    )
    lines.append("    #   frame of the poses")
    lines.append("    # geometry: state your indenter: kind, area and thickness, or radius")
    return "\n".join(lines) + "\n"
