# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The projector of measurements: fields of any message, tables and topics come out alike."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from fden_ros.errors import InputError
from fden_ros.offline.replay import Replay, replay, result_object
from fden_ros.parameters import Parameters, read_parameter_file
from fden_ros.recording.definitions import message_class
from fden_ros.recording.reader import BagReader
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.recording.writer import BagWriter
from simulation.bag import PARAMETER_FILE

BAG = Path(__file__).parent.parent / "bags" / "golden" / "golden_pose"
FORCE, POSE = "/tool/wrench", "/arm/measured_cp"
FIELDS = Selection(
    {"force": FORCE, "displacement": POSE},
    {"force": "wrench.force", "displacement": "pose.position"},
)


def own_parameters(**changes: Any) -> Parameters:
    values = {name.replace("__", "."): value for name, value in changes.items()}
    return read_parameter_file(BAG / PARAMETER_FILE).changed(values)


def copied(folder: Path, change: Any) -> Path:
    """The bag with every message changed by `change`, which has its topic and number."""
    reader = BagReader(BAG)
    kinds = {t.name: message_class(t.type_name) for t in reader.topics}
    with BagWriter(folder) as writer:
        for topic in reader.topics:
            writer.add_topic(topic.name, topic.type_name, *topic.offered_qos)
        for number, raw in enumerate(reader.messages()):
            message = deserialize_message(raw.data, kinds[raw.topic])
            change(raw.topic, number, message)
            writer.write(raw.topic, serialize_message(message), raw.log_time_ns)
    return folder


def without_names(result: Replay) -> dict[str, Any]:
    return result_object(replace(result, inputs={}))


@pytest.mark.parametrize("mass", [0.0, 0.02])
def test_fields_give_what_the_topics_give_the_weight_of_the_tool_too(
    mass: float, tmp_path: Path
) -> None:
    def turn(topic: str, number: int, message: Any) -> None:
        if topic == POSE:  # about x, by 1 rad in all
            half = 0.5 * number / 4079
            turned = message.pose.orientation
            turned.x, turned.w = math.sin(half), math.cos(half)

    bag = copied(tmp_path / "bag", turn)
    parameters = own_parameters(tool__mass=mass)
    topics, fields = replay(bag, parameters), replay(bag, parameters, FIELDS)
    assert topics.summaries
    assert without_names(fields) == without_names(topics)
    if mass:
        heavy = [s.max_force for s in topics.summaries]
        light = [s.max_force for s in replay(bag, own_parameters()).summaries]
        assert heavy != light


@pytest.mark.parametrize("selection", [None, FIELDS], ids=["topics", "fields"])
@pytest.mark.parametrize(("topic", "stream"), [(FORCE, "force"), (POSE, "displacement")])
def test_another_frame_is_rejected_wherever_a_sample_comes_from(
    selection: Selection | None, topic: str, stream: str, tmp_path: Path
) -> None:
    renamed = []

    def rename(name: str, number: int, message: Any) -> None:
        if name == topic and number % 500 == 499:
            message.header.frame_id = "elsewhere"
            renamed.append(number)

    bag = copied(tmp_path / "bag", rename)
    result = replay(bag, own_parameters(), selection)
    assert renamed
    assert result.rejected[f"{stream}.wrong_frame"] == len(renamed)


def test_table_without_orientations_is_refused_for_a_heavy_tool(tmp_path: Path) -> None:
    table = tmp_path / "press.csv"
    table.write_text("time,force,depth\n0.0,0.0,0.0\n0.1,0.0,0.0\n")
    selection = Selection(columns=Columns.parse("time,force,depth"))
    assert replay(table, Parameters(), selection).samples == 2
    with pytest.raises(InputError, match=r"tool\.mass takes off the weight"):
        replay(table, own_parameters(tool__mass=0.01), selection)
