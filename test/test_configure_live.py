# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""`fden configure --live` beside a robot that moves: a bag that is played into real topics."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from live_helpers import process_of
from test_configure import run, whole_rig
from unknown_rig_bags import RigBag

from fden_ros.nodes import guide
from fden_ros.parameters import read_parameter_file


def test_it_says_what_to_do_and_waits_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = whole_rig(force_rate=100.0, displacement_rate=100.0)
    bag = RigBag(rig.streams).write(tmp_path / "bag")
    output = tmp_path / "probe.yaml"
    play = [sys.executable, "-m", "fden_ros.cli", "play", str(bag), "--rate", "3"]
    with process_of(play):
        topics = ["--force-topic", "/ft/wrench", "--displacement-topic", "/arm/pose"]
        assert run("configure", "--live", *topics, "-o", output) == 0
    printed = capsys.readouterr()
    said = printed.err.splitlines()
    assert "force from /ft/wrench (geometry_msgs/WrenchStamped)" in said
    assert any(line.startswith("NOW: turn the tool in the air") for line in said)
    assert said.index("done: turn") < said.index("done: press") < said.index("done: plate")
    assert not any("given up" in line for line in said)
    assert "identifier.launch.py parameters:=" in printed.out
    parameters = read_parameter_file(output)
    truth = rig.truth
    assert parameters.tool.mass == pytest.approx(truth.mass, rel=0.02)
    assert parameters.displacement.delay == pytest.approx(truth.delay, abs=1e-3)
    assert parameters.displacement.compliance == pytest.approx(truth.compliance, rel=0.1)


def test_without_topics_it_says_which_it_would_need(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guide, "_TOPICS_WITHIN", 0.5)
    assert run("configure", "--live") == 1
    assert "no topic can carry the force: " in capsys.readouterr().err
