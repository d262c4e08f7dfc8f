# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Playing a bag on live topics: every message, at its pace, under the names that are given."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from geometry_msgs.msg import WrenchStamped
from live_helpers import Ears
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.nodes import player
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.reader import BagReader
from fden_ros.recording.writer import BagWriter

START, STEP_NS = 1_700_000_000_000_000_000, 100_000_000


def make_bag(folder: Path, count: int, step_ns: int = STEP_NS) -> BagReader:
    with BagWriter(folder) as bag:
        bag.add_topic("/truth", "std_msgs/msg/String", LATCHED)
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped", RELIABLE)
        bag.add_topic("/joints", "sensor_msgs/msg/JointState", RELIABLE)
        bag.write("/truth", String(data="{}"), START)
        for i in range(count):
            force = WrenchStamped(header=Header(frame_id="probe"))
            force.wrench.force.z = float(i)
            bag.write("/force", force, START + i * step_ns)
            bag.write("/joints", JointState(name=["probe"]), START + i * step_ns)
    return BagReader(folder)


def test_a_subscriber_receives_every_message_bit_for_bit_in_order(tmp_path):
    bag = make_bag(tmp_path / "bag", 1000, step_ns=1_000_000)
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
    bag = make_bag(tmp_path / "bag", 3)
    with pytest.raises(InputError, match=r"^/force, /joints: no subscriber after 0\.1 s$"):
        player.play(bag, wait=0.1)
    assert main(["play", str(tmp_path / "nowhere")]) == 1
    assert main(["play", str(bag.path), "--remap", "/torque:=/a"]) == 1
    for wrong in (["--rate", "0"], ["--remap", "/a"]):
        with pytest.raises(SystemExit, match="2"):
            main(["play", str(bag.path), *wrong])
