# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The layouts of Foxglove, RViz and PlotJuggler show topics and fields that there are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from fden_ros.inputs import TYPE_NAMES
from fden_ros.offline.results import DIAGNOSTICS_TOPIC, NODE
from fden_ros.parameters import Parameters
from fden_ros.recording.message_types import message_class
from fden_ros.ros.messages import type_name
from fden_ros.ros.topics import OUTPUT_TOPICS

CONFIG = Path(__file__).parent.parent / "config"
# The node's topics, and those of the bags that `fden bag` makes and of the node's defaults.
TYPES = {f"{NODE}/{topic.name}": type_name(topic.message_type) for topic in OUTPUT_TOPICS} | {
    DIAGNOSTICS_TOPIC: "diagnostic_msgs/msg/DiagnosticArray",
    "/force": "geometry_msgs/msg/WrenchStamped",
    "/displacement": TYPE_NAMES["displacement"][Parameters().displacement.message],
}


def read_by(path: str, separator: str) -> Any:
    """Return what stands at a path: a topic, and fields of its message, one of them indexed."""
    topic = max((one for one in TYPES if path.startswith(one)), key=len)
    value = message_class(TYPES[topic])()
    # PlotJuggler puts the joint's name between topic and field.
    fields = path.removeprefix(topic).replace("/probe", "").split(separator)[1:]
    for field in fields:
        name, _, index = field.partition("[")
        value = getattr(value, name)
        if index:
            assert (index, value.typecode) == ("0]", "d"), path
    return value


@pytest.mark.parametrize(
    ("layout", "separator"), [("foxglove_layout.json", "."), ("plotjuggler_layout.xml", "/")]
)
def test_every_path_of_a_layout_exists(layout, separator):
    text = (CONFIG / layout).read_text(encoding="utf-8").replace(r"\"", '"')
    found = set(
        re.findall(r'[">](/(?:identifier|force|displacement|diagnostics)[^"<]*)["<]', text)
    )
    assert len(found) > 8
    for path in found:
        value = read_by(path, separator)
        assert path in TYPES or isinstance(value, (int, float)) or hasattr(value, "typecode"), path
    # What the layout's own script reads of a message.
    for fields in re.findall(r"const \{ (.*) \} = event.message;", text):
        message = message_class(TYPES["/identifier/estimate"])()
        assert all(hasattr(message, field) for field in fields.split(", "))
