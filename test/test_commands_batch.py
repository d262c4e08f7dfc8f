# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch``: an archive of bags, identified by processes of this machine."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.offline import batch
from fden_ros.parameters import check
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter

ROOT = Path(__file__).parent.parent
POSE = ROOT / "bags" / "golden" / "golden_pose"
START = 1_700_000_000_000_000_000


def air(folder: Path, seed: int, count: int = 300) -> Path:
    """Write a bag of a probe in the air: quick to identify, with content of its own."""
    rng = np.random.default_rng(seed)
    with BagWriter(folder) as bag:
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
        bag.add_topic("/displacement", "geometry_msgs/msg/PointStamped")
        for index in range(count):
            stamp = START + 2_000_000 * index
            for topic, message in (
                ("/displacement", PointStamped()),
                ("/force", WrenchStamped()),
            ):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
                if topic == "/force":
                    message.wrench.force.z = float(rng.normal(0, 1e-3))
                bag.write(topic, message, stamp)
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def work() -> batch.Work:
    return batch.Work(check({}), Selection())


def test_processes_give_what_replay_gives_and_a_second_run_skips(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = tmp_path / "archive"
    shutil.copytree(POSE, archive / "press")
    air(archive / "air", 1)
    (archive / "broken.mcap").write_text("no bag")
    table = tmp_path / "results.csv"
    config = str(POSE / "identifier.yaml")
    command = ["batch", str(archive), "-o", str(table), "--config", config, "--workers", "1"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "3 bags, 0 of them done before, 1 broken; 2 contacts new" in said.out
    (line,) = (line for line in said.err.splitlines() if line.startswith("broken: "))
    assert str(archive / "broken.mcap") in line and "is not an MCAP file" in line
    rows = sorted(rows_of(table), key=lambda row: row["bag"])
    assert [Path(row["bag"]).name for row in rows] == ["air", "broken.mcap", "press", "press"]
    assert [bool(row["error"]) for row in rows] == [False, True, False, False]
    assert rows[0]["contact_id"] == "" and "no contact was found" in rows[0]["warnings"]

    assert main(["replay", str(POSE), "--config", config, "--json"]) == 0
    contacts = json.loads(capsys.readouterr().out)["contacts"]
    for row, contact in zip(rows[2:], contacts, strict=True):
        for name in (
            *("g", "g_sd", "g_n", "max_force", "start_ns", "converged", "label"),
            *("apparent_stiffness", "apparent_stiffness_sd", "apparent_stiffness_time_scale"),
        ):
            assert row[name] == str(contact[name])
        known = " ".join(contact["converged_parameters"])
        assert row["converged_parameters"] == known != ""

    # What is new is done, and it alone.
    before = table.read_text()
    air(archive / "later", 2)
    assert main(command) == 0
    assert "4 bags, 3 of them done before, 0 broken" in capsys.readouterr().out
    assert table.read_text().startswith(before)


# Without workers


def test_bags_are_found_in_folders_and_by_patterns(tmp_path: Path) -> None:
    air(tmp_path / "a" / "one", 1, 3)
    air(tmp_path / "a" / ".two.part", 2, 3)
    shutil.copy(tmp_path / "a" / "one" / "one_0.mcap", tmp_path / "a" / "bare.mcap")
    (tmp_path / "a" / "notes.txt").write_text("x")
    found = batch.find_bags([str(tmp_path / "a"), str(tmp_path / "a" / "*.mcap")])
    assert [path.name for path in found] == ["bare.mcap", "one"]
    with pytest.raises(InputError, match="holds no bag"):
        batch.find_bags([str(tmp_path / "nowhere")])


def test_a_bag_is_done_again_where_the_configuration_differs_or_its_rows_are_cut_off(
    tmp_path: Path, work: batch.Work
) -> None:
    bags = [str(air(tmp_path / f"bag{index}", index, 20)) for index in range(2)]
    other = batch.Work(check({"geometry.thickness": 0.03}), Selection())
    assert work.digest() == batch.Work(check({}), Selection()).digest() != other.digest()
    table = tmp_path / "results.csv"
    results = batch.Results(table, work.digest())
    for bag in bags:
        results.add(batch.identify(bag, work))
    whole = batch.Results(table, work.digest())
    assert whole.has(bags[0]) and whole.has(bags[1])
    assert not batch.Results(table, other.digest()).has(bags[0])
    # Killed while it wrote.
    table.write_text(table.read_text()[:-40])
    torn = batch.Results(table, work.digest())
    assert torn.has(bags[0]) and not torn.has(bags[1])
    torn.add(batch.identify(bags[1], work))
    assert [row["bag"] for row in rows_of(table)] == bags


def test_a_bag_that_lacks_a_contact_is_done_again(tmp_path: Path, work: batch.Work) -> None:
    (row,) = batch.identify(str(air(tmp_path / "bag", 1, 20)), work)
    results = batch.Results(tmp_path / "results.csv", work.digest())
    results.add([row | {"contacts": 2}])
    assert not batch.Results(results.path, work.digest()).has(row["bag"])


def test_another_table_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "thesis.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="another kind"):
        batch.Results(path, "")
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="no table of results"):
        batch.Results(path, "")
