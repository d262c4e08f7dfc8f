# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Continuous contact from a bag: table, JSON, results, map and report."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from fden_ros.cli import main
from simulation.bag import write_recording
from simulation.scenario import load_scenario
from simulation.simulate import simulate


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("continuous") / "bag"
    write_recording(simulate(load_scenario("continuous")), folder)
    return folder


def command(bag: Path, name: str, *options: str | Path) -> int:
    config = bag / "identifier.yaml"
    return main([name, str(bag), "--config", str(config), *map(str, options)])


def test_a_path_is_identified_and_its_places_are_a_map(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert command(bag, "replay", "--json", "-o", out) == 0
    contacts = json.loads(capsys.readouterr().out)["contacts"]
    known = [one for one in contacts if one["apparent_stiffness"] is not None]
    assert len(known) > 20
    assert not any(one["converged"] for one in contacts)
    assert all(one["flags"] == ["origin_uncertain"] for one in contacts)
    assert {name for one in known for name in one["valid_parameters"]} <= {"fractional_order"}
    with AnyReader([out]) as reader:
        read = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]
    assert not [m for topic, m in read if topic == "/identifier/markers"]
    cloud = [m for topic, m in read if topic == "/identifier/stiffness_map"][-1]
    names = [field.name for field in cloud.fields]
    rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(cloud.width, cloud.point_step)

    def column(name: str, kind: str) -> np.ndarray:
        first = cloud.fields[names.index(name)].offset
        return rows[:, first : first + np.dtype(kind).itemsize].copy().view(kind)[:, 0]

    assert column("stiffness", "<f8") == pytest.approx([o["apparent_stiffness"] for o in known])
    assert column("x", "<f4") == pytest.approx([o["position"][0] for o in known], abs=1e-6)


def test_the_report_draws_the_path(bag: Path, tmp_path: Path) -> None:
    page, table = tmp_path / "page.html", tmp_path / "table.csv"
    assert command(bag, "report", "-o", page, "--csv", table) == 0
    text = page.read_text(encoding="utf-8")
    assert " places on the path whose stiffness is known: " in text
    assert "dF/dd for a motion of 0.1 s" in text
    assert "<h2>Places</h2>" in text and "no stiffness yet" in text
    # A press's words: what it was, which tissue, how the probe stood; one unpaired force is usual.
    assert not any(
        words in text
        for words in ("max strain", "undetermined", "origin uncertain", "normal not", "rejected:")
    )
    with table.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["apparent_stiffness"]]
    assert len(rows) > 20
