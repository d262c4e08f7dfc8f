# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables and bags of every kind give what they hold, or say in one line what is missing."""

from __future__ import annotations

import functools
import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest
from pipeline_helpers import refusal
from recording_kinds import (
    BAGS,
    NEWTONS,
    NO_METADATA,
    ROWS,
    STAMPS,
    START,
    TABLES,
    Table,
    alone,
    bag_of,
    small,
)
from std_msgs.msg import Float64MultiArray

from fden_ros.cli import main
from fden_ros.configure.reading import read
from fden_ros.errors import InputError
from fden_ros.nodes.player import problem_of
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import check, read_parameter_file
from fden_ros.recording.message_types import serialize
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns, TableReader
from fden_ros.recording.text import looks_like_a_table
from fden_ros.recording.writer import BagWriter

PRESS = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"


def reader_of(folder: Path, table: Table) -> TableReader:
    path = folder / table.file
    content = table.content
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert looks_like_a_table(path)
    return TableReader(path, Columns.parse(table.columns) if table.columns else None)


def values(reader: TableReader) -> list[tuple[float, ...]]:
    """Return what stands in the rows, times from the first on, sparse rows joined."""
    found: dict[int, list[float]] = {}
    for stamp, *row in zip(reader.stamps, reader.force, reader.displacement, strict=True):
        kept = found.setdefault(int(stamp), [math.nan, math.nan])
        for k, value in enumerate(row):
            kept[k] = kept[k] if math.isnan(value) else value
    full = ((stamp, kept) for stamp, kept in found.items() if not all(map(math.isnan, kept)))
    return [(1e-9 * (stamp - min(found)), *kept) for stamp, kept in full]


@pytest.mark.parametrize("kind", TABLES)
def test_every_kind_of_table_is_read_as_it_stands_or_refused_in_one_line(kind, tmp_path):
    table = TABLES[kind]
    if table.refused:
        line = refusal(lambda folder: reader_of(folder, table), tmp_path)
        assert all(words in line for words in table.refused)
    else:
        reader = reader_of(tmp_path, table)
        assert values(reader) == [pytest.approx(row, rel=1e-6, abs=1e-12) for row in ROWS]
        assert table.warned in " ".join(reader.warnings)


@pytest.mark.parametrize("repeats", [(1,), (10,), (3, 4)])
def test_of_a_force_that_stands_in_several_rows_the_first_is_used_and_its_rate_said(
    repeats, tmp_path
):
    cells = [f for k in range(60) for f in [0.1 + 0.01 * k] * repeats[k % len(repeats)]]
    rows = "".join(f"{0.01 * i:.2f},{f:.2f},{0.1 * i:.1f}\n" for i, f in enumerate(cells))
    reader = reader_of(tmp_path, Table(NEWTONS + rows))
    kept = reader.force[~np.isnan(reader.force)]
    mean = sum(repeats) / len(repeats)
    assert kept == pytest.approx([0.1 + 0.01 * k for k in range(60)])
    assert reader.stamps.size == reader.displacement.size == len(cells)
    said = f"stands in {mean:.2g} rows: the first of them is used" in " ".join(reader.warnings)
    assert said == (mean > 1.0)


@pytest.mark.parametrize("kind", BAGS)
def test_every_kind_of_bag_gives_the_same_messages_or_says_why_not_in_one_line(kind, tmp_path):
    messages, expected = small(), BAGS[kind]
    path = expected.make(tmp_path, messages)
    if expected.refused:
        line = refusal(BagReader, path)
        assert expected.refused in line and "ros2 " not in line
        return
    bag = BagReader(path)
    assert list(bag.messages()) == messages
    assert list(bag.messages(["/joints"])) == messages[1::2]
    assert [(t.name, t.message_count) for t in bag.topics] == [("/force", 120), ("/joints", 120)]
    assert (bag.start_ns, bag.end_ns) == (START, START + 1_190_000_000)
    assert (NO_METADATA in " ".join(bag.warnings)) == (expected.warned == NO_METADATA)
    assert not any(map(problem_of, bag.topics))


