# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.nodes.player import Player
from fden_ros.recording.qos import LATCHED, RELIABLE, SENSOR_DATA, Qos
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


class Listener:
    """Subscribers in a context of their own, spun by a thread."""

    def __init__(self) -> None:
        self.received: dict[str, list[Any]] = {}
        self.arrivals: dict[str, list[float]] = {}
        self._changed = threading.Condition()
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)

    def listen(
        self, topic: str, cls: type, profile: QoSProfile = DEEP, *, raw: bool = True
    ) -> None:
        self.received[topic] = []
        self.arrivals[topic] = []

        def take(message: Any) -> None:
            with self._changed:
                self.received[topic].append(message)
                self.arrivals[topic].append(time.monotonic())
                self._changed.notify_all()

        self.node.create_subscription(cls, topic, take, profile, raw=raw)

    def start(self) -> None:
        self._thread.start()

    def wait_for(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> bool:
        with self._changed:
            return self._changed.wait_for(condition, timeout_s)

    def close(self) -> None:
        self._executor.shutdown()
        if self._thread.is_alive():
            self._thread.join()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def listener() -> Iterator[Listener]:
    listener = Listener()
    yield listener
    listener.close()


@contextmanager
def playing(bag: Path | BagReader, **options: Any) -> Iterator[Player]:
    with Player(bag, **options) as player:
        player.wait_for_subscribers()
        yield player


def recorded(bag: Path, topic: str) -> list[bytes]:
    return [message.data for message in BagReader(bag).messages([topic])]


@pytest.mark.parametrize("rate", [1.0, math.inf])
def test_reliable_subscriber_receives_every_message_bit_for_bit_in_order(
    tmp_path: Path, listener: Listener, rate: float
) -> None:
    bag = make_bag(tmp_path / "bag", 1000)
    listener.listen("/force", WrenchStamped)
    listener.listen("/joints", JointState)
    listener.start()
    with playing(bag, rate=rate) as player:
        assert player.play() == 2001
        assert player.warnings == ()
        assert listener.wait_for(lambda: all(len(r) == 1000 for r in listener.received.values()))
    for topic, received in listener.received.items():
        # DDS may pad a message to a multiple of 4 bytes.
        expected = recorded(bag, topic)
        assert [data[: len(e)] for data, e in zip(received, expected, strict=True)] == expected


def test_messages_keep_the_pace_of_the_recording(tmp_path: Path, listener: Listener) -> None:
    bag = make_bag(tmp_path / "bag", 20, step_ns=100_000_000)
    listener.listen("/force", WrenchStamped)
    listener.listen("/joints", JointState)
    listener.start()
    with playing(bag, rate=2.0) as player:
        player.play()
        assert listener.wait_for(lambda: len(listener.received["/force"]) == 20)
    arrivals = listener.arrivals["/force"]
    assert arrivals[-1] - arrivals[0] == pytest.approx(0.95, abs=0.2)


def test_latched_topic_reaches_a_late_subscriber(tmp_path: Path, listener: Listener) -> None:
    latched = QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    with Player(make_bag(tmp_path / "bag", 3)) as player:
        player.play()
        listener.listen("/truth", String, latched, raw=False)
        listener.start()
        assert listener.wait_for(lambda: listener.received["/truth"] == [String(data="{}")])


def test_best_effort_stays_best_effort(tmp_path: Path, listener: Listener) -> None:
    bag = make_bag(tmp_path / "bag", 3, qos=SENSOR_DATA)
    listener.listen("/force", WrenchStamped)
    listener.listen("/joints", JointState)
    listener.start()
    with Player(bag) as player, pytest.raises(InputError) as caught:
        player.wait_for_subscribers(timeout_s=3.0)
    line = str(caught.value)
    assert "listener asks /force for reliable" in line
    assert "\n" not in line


def test_topics_are_selected_and_renamed(tmp_path: Path, listener: Listener) -> None:
    bag = make_bag(tmp_path / "bag", 10)
    listener.listen("/ft/wrench", WrenchStamped)
    listener.start()
    with playing(bag, topics=["/force"], remap={"/force": "/ft/wrench"}) as player:
        assert player.input_topics == ("/ft/wrench",)
        assert player.play() == 10
        assert listener.wait_for(lambda: len(listener.received["/ft/wrench"]) == 10)


def test_clock_runs_with_the_bag(tmp_path: Path, listener: Listener) -> None:
    bag = make_bag(tmp_path / "bag", 100, step_ns=10_000_000)
    for topic, cls in (("/force", WrenchStamped), ("/joints", JointState)):
        listener.listen(topic, cls)
    listener.listen("/clock", Clock, raw=False)
    listener.start()
    with playing(bag, rate=4.0, clock_hz=40.0) as player:
        time_limit = time.monotonic() + 20.0
        while player.clock_subscribers == 0 and time.monotonic() < time_limit:
            time.sleep(0.01)
        player.play()
        assert listener.wait_for(lambda: len(listener.received["/clock"]) >= 10)
    stamps = [c.clock.sec * 10**9 + c.clock.nanosec - START for c in listener.received["/clock"]]
    assert stamps == [100_000_000 * i for i in range(len(stamps))]


def test_playing_again_repeats_the_stamps(tmp_path: Path, listener: Listener) -> None:
    bag = make_bag(tmp_path / "bag", 10)
    listener.listen("/force", WrenchStamped)
    listener.listen("/joints", JointState)
    listener.start()
    with playing(bag) as player:
        assert player.play() == player.play() == 21
        assert listener.wait_for(lambda: len(listener.received["/force"]) == 20)
    received = listener.received["/force"]
    assert received[:10] == received[10:]


def test_stop_ends_playing_at_once(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 100, step_ns=1_000_000_000)
    with Player(bag) as player:
        threading.Timer(0.3, player.stop).start()
        began = time.monotonic()
        assert player.play() < 10
        assert time.monotonic() - began < 5.0


def test_waiting_in_vain_ends_with_one_line_and_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "bag", 3)
    assert main(["play", str(bag), "--timeout", "0.2"]) == 1
    *_, line = capsys.readouterr().err.splitlines()
    assert line.startswith("fden play: /force, /joints: fewer than 1 subscribers")


def test_who_waits_is_told_which_topic_still_lacks_a_subscriber(
    tmp_path: Path, listener: Listener
) -> None:
    bag = make_bag(tmp_path / "bag", 3)
    told: list[str] = []
    listener.listen("/force", WrenchStamped)
    listener.start()
    with Player(bag) as player, pytest.raises(InputError, match="/joints"):
        player.wait_for_subscribers(timeout_s=5.0, on_wait=told.append)
    assert told[-1] == "/joints"


def test_play_command_plays_without_waiting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "bag", 3)
    assert main(["play", str(bag), "--no-wait", "--delay", "0", "--rate", "inf"]) == 0
    assert "sent 7 messages" in capsys.readouterr().err


def test_play_command_refuses_what_it_cannot_use(tmp_path: Path) -> None:
    bag = str(make_bag(tmp_path / "bag", 3))
    assert main(["play", str(tmp_path / "nowhere")]) == 1
    assert main(["play", bag, "--topics", "/torque"]) == 1
    for wrong in (["--rate", "0"], ["--remap", "/a"], ["--wait-for", "x"], ["--clock", "-1"]):
        with pytest.raises(SystemExit) as caught:
            main(["play", bag, *wrong])
        assert caught.value.code == 2
