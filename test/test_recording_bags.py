# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Bags: written, read by others, read from others, damaged; and files of other kinds."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import yaml
from geometry_msgs.msg import WrenchStamped
from live_helpers import Ears
from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.nodes import player
from fden_ros.recording.message_types import known_types, serialize, type_hash
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.reader import BagReader, decode, read_truth
from fden_ros.recording.writer import BagWriter

START = 1_700_000_000_000_000_000
WRENCH = "geometry_msgs/msg/WrenchStamped"
JOINTS = "sensor_msgs/msg/JointState"


def wrench(force: float, stamp_ns: int = START) -> WrenchStamped:
    message = WrenchStamped(header=Header(frame_id="probe"))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.wrench.force.z = float(force)
    return message


def write_bag(folder: Path, count: int = 50, step_ns: int = 1, **options: Any) -> Path:
    with BagWriter(folder, **options) as bag:
        bag.add_topic("/truth", "std_msgs/msg/String", LATCHED)
        bag.add_topic("/force", WRENCH)
        bag.add_topic("/joints", JOINTS)
        bag.write("/truth", String(data="{}"), START)
        for i in range(count):
            time_ns = START + i * step_ns
            bag.write("/force", wrench(i, time_ns), time_ns)
            bag.write("/joints", JointState(name=["probe"], position=[i * 1e-3]), time_ns)
    return folder


def write_mcap(path: Path, stamps: Sequence[int], **options: Any) -> list[bytes]:
    """Write wrenches, numbered in the order of the file, with the options of the mcap package."""
    payloads = [serialize(wrench(i)) for i in range(len(stamps))]
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2")
        text, _ = known_types(WRENCH).generate_msgdef(WRENCH, ros_version=2)
        schema = writer.register_schema(WRENCH, "ros2msg", text.encode())
        channel = writer.register_channel("/force", "cdr", schema)
        for stamp, payload in zip(stamps, payloads, strict=True):
            writer.add_message(channel, stamp, payload, stamp)
        writer.finish()
    return payloads


def data_of(path: Path) -> list[bytes]:
    return [message.data for message in BagReader(path).messages()]


def test_a_bag_reads_back_as_written(tmp_path):
    bag = BagReader(write_bag(tmp_path / "bag"))
    messages = list(bag.messages())
    assert [message.topic for message in messages] == ["/truth", *["/force", "/joints"] * 50]
    assert [message.log_time_ns - START for message in messages[1::2]] == list(range(50))
    assert serialize(decode(messages[99])) == serialize(wrench(49, START + 49))
    assert (bag.message_count, bag.start_ns, bag.end_ns) == (101, START, START + 49)
    assert bag.warnings == ()
    force, joints, truth = bag.topics
    assert (force.name, force.type_name, force.message_count) == ("/force", WRENCH, 50)
    assert (truth.offered_qos, joints.offered_qos) == ((LATCHED,), (RELIABLE,))
    assert (force.encoding, force.type_hash) == ("ros2msg", type_hash(WRENCH))
    assert {message.topic for message in bag.messages(["/joints"])} == {"/joints"}
    with pytest.raises(InputError, match="has no topic /torque: it has /force, /joints, /truth"):
        bag.messages(["/torque"])
    assert data_of(tmp_path / "bag" / "bag.mcap") == data_of(tmp_path / "bag")


def test_only_a_bag_is_replaced_and_only_when_asked(tmp_path):
    folder = write_bag(tmp_path / "bag")
    with pytest.raises(InputError, match=r"exists.*--force"):
        write_bag(folder)
    write_bag(folder, count=3, overwrite=True)
    assert BagReader(folder).message_count == 7
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years")
    with pytest.raises(InputError, match="not a bag"):
        write_bag(tmp_path / "thesis", overwrite=True)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "years"


