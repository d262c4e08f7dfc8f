# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fden_ros.cli import main
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.truth import read_truth
from simulation.bag import write_recording
from simulation.simulate import Recording, Stream

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