def test_a_replay_of_any_kind_is_that_of_mcap_bit_for_bit(tmp_path):
    parameters = read_parameter_file(PRESS / "identifier.yaml")
    messages = list(BagReader(PRESS).messages(["/force", "/displacement"]))
    results = []
    for kind in ("MCAP", "sqlite3", "ROS 1"):
        (tmp_path / kind).mkdir()
        # The first of two presses.
        bag = bag_of(kind, tmp_path / kind, messages[: len(messages) // 2])
        results.append(result_object(replay(bag, parameters)))
    assert results[0] == results[1] == results[2]
    assert results[0]["contacts"][0]["converged"]


@pytest.mark.parametrize("kind", ["sqlite3 file", "ROS 1", "ROS 1 in lz4", "MCAP", "table"])
def test_bytes_damaged_anywhere_are_read_or_refused_in_one_line(kind, tmp_path):
    if kind == "table":
        path = reader_of(tmp_path, Table(NEWTONS + "".join(f"{k},1,2\n" for k in range(99)))).path
    else:
        path = bag_of(kind, tmp_path, small())
        path = alone(path) if path.is_dir() else path
    content = path.read_bytes()
    for place in range(0 if kind == "table" else 20, len(content), len(content) // 60):
        path.write_bytes(content[:place] + b"\xa5" * 9 + content[place + 9 :])
        try:
            if kind == "table":
                read = TableReader(path).stamps.tolist()
            else:
                read = list(BagReader(path).messages())
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert len(read) <= 240


@pytest.mark.parametrize(
    ("stream", "empty", "kind"),
    [
        ("force", "/force", "geometry_msgs/msg/WrenchStamped"),
        ("displacement", "/joints", "sensor_msgs/msg/JointState"),
    ],
)
def test_a_topic_without_messages_is_named_as_such(stream, empty, kind, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for first in small(1):
            bag.add_topic(first.topic, first.type_name)
        for message in small():
            if message.topic != empty:
                bag.write(message.topic, decode(message), message.log_time_ns)
    for topics, words in (
        ({}, f"{empty} ({kind}, no messages)"),
        ({stream: empty}, f"topic {empty} has no messages"),
    ):
        for use in (lambda path, chosen: replay(path, check({}), chosen), read):
            line = refusal(functools.partial(use, tmp_path / "bag"), Selection(topics))
            assert words in line and "damaged" not in line


@pytest.mark.parametrize("names", [["probe"], ["probe", "wrist"]])
def test_of_several_joints_it_is_said_which_one_is_taken(names, tmp_path):
    messages = [
        m if m.topic == "/force" else m._replace(data=serialize(renamed(decode(m), names)))
        for m in small()
    ]
    bag = bag_of("MCAP", tmp_path, messages)
    words = "/joints has the joints probe, wrist: the first is the displacement"
    for parameters, is_said in (({}, len(names) > 1), ({"displacement.name": "probe"}, False)):
        warnings = replay(bag, check(parameters)).warnings
        assert any(words in warning for warning in warnings) == is_said


def renamed(joints, names):
    joints.name = names
    joints.position = np.array([joints.position[0], *([0.0] * (len(names) - 1))])
    return joints


@pytest.mark.parametrize(
    ("kind", "stamps"),
    [*(("MCAP", stamps) for stamps in STAMPS), ("sqlite3", "zero"), ("ROS 1", "since boot")],
)
def test_stamps_that_cannot_be_used_are_named_and_the_times_of_recording_do(
    kind, stamps, tmp_path
):
    stamp, words = STAMPS[stamps]
    bag = bag_of(kind, tmp_path, small(stamp=stamp))
    as_they_are = replay(bag, check({}))
    assert words in as_they_are.warnings[0]
    assert "--stamps recording" in as_they_are.warnings[0]
    received = replay(bag, check({}), Selection(stamps="recording"))
    assert received.samples == 120
    assert not any("stamps" in warning for warning in received.warnings)
    if stamps == "zero":
        by_parameter = replay(bag, check({"synchronize.stamp_source": "receive"}))
        assert result_object(by_parameter) == result_object(received)
        with pytest.raises(InputError, match=r"are 0.*--stamps recording.*0 usable samples"):
            read(bag)
    reading = read(bag, Selection(stamps="recording"))
    assert reading.streams.force_times.size == reading.streams.motion_times.size == 120


def test_numbers_that_could_be_meant_are_listed_with_the_options_that_name_them(tmp_path, capsys):
    """Of one array: time, a constant, force and depth."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/data", "std_msgs/msg/Float64MultiArray")
        for k in range(500):
            depth = max(0.0, 1e-5 * (k - 200))
            numbers = [1.0 + 0.01 * k, 0.5, 100.0 * depth, 0.01 + depth]
            bag.write("/data", Float64MultiArray(data=numbers), START + k * 10_000_000)
    assert main(["replay", str(tmp_path / "bag"), "--json"]) == 1
    _, *listed, proposed = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in listed] == ["data[0]", "data[2]", "data[3]"]
    words = shlex.split(proposed.removeprefix("try: fden "))
    for stream, field in (("force", "data[2]"), ("displacement", "data[3]")):
        place = words.index(f"--{stream}-topic")
        assert words[place + 1 : place + 4] == ["TOPIC", f"--{stream}-field", "FIELD"]
        words[place + 1], words[place + 3] = "/data", field
    assert main(words) in (0, 3)
    inputs = json.loads(capsys.readouterr().out)["inputs"]
    assert inputs == {"force": "/data data[2]", "displacement": "/data data[3]"}