def test_split_bag_is_one_stream_by_time(tmp_path):
    first = write_mcap(tmp_path / "bag_2.mcap", range(0, 100, 2))
    second = write_mcap(tmp_path / "bag_10.mcap", range(1, 101, 2))
    metadata = {"relative_file_paths": ["bag_2.mcap", "bag_10.mcap"]}
    (tmp_path / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": metadata})
    )
    assert data_of(tmp_path) == [p for pair in zip(first, second, strict=True) for p in pair]
    assert BagReader(tmp_path).topics[0].message_count == 100
    (tmp_path / "bag_10.mcap").unlink()
    assert data_of(tmp_path) == first
    warning, *_ = BagReader(tmp_path).warnings
    assert "bag_10.mcap is listed in metadata.yaml but missing" in warning


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_a_file_cut_off_anywhere_gives_what_stands_before_the_cut(tmp_path, compression):
    whole = tmp_path / "whole.mcap"
    payloads = write_mcap(whole, range(200), compression=compression, chunk_size=3000)
    content = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in (*range(1, 60), *range(60, len(content), 397)):
        cut.write_bytes(content[:size])
        try:
            bag = BagReader(cut)
        except InputError as error:
            # Before the first topic there is nothing to use.
            assert f"cut off before its first topic, at {size} bytes" in str(error)
            assert not counts
            continue
        read = [message.data for message in bag.messages()]
        assert read == payloads[: len(read)]
        assert len(read) == bag.message_count
        assert f"cut off or damaged: the {len(read)} messages before that" in bag.warnings[0]
        counts.append(len(read))
    assert counts == sorted(counts)
    assert counts[-1] == 200


def test_what_follows_damage_is_lost_and_said(tmp_path):
    path = tmp_path / "bag.mcap"
    payloads = write_mcap(path, range(200), compression=CompressionType.NONE, chunk_size=5000)
    content = bytearray(path.read_bytes())
    position = content.index(payloads[100])
    content[position + 20] ^= 0xFF
    path.write_bytes(content)
    bag = BagReader(path)
    read = [message.data for message in bag.messages()]
    assert 50 < len(read) <= 100
    assert read == payloads[: len(read)]
    assert "the rest of it is lost (crc validation failed" in bag.warnings[0]


def test_bag_command_makes_the_same_bag_twice(tmp_path, capsys):
    folder = tmp_path / "ramp"
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3"]) == 0
    assert "fden replay" in capsys.readouterr().out
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(first) == ["identifier.yaml", "metadata.yaml", "ramp.mcap"]
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3"]) == 1
    assert "--force" in capsys.readouterr().err
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3", "--force"]) == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first
    truth = read_truth(BagReader(folder))
    assert truth is not None
    assert truth["seed"] == 3


# A bag on live topics: every message, at its pace, under the names that are given


def test_a_subscriber_receives_every_message_bit_for_bit_in_order(tmp_path):
    bag = BagReader(write_bag(tmp_path / "bag", 1000, 1_000_000))
    deep = QoSProfile(depth=10_000)
    with Ears() as ears, ThreadPoolExecutor() as pool:
        heard: dict[str, list[bytes]] = {"/tool/force": [], "/joints": []}
        kinds = (WrenchStamped, JointState)
        for (topic, received), kind in zip(heard.items(), kinds, strict=True):
            ears.node.create_subscription(kind, topic, received.append, deep, raw=True)
        sent = pool.submit(player.play, bag, remap={"force": "/tool/force"})
        ears.wait_for(lambda: sent.done() and all(len(r) == 1000 for r in heard.values()), "all")
    assert sent.result() == 2001
    for topic, received in zip(("/force", "/joints"), heard.values(), strict=True):
        # DDS may pad a message to a multiple of 4 bytes.
        expected = [message.data for message in bag.messages([topic])]
        assert [d[: len(e)] for d, e in zip(received, expected, strict=True)] == expected


def test_what_nobody_hears_and_what_cannot_be_used_are_refused_in_one_line(tmp_path):
    bag = BagReader(write_bag(tmp_path / "bag", 3))
    with pytest.raises(InputError, match=r"^/force, /joints: no subscriber after 0\.1 s$"):
        player.play(bag, wait=0.1)
    assert main(["play", str(tmp_path / "nowhere")]) == 1
    assert main(["play", str(bag.path), "--remap", "/torque:=/a"]) == 1
    for wrong in (["--rate", "0"], ["--remap", "/a"]):
        with pytest.raises(SystemExit, match="2"):
            main(["play", str(bag.path), *wrong])
