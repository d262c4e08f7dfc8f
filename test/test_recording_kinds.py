# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bags of every age and in every wrapping give the same messages, or say what is missing."""

from __future__ import annotations

import csv
import gzip
import json
import shlex
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from geometry_msgs.msg import WrenchStamped
from rosbags.convert.converter import default_message
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

from fden_ros.cli import main
from fden_ros.configure.reading import read
from fden_ros.errors import InputError
from fden_ros.nodes.player import Player
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import check, read_parameter_file
from fden_ros.recording.cdr import serialize
from fden_ros.recording.fields import decoder_of
from fden_ros.recording.reader import BagReader, RawMessage, decode
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter

GOLDEN = Path(__file__).parent.parent / "bags" / "golden"
PRESS = GOLDEN / "golden_press"
START = 1_700_000_000_000_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
    timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""

Messages = list[RawMessage]
Make = Callable[[Path, Messages], Path]


def header(time_ns: int) -> Header:
    made = Header(frame_id="probe")
    made.stamp.sec, made.stamp.nanosec = divmod(time_ns, 10**9)
    return made


def small(count: int = 120, stamp: Callable[[int], int] = lambda time_ns: time_ns) -> Messages:
    """Return messages of a force and a joint, each 10 ms apart."""
    made = []
    for k in range(count):
        time_ns = START + k * 10_000_000
        force = WrenchStamped(header=header(stamp(time_ns)))
        force.wrench.force.z = 0.1 * max(0, k - 40)
        joints = JointState(header=header(time_ns), name=["probe"], position=[1e-4 * k])
        for topic, message in (("/force", force), ("/joints", joints)):
            package = type(message).__module__.split(".")[0]
            kind = f"{package}/msg/{type(message).__name__}"
            made.append(RawMessage(topic, kind, time_ns, serialize(message)))
    return made


def ros2(
    folder: Path,
    messages: Messages,
    mode: CompressionMode = CompressionMode.NONE,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
) -> Path:
    writer = Ros2Writer(folder, version=8, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, kind, time_ns, data in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(topics[topic], time_ns, data)
    return folder


def ros1(
    path: Path, messages: Messages, packing: Ros1Writer.CompressionFormat | None = None
) -> Path:
    writer = Ros1Writer(path)
    if packing is not None:
        writer.set_compression(packing)
    with writer:
        topics = {}
        for topic, kind, time_ns, data in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(topics[topic], time_ns, ROS2.cdr_to_ros1(data, kind))
    return path


def alone(folder: Path) -> Path:
    """Return the one file of a bag, elsewhere."""
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    return Path(shutil.move(file, folder.parent / file.name))


def without_metadata(folder: Path) -> Path:
    (folder / "metadata.yaml").unlink()
    return folder


def broken_metadata(folder: Path) -> Path:
    (folder / "metadata.yaml").write_text("{")
    return folder


def foxy(path: Path, messages: Messages, left_in_log: int = 0) -> Path:
    """Write a sqlite3 file without definitions; the last messages stay in its log."""
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    database.executescript(SCHEMA)
    names = {message.topic: message.type_name for message in messages}
    numbers = {topic: number for number, topic in enumerate(names, start=1)}
    for topic, kind in names.items():
        row = (numbers[topic], topic, kind, "cdr", "")
        database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
    split = len(messages) - left_in_log
    for start, end in ((0, split), (split, len(messages))):
        rows = [(numbers[m.topic], m.log_time_ns, m.data) for m in messages[start:end]]
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows
        )
        database.commit()
        if start == 0:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    if left_in_log:
        # As the files lie after a power cut: the writer never closes these.
        folder = path.parent / "cut"
        folder.mkdir()
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", folder)
        path = folder / path.name
    database.close()
    return path


def packed(path: Path, pack: Callable[[bytes], bytes], suffix: str) -> Path:
    made = path.with_name(path.name + suffix)
    made.write_bytes(pack(path.read_bytes()))
    path.unlink()
    return made


def halves(folder: Path, messages: Messages, write: Callable[[Path, Messages], Path]) -> Path:
    folder.mkdir()
    middle = len(messages) // 2
    for number, part in enumerate((messages[:middle], messages[middle:])):
        write(folder / f"part_{number}", part)
    return folder


MCAP = StoragePlugin.MCAP
BY_FILE, BY_MESSAGE = CompressionMode.FILE, CompressionMode.MESSAGE
BZ2, LZ4 = Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4

