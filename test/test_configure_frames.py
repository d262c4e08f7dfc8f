# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""`fden configure` where the probe's motion stands in transforms alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from fault_helpers import shift
from frame_helpers import Place, arm, place, write_bag
from scipy.spatial.transform import Rotation

from fden_ros.cli import main
from fden_ros.configure.transforms import FrameTree
from fden_ros.parameters import read_parameter_file

INDENTER = ["--flat-punch", "3.14e-4", "--thickness", "0.02"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("arm") / "bag", arm(shift()))


def test_frames_are_found_and_the_file_replays(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "probe.yaml"
    assert main(["configure", str(bag), "-o", str(output), *INDENTER]) == 0
    assert "displacement from tip in base" in capsys.readouterr().out
    found = read_parameter_file(output)
    assert (found.frames.base, found.frames.probe) == ("base", "tip")
    assert found.displacement.message == "tf"
    for axis in (found.force.axis, found.displacement.axis):
        assert np.allclose(axis, [0.0, 0.0, 1.0], atol=0.05)
    main(["replay", str(bag), "--config", str(output), "--json"])
    assert json.loads(capsys.readouterr().out)["contacts"]


def test_frames_that_are_not_clear_are_asked_for_with_the_list(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["configure", str(bag), "--frames", "base,tool"]) == 1
    assert "of base, camera, flange, link, sensor, tip" in capsys.readouterr().err
    second = place(1, "sensor", "knife", np.zeros(3), Rotation.identity(), static=True)
    samples = [*arm(shift()), second]
    assert isinstance(second, Place)
    assert main(["configure", str(write_bag(tmp_path / "two", samples))]) == 1
    assert "--frames BASE,PROBE, of base, camera, flange, knife" in capsys.readouterr().err


def test_a_way_is_composed_along_the_tree() -> None:
    from geometry_msgs.msg import TransformStamped
    from tf2_msgs.msg import TFMessage

    tree = FrameTree("here")
    turn = Rotation.from_euler("z", 90.0, degrees=True).as_quat()
    for parent, child, second in (("a", "b", 0), ("a", "b", 2), ("b", "c", 1)):
        one = TransformStamped(child_frame_id=child)
        one.header.frame_id, one.header.stamp.sec = parent, second
        one.transform.translation.x = float(second)
        rotation = one.transform.rotation
        rotation.x, rotation.y, rotation.z, rotation.w = (float(part) for part in turn)
        tree.add(TFMessage(transforms=[one]))
    path = tree.path("a", "c", np.array([1_000_000_000], dtype=np.int64))
    assert np.allclose(path.places, [[1.0, 1.0, 0.0]])
    assert np.allclose(path.turns.as_euler("zyx", degrees=True), [[180.0, 0.0, 0.0]])
