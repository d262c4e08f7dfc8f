# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Robots by name: topics and sign conventions, from files that name their sources."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np
import yaml

from fden_ros.configure.survey import Survey
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.source import Selection
from fden_ros.shipped import shipped

#: A found axis agrees with the convention, or is its opposite, within this cosine.
_ALIKE = 0.9


class Robot(NamedTuple):
    """A kind of robot."""

    says: str  #: its name in words
    topics: Mapping[str, Sequence[str]]  #: patterns of names by stream, the best first
    fields: Mapping[str, str]  #: of messages whose type is not a standard one, by stream
    convention: str  #: of the force: frame and sign in words
    axis: list[float] | None  #: in which the force grows as the tool presses along its own z
    notes: Sequence[str]


def robot_named(name: str) -> Robot:
    """Return the robot called `name`, one of :func:`~fden_ros.shipped.robot_names`."""
    path = shipped("config/robots") / f"{name}.yaml"
    content: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    force, streams = content["force"], {s: content[s] for s in ("force", "displacement")}
    topics = {stream: one["topics"] for stream, one in streams.items()}
    fields = {stream: one["field"] for stream, one in streams.items() if one.get("field")}
    return Robot(
        content["says"], topics, fields, force["convention"], force["axis"], content["notes"]
    )


def robot_selection(robot: Robot, present: Sequence[Topic], selection: Selection) -> Selection:
    """Return the selection with the robot's topics where one is present; given ones stay."""
    names, fields = dict(selection.topics), dict(selection.fields)
    usable = [topic.name for topic in present if topic.message_count]
    for stream, patterns in robot.topics.items():
        matches = ([name for name in usable if fnmatchcase(name, one)] for one in patterns)
        found = next(filter(None, matches), [])
        if stream not in names and len(found) == 1:
            names[stream] = found[0]
            if stream in robot.fields:
                fields.setdefault(stream, robot.fields[stream])
    return replace(selection, topics=names, fields=fields)


def robot_notes(robot: Robot, survey: Survey) -> list[str]:
    """Compare the findings with the robot's convention, a line each."""
    finding, axis = survey.finding("force axis"), robot.axis
    if axis is None or not finding.claim or not isinstance(finding.value, tuple):
        return list(robot.notes)
    cosine = float(np.dot(finding.value, axis))
    if cosine > _ALIKE:
        line = f"the force's axis is that of {robot.says}: {robot.convention}"
    elif cosine < -_ALIKE:
        line = (
            f"the force's axis is the OPPOSITE of that of {robot.says} ({robot.convention}): does "
            "the probe press backwards, or is it another driver? The recording's is used"
        )
    else:
        line = (
            f"the probe does not press along the tool's z, for which {robot.says} has "
            f"{axis}: the recording's axis is used"
        )
    return [line, *robot.notes]