#: A kind of bag and what makes one of messages.
KINDS: dict[str, Make] = {
    "sqlite3": lambda at, m: ros2(at / "bag", m),
    "sqlite3 file": lambda at, m: alone(ros2(at / "bag", m)),
    "sqlite3 without metadata": lambda at, m: without_metadata(ros2(at / "bag", m)),
    "sqlite3 split": lambda at, m: halves(
        at / "bag", m, lambda path, part: foxy(path.with_suffix(".db3"), part)
    ),
    "sqlite3 of Foxy": lambda at, m: foxy(at / "old.db3", m),
    "sqlite3 interrupted": lambda at, m: foxy(at / "old.db3", m, left_in_log=100),
    "sqlite3 by file": lambda at, m: ros2(at / "bag", m, BY_FILE),
    "sqlite3 by file, without metadata": lambda at, m: without_metadata(
        ros2(at / "bag", m, BY_FILE)
    ),
    "sqlite3 by file, alone": lambda at, m: alone(ros2(at / "bag", m, BY_FILE)),
    "sqlite3 by message": lambda at, m: ros2(at / "bag", m, BY_MESSAGE),
    "sqlite3 by message, alone": lambda at, m: alone(ros2(at / "bag", m, BY_MESSAGE)),
    "MCAP": lambda at, m: ros2(at / "bag", m, plugin=MCAP),
    "MCAP without metadata": lambda at, m: without_metadata(ros2(at / "bag", m, plugin=MCAP)),
    "MCAP without metadata that can be read": lambda at, m: broken_metadata(
        ros2(at / "bag", m, plugin=MCAP)
    ),
    "MCAP by file": lambda at, m: ros2(at / "bag", m, BY_FILE, MCAP),
    "MCAP by message": lambda at, m: ros2(at / "bag", m, BY_MESSAGE, MCAP),
    "MCAP by message, alone": lambda at, m: alone(ros2(at / "bag", m, BY_MESSAGE, MCAP)),
    "MCAP in lz4": lambda at, m: packed(
        alone(ros2(at / "bag", m, plugin=MCAP)), lz4.frame.compress, ".lz4"
    ),
    "ROS 1": lambda at, m: ros1(at / "old.bag", m),
    "ROS 1 in bz2": lambda at, m: ros1(at / "old.bag", m, BZ2),
    "ROS 1 in lz4": lambda at, m: ros1(at / "old.bag", m, LZ4),
    "ROS 1 by file": lambda at, m: packed(ros1(at / "old.bag", m), zstandard.compress, ".zst"),
    "ROS 1 split in a folder": lambda at, m: halves(
        at / "bag", m, lambda path, part: ros1(path.with_suffix(".bag"), part)
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_messages(kind, tmp_path):
    messages = small()
    bag = BagReader(KINDS[kind](tmp_path, messages))
    assert list(bag.messages()) == messages
    assert list(bag.messages(["/joints"])) == messages[1::2]
    assert [(t.name, t.message_count) for t in bag.topics] == [("/force", 120), ("/joints", 120)]
    assert (bag.start_ns, bag.end_ns) == (START, START + 1_190_000_000)
    warnings = " ".join(bag.warnings)
    assert ("metadata" in warnings) == ("without" in kind or "split" in kind)
    assert ("interrupted recording): used too" in warnings) == ("interrupted" in kind)
    player = Player(bag)
    assert (player.message_count, player.warnings) == (240, ())


@pytest.mark.parametrize("kind", ["sqlite3", "ROS 1", "MCAP by file", "sqlite3 by message, alone"])
def test_a_replay_of_any_kind_is_that_of_mcap_bit_for_bit(kind, tmp_path):
    parameters = read_parameter_file(PRESS / "identifier.yaml")
    messages = list(BagReader(PRESS).messages(["/force", "/displacement"]))
    other = replay(KINDS[kind](tmp_path, messages), parameters)
    assert result_object(other) == result_object(replay(PRESS, parameters))
    assert other.has_identified


def test_types_of_ros_1_that_are_others_today_are_read_by_field_but_not_played(tmp_path):
    path = tmp_path / "old.bag"
    with Ros1Writer(path) as writer:
        for topic, kind in (("/info", "sensor_msgs/msg/CameraInfo"), ("/n", "std_msgs/msg/Int32")):
            connection = writer.add_connection(topic, kind, typestore=ROS1)
            numbers = {"data": 7} if kind.endswith("Int32") else {}
            message = default_message(ROS1, kind)
            for name, value in numbers.items():
                object.__setattr__(message, name, value)
            writer.write(connection, START, ROS1.serialize_ros1(message, kind))
    bag = BagReader(path)
    info, number = bag.topics
    first, second = bag.messages()
    assert list(decoder_of(info)(first.data).D) == []
    assert decoder_of(number)(second.data).data == 7
    player = Player(bag)
    assert player.message_count == 1
    assert "/info is not played" in player.warnings[0]


# Damage


def cut(path: Path, part: float) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    return path


def unindexed(path: Path) -> Path:
    """Return a ROS 1 bag as it is while it is recorded: its header points to no index."""
    content = path.read_bytes()
    place = content.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(content[:place] + bytes(8) + content[place + 8 :])
    return path


def other_database(path: Path) -> Path:
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE results (name)")
    database.commit()
    database.close()
    return path


def packed_otherwise(folder: Path) -> Path:
    path = folder / "metadata.yaml"
    path.write_text(path.read_text().replace("zstd", "brotli"))
    return folder


#: What cannot be used, what makes it, and what the one line says.
REFUSED: dict[str, tuple[Make, str]] = {
    "sqlite3 cut off": (lambda at, m: cut(alone(ros2(at / "bag", m)), 0.1), "is damaged"),
    "sqlite3 of another program": (lambda at, m: other_database(at / "a.db3"), "is damaged"),
    "sqlite3 of a few bytes": (lambda at, m: cut(foxy(at / "a.db3", m), 1e-4), "cut off before"),
    "ROS 1 cut off": (lambda at, m: cut(ros1(at / "a.bag", m), 0.5), "is damaged"),
    "ROS 1 not closed": (lambda at, m: unindexed(ros1(at / "a.bag", m)), "rosbag reindex"),
    "messages in brotli": (
        lambda at, m: packed_otherwise(ros2(at / "bag", m, BY_MESSAGE)),
        "compressed by brotli: expected zstd",
    ),
    "nothing in zstd": (
        lambda at, m: packed(cut(foxy(at / "a.db3", m), 0.0), zstandard.compress, ".zstd"),
        "is empty: give a bag folder, or an .mcap, .db3 or .bag file",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_used_says_so_in_one_line_without_ros(kind, tmp_path):
    make, words = REFUSED[kind]
    with pytest.raises(InputError) as caught:
        BagReader(make(tmp_path, small()))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value) and "ros2 " not in str(caught.value)


@pytest.mark.parametrize("kind", ["sqlite3 file", "ROS 1", "ROS 1 in lz4"])
def test_bytes_damaged_anywhere_are_read_or_refused_in_one_line(kind, tmp_path):
    path = KINDS[kind](tmp_path, small())
    content = path.read_bytes()
    for place in range(20, len(content), len(content) // 60):
        path.write_bytes(content[:place] + b"\xa5" * 9 + content[place + 9 :])
        try:
            read = list(BagReader(path).messages())
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert len(read) <= 240


def test_a_topic_without_messages_is_named_as_such(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
        bag.add_topic("/joints", "sensor_msgs/msg/JointState")
        for message in small()[1::2]:
            bag.write("/joints", decode(message), message.log_time_ns)
    for topics, words in (
        ({}, "/force (geometry_msgs/msg/WrenchStamped, no messages)"),
        ({"force": "/force"}, "topic /force has no messages"),
    ):
        for use in (lambda s: replay(tmp_path / "bag", check({}), s), None):
            with pytest.raises(InputError) as caught:
                use(Selection(topics)) if use else read(tmp_path / "bag", Selection(topics))
            assert words in str(caught.value)
            assert "damaged" not in str(caught.value)


@pytest.mark.parametrize("name", ["/target_joints", "/joints"])
def test_a_topic_that_is_only_commanded_is_said_to_be(name, tmp_path):
    messages = [m._replace(topic=m.topic.replace("/joints", name)) for m in small()]
    result = replay(KINDS["MCAP"](tmp_path, messages), check({}))
    said = f"{name} is commanded by its name, not measured" in result.warnings
    assert (result.inputs["displacement"], said) == (name, name == "/target_joints")


# Stamps

#: Header stamps of the force by time of recording, and what is said of them.
STAMPS: dict[str, tuple[Callable[[int], int], str]] = {
    "zero": (lambda time_ns: 0, "all header stamps of /force are 0"),
    "still": (lambda time_ns: START, "all header stamps of /force are the same"),
    "since boot": (lambda time_ns: time_ns - START + 5_000_000_000, "of two clocks?"),
    "ahead": (lambda time_ns: time_ns + 3_000_000_000, "are -3 s before its times of recording"),
}


@pytest.mark.parametrize(
    ("kind", "stamps"),
    [*(("MCAP", stamps) for stamps in STAMPS), ("sqlite3", "zero"), ("ROS 1", "since boot")],
)
def test_stamps_that_cannot_be_used_are_named_and_the_times_of_recording_do(
    kind, stamps, tmp_path
):
    stamp, words = STAMPS[stamps]
    bag = KINDS[kind](tmp_path, small(stamp=stamp))
    as_they_are = replay(bag, check({}))
    assert words in as_they_are.warnings[0]
    assert "--stamps recording" in as_they_are.warnings[0]
    received = replay(bag, check({}), Selection(stamps="recording"))
    by_parameter = replay(bag, check({"synchronize.stamp_source": "receive"}))
    assert result_object(by_parameter) == result_object(received)
    whole = replay(KINDS["MCAP"](tmp_path / "whole", small()), check({}))
    assert received.samples == whole.samples > 100
    assert not any("stamps" in warning for warning in received.warnings)
    if stamps == "zero":
        with pytest.raises(InputError, match=r"are 0.*--stamps recording.*0 usable samples"):
            read(bag)
    reading = read(bag, Selection(stamps="recording"))
    assert reading.streams.force_times.size == reading.streams.motion_times.size == 120


def test_an_offset_that_all_topics_share_needs_nothing(tmp_path):
    messages = [m._replace(log_time_ns=m.log_time_ns + 10**12) for m in small()]
    result = replay(KINDS["sqlite3"](tmp_path, messages), check({}))
    assert not any("stamps" in warning for warning in result.warnings)


# Numbers in arrays


def array_bag(folder: Path, source: Path) -> Path:
    """Write a press as one array: time, a constant, force [N] and depth [m] at each force."""
    depth = 0.0
    with BagWriter(folder) as bag:
        bag.add_topic("/data_control", "std_msgs/msg/Float64MultiArray")
        for message in BagReader(source).messages(["/force", "/displacement"]):
            sample = decode(message)
            if message.topic == "/displacement":
                depth = sample.position[0]
                continue
            time = 1e-9 * message.log_time_ns
            force = sample.wrench.force.z
            array = Float64MultiArray(data=[time, 0.5, force, depth])
            bag.write("/data_control", array, message.log_time_ns)
    return folder


@pytest.mark.parametrize("options", [[], ["--force-topic", "/data_control"]])
def test_numbers_that_could_be_meant_are_listed_with_the_command_to_copy(
    options, tmp_path, capsys
):
    bag = str(array_bag(tmp_path / "bag", PRESS))
    command = ["replay", bag, "--config", str(PRESS / "identifier.yaml"), *options, "--json"]
    assert main(command) == 1
    first, *listed, proposed = capsys.readouterr().err.splitlines()
    assert "force" in first
    assert [line.split()[1] for line in listed[:-1]] == ["data[0]", "data[2]", "data[3]"]
    assert "a clock" in listed[0] and " to " in listed[1] and "1 number that" in listed[-1]
    words = shlex.split(proposed.removeprefix("try: fden "))
    assert words.count("--force-topic") == 1
    assert main(words) in (0, 3)  # the depth is that of the sample before, which shows
    result = json.loads(capsys.readouterr().out)
    assert result["inputs"] == {
        "force": "/data_control data[2]",
        "displacement": "/data_control data[3]",
    }
    assert result["samples"] > 1000


# Archives


def test_an_archive_of_all_kinds_is_done_and_what_is_empty_is_a_row(tmp_path, capsys):
    archive = tmp_path / "archive"
    messages = small()
    for number, kind in enumerate(("sqlite3", "ROS 1", "MCAP by file", "sqlite3 of Foxy")):
        (archive / str(number)).mkdir(parents=True)
        KINDS[kind](archive / str(number), messages)
    (archive / "notes").mkdir()
    (archive / "notes" / "readme.txt").write_text("what was done on that day\nand why\n")
    rows = "".join(f"{0.01 * k + 1},{0.1 * k},{0.2 * k}\n" for k in range(100))
    (archive / "press.csv").write_text("time_s,force_N,depth_mm\n" + rows)
    (archive / "packed.csv.gz").write_bytes(
        gzip.compress(("time_s,force_N,depth_mm\n" + rows).encode())
    )
    (archive / "press.txt").write_text("time_s force_N depth_mm\n" + rows.replace(",", " "))
    (tmp_path / "empty").mkdir()
    output = archive / "results.csv"
    places = [archive, tmp_path / "empty", tmp_path / "nowhere"]
    command = ["batch", *map(str, places), "-o", str(output), "--workers", "1"]
    for _ in range(2):
        assert main(command) == 0
        with output.open(newline="") as file:
            rows = list(csv.DictReader(file))
        found = {Path(row["bag"]).name: row["error"] for row in rows}
        chosen = {Path(row["bag"]).name: row["inputs"] for row in rows}
        assert chosen["old.bag"] == "force from /force, displacement from /joints"
        assert found.keys() == {
            *("bag", "old.bag", "old.db3", "press.csv", "packed.csv.gz", "press.txt"),
            *("empty", "nowhere"),
        }
        errors = {name: error for name, error in found.items() if error}
        assert errors.keys() == {"empty", "nowhere"}
        assert "holds no bag" in errors["empty"] and "does not exist" in errors["nowhere"]
    said = capsys.readouterr().err
    assert said.count("broken:") == 2
