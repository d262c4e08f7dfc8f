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
from command_helpers import answer
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
from fden_ros.parameters import check
from fden_ros.recording.message_types import serialize
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.source import Selection, open_source
from fden_ros.recording.table import Columns, TableReader
from fden_ros.recording.text import looks_like_a_table
from fden_ros.recording.writer import BagWriter


def reader_of(folder: Path, table: Table) -> TableReader:
    path = folder / table.file
    content = table.content
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert looks_like_a_table(path)
    return TableReader(path, Columns.parse(table.columns) if table.columns else None)


def values(reader: TableReader) -> list[tuple[float, ...]]:
    """Return the numbers of the rows, times from the first on, sparse rows joined."""
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
    said = f"is repeated in {mean:.2g} rows: the first of them is used"
    assert (said in " ".join(reader.warnings)) == (mean > 1.0)


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


# Tables of testing machines, which lack the air before a press


EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "press.csv"


def machine_rows(
    air: float = 0.0,
    offset: float = 0.0,
    steps: int = 400,
    slope: float = 500.0,
    curve: float = 100.0,
) -> str:
    """Return the rows of a press at 0.1 mm/s, 10 Hz and 2 mN of noise.

    After so much air [m] the force [N] has a slope [N/m] that grows exponentially [1/m].
    """
    noise = np.random.default_rng(7).normal(0.0, 2e-3, steps)
    way = 1e-5 * np.arange(steps)
    depth = np.maximum(way - air, 0.0)
    force = offset + slope * depth * np.exp(curve * depth) + noise
    return "".join(
        f"{0.1 * i:.1f},{f:.5f},{1e3 * w:.4f}\n"
        for i, (f, w) in enumerate(zip(force, way, strict=True))
    )


SPECIMEN = "Cylinder Diameter: 50mm;\nCylinder Height: 30mm;\n"


@pytest.mark.parametrize(
    ("preamble", "air", "offset", "is_touched", "is_asked"),
    [
        (SPECIMEN, 0.0, 0.008, True, False),
        (SPECIMEN, 1e-3, 0.0, False, False),
        ("Machine: INSTRON 5900\n", 0.0, 0.0, False, True),
        ("", 0.0, 0.0, False, True),
        ("", 1e-3, 0.0, False, False),
        ("", 0.0, 0.5, False, False),
    ],
)
def test_a_specimen_states_that_a_table_begins_at_the_touch_and_what_looks_so_is_asked_for(
    tmp_path, preamble, air, offset, is_touched, is_asked
):
    path = tmp_path / "press.csv"
    path.write_text(preamble + NEWTONS + machine_rows(air, offset))
    source = open_source(path, check({}))
    assert (source.parameters.core.contact_point is not None) is is_touched
    assert source.parameters.core.contact.measure_bias is not is_touched
    assert ("give --from-touch" in " ".join(source.warnings)) is is_asked
    # An option outdoes it, and a configured origin is left alone.
    for from_touch in (False, True):
        stated = open_source(path, check({}), Selection(from_touch=from_touch))
        assert (stated.parameters.core.contact_point is not None) is from_touch
        assert "--from-touch" not in " ".join(stated.warnings)
    parameters = check({"origin.source": "given", "origin.displacement": 1e-3})
    parameters = parameters.changed({"geometry.area": 1e-3, "geometry.thickness": 0.03})
    assert open_source(path, parameters).parameters == parameters


@pytest.mark.parametrize(
    ("preamble", "area", "thickness"),
    [
        ("Cylinder Diameter: 50mm;\nCylinder Height: 30mm;\n", 1.963495e-3, 0.03),
        ('"Specimen diameter","50,0","mm"\n"Specimen thickness","0.03","m"\n', 1.963495e-3, 0.03),
        ("Specimen diameter (mm): 80\nIndenter diameter (mm): 10\nThickness (mm): 20\n",
         7.853982e-5, 0.02),
        ("Fläche: 400 mm²\nProbendicke: 12,5 mm\n", 4e-4, 0.0125),
        ("Load cell: 1kN\nDiameter: 50\nSpeed (mm/min): 10\n", 0.0, 0.0),
    ],
)  # fmt: skip
def test_the_specimen_is_taken_from_the_preamble(tmp_path, preamble, area, thickness):
    path = tmp_path / "press.csv"
    path.write_text(preamble + NEWTONS + machine_rows(), encoding="utf-8")
    geometry = open_source(path, check({})).parameters.geometry
    assert (geometry.area, geometry.thickness) == pytest.approx((area, thickness), rel=1e-5)
    stated = {"geometry.area": 1e-4, "geometry.thickness": 0.01}
    geometry = open_source(path, check(stated)).parameters.geometry
    assert (geometry.area, geometry.thickness) == (1e-4, 0.01)


def test_options_say_what_a_testing_machine_has_recorded(tmp_path, capsys):
    path = tmp_path / "presses.csv"
    rows = machine_rows(steps=300)
    path.write_text(
        "Test," + NEWTONS + "".join(f"{name},{row}\n" for name in "ab" for row in rows.split())
    )
    sizes = ("--diameter", "50mm", "--height", "0.03")
    found = answer(capsys, "replay", path, "--from-touch", *sizes, "--rows", "Test=b")
    assert found["samples"] == 300
    assert found["inputs"]["force"] == "column Load (N)"
    assert "force.measure_bias false" in " ".join(found["set_by_recording"])
    (contact,) = found["contacts"]
    assert not {"touch_not_observed", "geometry_unstated"} & set(contact["flags"])
    assert contact["g"] is not None
    same = answer(
        capsys, "replay", path, "--from-touch", "--area", "1963.4954mm2", "--thickness", "3cm",
        "--rows", "Test=b",
    )  # fmt: skip
    assert same["contacts"][0]["g"] == pytest.approx(contact["g"], rel=1e-6)


@pytest.mark.parametrize(("slope", "curve"), [(400.0, 0.0), (6000.0, 0.0), (400.0, 60.0)])
def test_the_air_of_a_recording_without_air_does_not_drift(tmp_path, capsys, slope, curve):
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows(offset=0.1, steps=600, slope=slope, curve=curve))
    found = answer(
        capsys, "replay", path, "--no-from-touch", "--diameter", "50mm", "--height", "30mm"
    )
    assert not [line for line in found["warnings"] if "drifts in the air" in line]


@pytest.mark.parametrize(("sign", "code"), [(1.0, 0), (-1.0, 3)])
def test_a_touch_before_the_recording_leaves_the_slope_where_the_signs_are_right(
    sign, code, tmp_path, capsys
):
    rows = np.loadtxt(EXAMPLE, delimiter=",", skiprows=1)
    # From 0.1 s before the first touch to the air after it.
    rows = rows[(rows[:, 0] > 1.83) & (rows[:, 0] < 5.0)] * [1.0, sign, sign]
    path = tmp_path / "press.csv"
    np.savetxt(path, rows, delimiter=",", header="time_s,force_N,depth_mm", comments="")
    command = ["replay", path, "--config", EXAMPLE.with_name("probe.yaml"), "--no-from-touch"]
    assert main([*map(str, command), "--json"]) == code
    (contact,) = json.loads(capsys.readouterr().out)["contacts"]
    assert "touch_not_observed" in contact["flags"]
    # 43 N/m where the touch was observed.
    assert sign < 0.0 or contact["measured_slope"] == pytest.approx(43.0, abs=2.0)
