# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from std_msgs.msg import String

from fden_ros.cli import main
from fden_ros.recording.writer import BagWriter

GOLDEN = Path(__file__).parent.parent / "bags" / "golden"
START = 1_700_000_000_000_000_000


def info(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict[str, Any]]:
    code = main(["info", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def write(folder: Path, force_stamps: np.ndarray, pose_stamps: np.ndarray) -> Path:
    with BagWriter(folder) as bag:
        bag.add_topic("/ft", "geometry_msgs/msg/WrenchStamped")
        bag.add_topic("/pose", "geometry_msgs/msg/PoseStamped")
        bag.add_topic("/note", "std_msgs/msg/String")
        bag.write("/note", String(data="begin"), START)
        for topic, kind, stamps in (
            ("/ft", WrenchStamped, force_stamps),
            ("/pose", PoseStamped, pose_stamps),
        ):
            for stamp in stamps.tolist():
                message = kind()
                message.header.frame_id = topic[1:]
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
                bag.write(topic, message, START + 5_000_000 if stamp == 0 else stamp + 5_000_000)
    return folder


def test_rates_jitter_gaps_and_delays_are_those_of_the_stamps(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    force = START + 1_000_000 * np.arange(1, 4001) + rng.normal(0, 5e4, 4000).astype(int)
    force[2000:] += 150_000_000
    pose = START + 10_000_000 * np.arange(1, 401)
    pose[7] = 0
    pose[9] = pose[8]
    code, contents = info(capsys, write(tmp_path / "bag", force, pose))
    assert code == 0
    topics = {topic["name"]: topic for topic in contents["topics"]}
    ft, cp, note = topics["/ft"], topics["/pose"], topics["/note"]
    assert (ft["frame"], ft["messages"], ft["gaps"]) == ("ft", 4000, 1)
    assert ft["rate_hz"] == pytest.approx(1000.0, rel=1e-3)
    # The step is a difference of two stamps.
    assert ft["jitter_s"] == pytest.approx(np.sqrt(2) * 5e-5, rel=0.05)
    assert ft["longest_gap_s"] == pytest.approx(0.151, abs=1e-3)
    assert ft["delay_s"] == pytest.approx(5e-3, rel=1e-6)
    assert cp["rate_hz"] == pytest.approx(100.0, rel=0.02)
    assert (cp["zero_stamps"], cp["backward_stamps"]) == (1, 1)
    assert (note["stamped"], note["frame"]) == (False, None)
    assert contents["used"] == {"force": "/ft", "displacement": "/pose"}
    said = " ".join(contents["warnings"])
    assert "stamped 0" in said and "1 gaps" in said and "do not exceed" in said


def test_clocks_that_do_not_overlap_are_said(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    steps = 1_000_000 * np.arange(1, 101)
    _, contents = info(capsys, write(tmp_path / "bag", START + steps, START + 10**12 + steps))
    assert any("do not overlap" in warning for warning in contents["warnings"])


def test_what_cannot_be_chosen_is_1_and_one_line_after_the_topics(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for topic in ("/left", "/right"):
            bag.add_topic(topic, "geometry_msgs/msg/WrenchStamped")
            bag.write(topic, WrenchStamped(), START)
    assert main(["info", str(tmp_path / "bag")]) == 1
    captured = capsys.readouterr()
    assert "/left\n" in captured.out
    (line,) = captured.err.splitlines()
    assert "/left" in line and "--force-topic" in line


def test_the_golden_bags_are_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(GOLDEN / "golden_pose")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "/tool/wrench   <- force" in lines
    assert "/arm/measured_cp   <- displacement" in lines


def test_a_table_shows_its_columns_and_the_next_command_is_quoted_for_the_shell(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "a press.csv"
    path.write_text("time_s,force_N,depth_mm\n0,1,2\n")
    code, contents = info(capsys, path)
    assert (code, contents) == (0, {"columns": ["time_s", "force_N", "depth_mm"]})
    assert main(["info", str(path)]) == 0
    assert capsys.readouterr().out.endswith(f"Next: fden replay '{path}'\n")
