# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.synthetic import TRUTH_TOPIC, read_truth, write_recording
from fden_ros.recording.writer import BagWriter
from fden_ros.simulation.simulate import Recording, Stream

START = 1_700_000_000_000_000_000


def stream(topic: str, message: str, count: int = 20, **options: Any) -> Stream:
    stamp_ns = START + 1_000_000 * np.arange(count, dtype=np.int64)
    value = np.linspace(0.1, 0.9, count)
    base = Stream(stamp_ns, value, None, topic, message, (0.0, 0.0, 1.0), "probe")
    return replace(base, **options)


def recording(
    force: str = "wrench", displacement: str = "joint_state", **options: Any
) -> Recording:
    truth = {
        "scenario": "test",
        "identifier_parameters": {"geometry.kind": "flat_punch", "prior.alpha": 0.131},
    }
    return Recording(
        stream("/force", force), stream("/displacement", displacement, **options), truth
    )


def messages(bag: BagReader, topic: str) -> list[Any]:
    return [decode(message) for message in bag.messages([topic])]


def test_force_and_displacement_read_back_exactly(tmp_path: Path) -> None:
    made = recording()
    bag = write_recording(made, tmp_path / "bag")
    force = messages(bag, "/force")
    joints = messages(bag, "/displacement")
    assert [message.wrench.force.z for message in force] == made.force.value.tolist()
    assert [message.position[0] for message in joints] == made.displacement.value.tolist()
    assert joints[0].name == ["probe"]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in force]
    assert stamps == made.force.stamp_ns.tolist()
    assert [m.log_time_ns for m in bag.messages(["/force"])] == stamps


def test_force_lies_along_its_axis(tmp_path: Path) -> None:
    made = recording()
    made = replace(made, force=replace(made.force, axis=(0.0, -1.0, 0.0)))
    force = messages(write_recording(made, tmp_path / "bag"), "/force")
    assert [-message.wrench.force.y for message in force] == made.force.value.tolist()
    assert {message.wrench.force.z for message in force} == {0.0}


def test_force_may_be_an_effort(tmp_path: Path) -> None:
    made = recording(force="joint_state")
    force = messages(write_recording(made, tmp_path / "bag"), "/force")
    assert [message.effort[0] for message in force] == made.force.value.tolist()


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("pose", "pose.position"),
        ("transform", "transform.translation"),
        ("point", "point"),
    ],
)
def test_positions_read_back_exactly(tmp_path: Path, kind: str, path: str) -> None:
    position = np.random.default_rng(1).normal(size=(20, 3))
    bag = write_recording(recording(displacement=kind, position=position), tmp_path / "bag")
    read = []
    for message in messages(bag, "/displacement"):
        for name in path.split("."):
            message = getattr(message, name)
        read.append([message.x, message.y, message.z])
    assert read == position.tolist()


def test_positions_that_are_missing_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no positions"):
        write_recording(recording(displacement="pose"), tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_truth_comes_first_and_latched(tmp_path: Path) -> None:
    made = recording()
    bag = write_recording(made, tmp_path / "bag")
    assert next(iter(bag.messages())).topic == TRUTH_TOPIC
    assert bag.topic(TRUTH_TOPIC).offered_qos[0].latched
    assert read_truth(bag) == made.truth


def test_a_bag_without_truth_has_none(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
    assert read_truth(BagReader(tmp_path / "bag")) is None


def test_parameters_lie_beside_the_bag(tmp_path: Path) -> None:
    write_recording(recording(), tmp_path / "bag")
    text = (tmp_path / "bag" / "identifier.yaml").read_text()
    assert yaml.safe_load(text) == {
        "/**": {"ros__parameters": {"geometry": {"kind": "flat_punch"}, "prior": {"alpha": 0.131}}}
    }
    assert "# Force topic: /force" in text


def test_bag_command_makes_the_same_bag_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "ramp"
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3"]) == 0
    assert "fden replay" in capsys.readouterr().out
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(first) == ["identifier.yaml", "metadata.yaml", "ramp_0.mcap"]
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3"]) == 1
    assert "--force" in capsys.readouterr().err
    assert main(["bag", "ramp", "-o", str(folder), "--seed", "3", "--force"]) == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first
    truth = read_truth(BagReader(folder))
    assert truth is not None
    assert truth["seed"] == 3


def test_bag_command_lists_scenarios(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "--list"]) == 0
    assert "ramp" in capsys.readouterr().out


def test_bag_command_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bag", "no_such_scenario", "-o", str(tmp_path / "x")]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(SystemExit) as caught:
        main(["bag", "ramp"])
    assert caught.value.code == 2
