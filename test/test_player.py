# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Playing a bag on live topics: every message, at its pace, under the names asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import WrenchStamped
from live_helpers import Ears
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.nodes import player as player_module
from fden_ros.nodes.player import Player
from fden_ros.recording.qos import LATCHED, RELIABLE, Qos
from fden_ros.recording.reader import BagReader
from fden_ros.recording.writer import BagWriter

START = 1_700_000_000_000_000_000
DEEP = QoSProfile(depth=10_000)


def make_bag(
    folder: Path, count: int = 200, step_ns: int = 1_000_000, qos: Qos = RELIABLE
) -> Path:
    with BagWriter(folder) as bag:
        bag.add_topic("/truth", "std_msgs/msg/String", LATCHED)
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped", qos)
        bag.add_topic("/joints", "sensor_msgs/msg/JointState", qos)
        bag.write("/truth", String(data="{}"), START)
        for i in range(count):
            stamp_ns = START + i * step_ns
            force = WrenchStamped(header=Header(frame_id="probe"))
            force.wrench.force.z = float(i)
            bag.write("/force", force, stamp_ns)
            bag.write("/joints", JointState(name=["probe"], position=[i * 1e-4]), stamp_ns)
    return folder


class Listener(Ears):
    """What came on topics."""

    node_name = "listener"

    def listen(
        self, topic: str, cls: type, profile: QoSProfile = DEEP, *, raw: bool = True
    ) -> list[Any]:
        received: list[Any] = []
        self.node.create_subscription(cls, topic, received.append, profile, raw=raw)
        return received


@pytest.fixture
def listener() -> Iterator[Listener]:
    with Listener() as listener:
        yield listener


def recorded(bag: Path, topic: str) -> list[bytes]:
    return [message.data for message in BagReader(bag).messages([topic])]


def play(listener: Listener, bag: Path, times: int = 1, **options: Any) -> list[int]:
    """Play while the listener listens; return how much was sent each time."""
    with Player(bag, **options) as player, ThreadPoolExecutor() as pool:

        def run() -> list[int]:
            player.wait_for_subscribers()
            return [player.play() for _ in range(times)]

        sent = pool.submit(run)
        listener.wait_for(sent.done, "the end of the bag")
        assert player.warnings == ()
        return sent.result()


@pytest.mark.parametrize("rate", [1.0, math.inf])
def test_reliable_subscriber_receives_every_message_bit_for_bit_in_order(tmp_path, listener, rate):
    bag = make_bag(tmp_path / "bag", 1000)
    heard = {
        "/force": listener.listen("/force", WrenchStamped),
        "/joints": listener.listen("/joints", JointState),
    }
    assert play(listener, bag, rate=rate) == [2001]
    listener.wait_for(lambda: all(len(r) == 1000 for r in heard.values()), "every message")
    for topic, received in heard.items():
        # DDS may pad a message to a multiple of 4 bytes.
        expected = recorded(bag, topic)
        assert [data[: len(e)] for data, e in zip(received, expected, strict=True)] == (expected)


def test_the_pace_is_that_of_the_bag_times_the_rate(tmp_path, monkeypatch):
    """By a clock that stands still: for what it waits, not for how long a machine takes."""
    bag = make_bag(tmp_path / "bag", 20, step_ns=100_000_000)
    waits: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: 0.0, sleep=waits.append)
    monkeypatch.setattr(player_module, "time", clock)
    with Player(bag, rate=2.0) as player:
        assert player.play() == 41
    assert waits == pytest.approx([0.05 * n for n in range(1, 20) for _ in range(2)])


def test_latched_topic_reaches_a_late_subscriber(tmp_path, listener):
    latched = QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    with Player(make_bag(tmp_path / "bag", 3)) as player:
        player.play()
        heard = listener.listen("/truth", String, latched, raw=False)
        listener.wait_for(lambda: heard, "the latched message")
    assert heard[0] == String(data="{}")


def test_waiting_in_vain_ends_with_one_line(tmp_path):
    with Player(make_bag(tmp_path / "bag", 3)) as player, pytest.raises(InputError) as caught:
        player.wait_for_subscribers(timeout_s=0.2)
    assert str(caught.value).startswith("/force, /joints: no subscriber after 0.2 s")


def test_play_command_refuses_what_it_cannot_use(tmp_path):
    bag = str(make_bag(tmp_path / "bag", 3))
    assert main(["play", str(tmp_path / "nowhere")]) == 1
    assert main(["play", bag, "--remap", "/torque:=/a"]) == 1
    for wrong in (["--rate", "0"], ["--remap", "/a"]):
        with pytest.raises(SystemExit) as caught:
            main(["play", bag, *wrong])
        assert caught.value.code == 2
