# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Robots by name: their topics and conventions, on bags in each layout by another library."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from test_configure import run, whole_rig
from unknown_rig_bags import RigBag
from unknown_rigs import SimulatedRig

from fden_ros.configure.robots import robot_named, robot_names
from fden_ros.nodes.running import written_remaps
from fden_ros.parameters import read_parameter_file
from fden_ros.parameters.files import live_topics

#: Robot: topics, kind of the displacement, the sign of what its sensor shows (1: what acts on the
#: tool), and whether its driver takes the tool's weight off.
LAYOUTS: dict[str, tuple[str, str, str, float, bool]] = {
    "crtk": ("/PSM1/body/measured_cf", "/PSM1/measured_cp", "pose", 1.0, False),
    "ur": (
        "/force_torque_sensor_broadcaster/wrench",
        "/tcp_pose_broadcaster/pose",
        "pose",
        1.0,
        True,
    ),
    "franka": (
        "/NS_1/franka_robot_state_broadcaster/external_wrench_in_stiffness_frame",
        "/NS_1/franka_robot_state_broadcaster/current_pose",
        "pose",
        -1.0,
        True,
    ),
    "kuka_iiwa": (
        "/lbr/force_torque_broadcaster/wrench",
        "/lbr/pose_broadcaster/pose",
        "pose",
        -1.0,
        True,
    ),
    "xarm": ("/xarm/uf_ftsensor_ext_states", "/xarm/robot_states", "xarm", 1.0, True),
    "ros2_control": ("/fts_broadcaster/wrench", "/tool_broadcaster/pose", "pose", 1.0, False),
}


def rig_of(sign: float, compensated: bool, **chosen: Any) -> SimulatedRig:
    mass = 0.0 if compensated else 0.4
    return whole_rig(
        rigid=False,
        sensor_sign=sign,
        mass=mass,
        force_rate=120.0,
        displacement_rate=100.0,
        **chosen,
    )


def configured(capsys: pytest.CaptureFixture[str], *arguments: Any) -> dict[str, Any]:
    assert run("configure", *arguments, "--json") == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


def test_every_robot_has_a_layout_here_and_names_its_sources():
    assert set(robot_names()) == set(LAYOUTS)
    for name in robot_names():
        robot = robot_named(name)
        assert robot.sources
        assert robot.force.convention
        assert robot.displacement.convention


@pytest.mark.parametrize("name", LAYOUTS)
def test_topics_signs_and_weight_are_found_in_the_layout_of(name, tmp_path, capsys):
    force, displacement, kind, sign, compensated = LAYOUTS[name]
    rig = rig_of(sign, compensated)
    bag = RigBag(rig.streams, force, displacement, kind).write(tmp_path / "bag")
    answer = configured(capsys, bag, "--robot", name)
    assert answer["inputs"][0]["force"] == force
    assert answer["inputs"][0]["displacement"].startswith(displacement)
    axis = answer["parameters"]["force.axis"]
    assert np.allclose(axis, [0.0, 0.0, -sign], atol=0.02)
    convention = robot_named(name).force.axis
    if convention is not None:
        assert np.allclose(axis, convention, atol=0.02)
    found = {finding["subject"]: finding for finding in answer["findings"]}
    if kind == "xarm":
        assert found["displacement unit"]["value"] == "mm"
        return
    assert np.allclose(
        answer["parameters"]["displacement.axis"], rig.truth.displacement_axis, atol=0.02
    )
    mass = found["tool mass"]
    assert mass["value"] == pytest.approx(rig.truth.mass, rel=0.02, abs=1e-3)


def test_a_sign_against_the_convention_is_told_and_the_recording_wins(tmp_path, capsys):
    force, displacement, kind, sign, compensated = LAYOUTS["ur"]
    rig = rig_of(-sign, compensated)
    bag = RigBag(rig.streams, force, displacement, kind).write(tmp_path / "bag")
    output = tmp_path / "probe.yaml"
    assert run("configure", bag, "--robot", "ur", "-o", output) == 0
    assert "OPPOSITE" in capsys.readouterr().out
    assert read_parameter_file(output).force.axis[2] > 0.9


def test_an_older_crtk_device_has_transforms_and_its_invalid_poses_are_left_out(tmp_path, capsys):
    rig = rig_of(1.0, False)
    layout = RigBag(rig.streams, "/PSM1/body/measured_cf", "/PSM1/measured_cp", "transform")
    bag = layout.write(tmp_path / "bag", invalid=40)
    assert run("configure", bag, "--robot", "crtk", "-o", tmp_path / "probe.yaml") == 0
    assert "40 messages without stamp or value" in capsys.readouterr().out
    assert read_parameter_file(tmp_path / "probe.yaml").displacement.message == "transform"


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_file_from_conventions_alone_can_be_read(name, tmp_path):
    path = tmp_path / "probe.yaml"
    assert run("configure", "--robot", name, "-o", path) == 0
    parameters = read_parameter_file(path)
    axis = robot_named(name).force.axis
    assert list(parameters.force.axis) == (axis or [0.0, 0.0, 1.0])
    assert "# source: " in path.read_text(encoding="utf-8")


def test_the_topics_of_a_file_are_those_of_the_node_unless_it_is_told_others(tmp_path):
    path = tmp_path / "probe.yaml"
    assert run("configure", "--robot", "ur", "-o", path) == 0
    topics = ["/force_torque_sensor_broadcaster/wrench", "/tcp_pose_broadcaster/pose"]
    assert list(live_topics(path).values()) == topics
    given = ["identifier", "--ros-args", "--params-file", str(path)]
    remap = f"displacement:={topics[1]}"
    assert written_remaps(given) == ["--ros-args", "-r", f"force:={topics[0]}", "-r", remap]
    assert written_remaps([*given, "-r", "force:=/ft"]) == ["--ros-args", "-r", remap]
    assert written_remaps(["identifier"]) == []
