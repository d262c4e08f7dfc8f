# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Robots by name: topics, types and sign conventions, from files that name their sources."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fden_ros.configure.survey import Survey
from fden_ros.configure.writer import MESSAGES
from fden_ros.errors import InputError
from fden_ros.recording.reader import Topic
from fden_ros.recording.source import Selection

#: A found axis agrees with the convention within this cosine, or is its opposite.
_ALIKE = 0.9


@dataclass(frozen=True)
class Quantity:
    """Where a robot has force or displacement.

    Parameters
    ----------
    topics : tuple of str
        Patterns of names, the best first.
    type_name : str
    older_type : str
        Of older drivers; empty: none.
    reliability : str
        That the driver offers.
    convention : str
        Frame and sign in words.
    axis : tuple of float or None
        Direction in the frame in which the force grows as the tool presses along its own z; None
        where no source says.
    field : str
        Field of a type that is not a standard one; empty: the type is read as a whole.
    """

    topics: tuple[str, ...]
    type_name: str
    reliability: str
    convention: str
    older_type: str = ""
    axis: tuple[float, float, float] | None = None
    field: str = ""


@dataclass(frozen=True)
class Robot:
    """A kind of robot."""

    name: str
    says: str
    force: Quantity
    displacement: Quantity
    notes: tuple[str, ...]
    sources: tuple[str, ...]


def robot_names() -> tuple[str, ...]:
    """Return the names of all robots."""
    return tuple(sorted({path.stem for folder in _folders() for path in folder.glob("*.yaml")}))


def robot_named(name: str) -> Robot:
    """Return the robot called `name`.

    Raises
    ------
    InputError
        If there is none.
    """
    for folder in _folders():
        path = folder / f"{name}.yaml"
        if path.is_file():
            return _robot(name, yaml.safe_load(path.read_text(encoding="utf-8")))
    raise InputError(f"no robot {name} is known: {', '.join(robot_names()) or 'no files found'}")


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
    chosen: dict[str, Any] = {}
    for what, quantity in (("force", robot.force), ("displacement", robot.displacement)):
        given = getattr(selection, f"{what}_topic")
        chosen[f"{what}_topic"] = given or _topic(robot, what, quantity, where, topics)
        field = getattr(selection, f"{what}_field")
        chosen[f"{what}_field"] = field or (quantity.field or None if not given else None)
    return Selection(**chosen)


def robot_notes(robot: Robot, survey: Survey) -> list[str]:
    """Return how what was found goes with the robot's convention, a line each."""
    lines = []
    finding = survey.finding("force axis")
    axis = robot.force.axis
    if axis is not None and finding.claim and isinstance(finding.value, tuple):
        cosine = float(np.array(finding.value) @ np.array(axis))
        if cosine > _ALIKE:
            lines.append(f"the force's axis is that of {robot.says}: {robot.force.convention}")
        elif cosine < -_ALIKE:
            lines.append(
                f"the force's axis is the OPPOSITE of that of {robot.says} "
                f"({robot.force.convention}): does the probe press backwards, or is it another "
                "driver? The recording's is used"
            )
        else:
            lines.append(
                f"the probe does not press along the tool's z, for which {robot.says} has "
                f"{list(axis)}: the recording's axis is used"
            )
    return [*lines, *robot.notes]


def robot_file(robot: Robot) -> str:
    """Return the beginning of a parameter file, from the robot's conventions alone."""
    lines = [
        f"# {robot.says}: what its driver's conventions say, before any recording.",
        f"# Live: -r force:={_example(robot.force)} -r displacement:="
        f"{_example(robot.displacement)}",
    ]
    for what, quantity in (("force", robot.force), ("displacement", robot.displacement)):
        lines.append(
            f"# {what}: {quantity.type_name}, {quantity.reliability}; {quantity.convention}"
        )
    lines += [f"# {note}" for note in robot.notes]
    lines += [f"# source: {' '.join(source.split())}" for source in robot.sources]
    lines += ["/**:", "  ros__parameters:", "    force:"]
    lines.append(f'      message: "{MESSAGES.get(robot.force.type_name, "wrench")}"')
    if robot.force.axis is not None:
        lines.append("      # Where the tool presses along its own z.")
        lines.append(f"      axis: {list(robot.force.axis)}")
    else:
        lines.append("    # force.axis: CANNOT TELL from the driver; record a press, and")
        lines.append("    #   fden configure --robot finds it.")
    lines.append(
        "    # displacement.axis: CANNOT TELL without a recording: the direction into the"
    )
    lines.append("    #   tissue in the frame of the poses.")
    message = MESSAGES.get(robot.displacement.type_name)
    if message is not None:
        lines += ["    displacement:", f'      message: "{message}"']
    lines.append("    # geometry: state your indenter: kind, area and thickness, or radius.")
    return "\n".join(lines) + "\n"


def _folders() -> Iterator[Path]:
    """Yield where the files may be: in the source, or installed beside ROS or Python."""
    roots = [Path(__file__).parents[2] / "config"]
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    roots += [Path(prefix, "share", "fden_ros", "config") for prefix in prefixes if prefix]
    for root in roots:
        if (root / "robots").is_dir():
            yield root / "robots"


def _robot(name: str, content: Mapping[str, Any]) -> Robot:
    quantities = {
        what: Quantity(
            topics=tuple(content[what]["topics"]),
            type_name=content[what]["type"],
            reliability=content[what]["reliability"],
            convention=content[what]["convention"],
            older_type=content[what].get("older_type", ""),
            axis=_vector(content[what].get("axis")),
            field=content[what].get("field", ""),
        )
        for what in ("force", "displacement")
    }
    return Robot(
        name,
        content["says"],
        quantities["force"],
        quantities["displacement"],
        tuple(content["notes"]),
        tuple(content["sources"]),
    )


def _vector(values: Any) -> tuple[float, float, float] | None:
    if values is None:
        return None
    x, y, z = (float(value) for value in values)
    return x, y, z


def _topic(
    robot: Robot, what: str, quantity: Quantity, where: str, all_topics: Sequence[Topic]
) -> str:
    types = (quantity.type_name, quantity.older_type)
    topics = [t for t in all_topics if t.type_name in types and t.message_count]
    for pattern in quantity.topics:
        names = [topic.name for topic in topics if fnmatchcase(topic.name, pattern)]
        if len(names) > 1:
            raise InputError(
                f"{where}: several topics of {robot.says} carry the {what}: "
                f"{', '.join(names)}; name it with --{what}-topic"
            )
        if names:
            return names[0]
    present = ", ".join(f"{t.name} ({t.type_name})" for t in all_topics) or "none"
    raise InputError(
        f"{where}: no topic {' or '.join(quantity.topics)} of {quantity.type_name}, where "
        f"{robot.says} has its {what}: it has {present}; name it with --{what}-topic"
    )


def _example(quantity: Quantity) -> str:
    return (
        quantity.topics[0].replace("*", "", 1)
        if quantity.topics[0].startswith("*/")
        else (quantity.topics[0].replace("*", "NAME_", 1))
    )
