# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The layouts of Foxglove, RViz and PlotJuggler show topics and fields that there are."""

from __future__ import annotations

import array
import itertools
import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from rclpy.expand_topic_name import expand_topic_name

from fden_ros.inputs import TYPE_NAMES
from fden_ros.offline.results import DIAGNOSTICS_TOPIC, NODE
from fden_ros.parameters import Parameters
from fden_ros.recording.message_types import message_class
from fden_ros.ros.messages import type_name
from fden_ros.ros.stiffness_map import StiffnessMap
from fden_ros.ros.topics import OUTPUT_TOPICS

CONFIG = Path(__file__).parent.parent / "config"
# The node's topics, and those of the bags that `fden bag` makes and of the node's defaults.
TYPES = {f"{NODE}/{topic.name}": type_name(topic.message_type) for topic in OUTPUT_TOPICS} | {
    DIAGNOSTICS_TOPIC: "diagnostic_msgs/msg/DiagnosticArray",
    "/force": "geometry_msgs/msg/WrenchStamped",
    "/displacement": TYPE_NAMES["displacement"][Parameters().displacement.message],
}
DISPLAYS = {
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "Pose": "geometry_msgs/msg/PoseStamped",
    "Wrench": "geometry_msgs/msg/WrenchStamped",
}


def read_by(path: str, separator: str) -> Any:
    """Return what stands at a path: a topic, and fields of its message, one of them indexed."""
    topic = next(topic for topic in TYPES if path == topic or path.startswith(topic + separator))
    value = message_class(TYPES[topic])()
    fields = path.removeprefix(topic).split(separator)[1:]
    if TYPES[topic].endswith("/JointState") and separator == "/":
        # PlotJuggler puts the joint's name between topic and field.
        assert fields.pop(0) == "probe"
    for field in fields:
        name, _, index = field.partition("[")
        value = getattr(value, name)
        if index:
            assert (index, value.typecode) == ("0]", "d"), path
            value = 0.0
    return value


def paths(layout: dict[str, Any]) -> Iterator[str]:
    for name, config in layout["configById"].items():
        kind = name.partition("!")[0]
        if kind == "Plot":
            yield from (path["value"] for path in config["paths"])
        elif kind == "Indicator":
            yield config["path"]
        elif kind == "RawMessages":
            yield config["topicPath"]
        elif kind == "DiagnosticStatusPanel":
            yield config["topicToRender"]
        elif kind == "3D":
            yield from config["topics"]
        else:
            raise AssertionError(kind)


def made_by_scripts(layout: dict[str, Any]) -> set[str]:
    """Return the paths that the layout's own scripts make, what they read looked up."""
    made = set()
    for script in layout["userNodes"].values():
        code = script["sourceCode"]
        (topic,) = re.findall(r'inputs = \["(.*)"\];', code)
        (output,) = re.findall(r'output = "(/studio_script/.*)";', code)
        assert f'Input<"{topic}">' in code
        (read,) = re.findall(r"const \{ (.*) \} = event.message;", code)
        message = message_class(TYPES[topic])()
        assert all(hasattr(message, field) for field in read.split(", "))
        made |= {f"{output}.{field}" for field in re.findall(r"(?m)^    (\w+): Math", code)}
    return made


def test_every_path_of_the_foxglove_layout_exists():
    layout = json.loads((CONFIG / "foxglove_layout.json").read_text())
    found = list(paths(layout))
    assert len(found) > 10
    made = made_by_scripts(layout)
    assert len(made & set(found)) == len(made) == 4
    for path in found:
        if path in made:
            continue
        value = read_by(path, ".")
        assert path in TYPES or isinstance(value, (int, float)), path


def test_every_display_of_rviz_has_a_topic_of_its_type():
    manager = yaml.safe_load((CONFIG / "identifier.rviz").read_text())["Visualization Manager"]
    shown = [d for d in manager["Displays"] if "Topic" in d]
    assert len(shown) == 3
    fields = {"identifier/stiffness_map": {field.name for field in StiffnessMap().cloud().fields}}
    for display in shown:
        kind, topic = display["Class"].rpartition("/")[2], display["Topic"]["Value"]
        assert kind != "PointCloud2" or display["Channel Name"] in fields[topic]
        # RViz shows the probe where it is published as a pose; a joint has no place.
        types = TYPES | {"/displacement": "geometry_msgs/msg/PoseStamped"}
        # Below the namespace of RViz itself, as rcl expands a name.
        for namespace in ("/", "/left"):
            name = expand_topic_name(topic, "rviz", namespace)
            assert types[name.removeprefix("/left")] == DISPLAYS[kind]
            assert name.startswith(namespace)


def test_every_curve_of_the_plotjuggler_layout_exists_and_is_drawn_in_its_plot():
    """As PlotJuggler's ``xmlLoadState`` reads it; series are named by topic and fields."""
    root = ElementTree.parse(CONFIG / "plotjuggler_layout.xml").getroot()
    (widget,) = root.findall("tabbed_widget[@parent='main_window']")
    made = {}
    for snippet in root.iterfind("customMathEquations/snippet"):
        sources = [snippet.findtext("linked_source"), snippet.findtext("additional_sources/v1")]
        made[snippet.get("name")] = sources
    drawn = widget.findall(".//DockArea/plot[@mode='TimeSeries']/curve")
    (places,) = widget.findall(".//DockArea/plot[@mode='XYPlot']/curve")
    curves = [curve.get("name") for curve in drawn]
    curves += [places.get("curve_x"), places.get("curve_y")]
    assert set(made) < set(curves)
    for name in [*(c for c in curves if c not in made), *itertools.chain(*made.values())]:
        value = read_by(str(name), "/")
        assert isinstance(value, (int, float, array.array)), name
