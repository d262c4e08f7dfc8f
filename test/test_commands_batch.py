# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch`` on real schedulers and workers of Dask, on loopback."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped
from live_helpers import LIMIT
from ros_helpers import wait_for

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.parameters import check
from fden_ros.recording.reader import BagReader
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter

pytest.importorskip("distributed", reason="Dask is not installed: pip install 'fden_ros[batch]'")
pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'fden_ros[batch]'")

import pyarrow.parquet
from distributed import Client

from fden_ros.offline import batch

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


def rows_of(path: Path) -> list[dict[str, Any]]:
    return list(pyarrow.parquet.read_table(path).to_pylist())


@pytest.fixture
def work() -> batch.Work:
    return batch.Work(check({}), Selection())


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("archive")
    for index in range(24):
        air(folder / f"day{index % 3}" / f"bag{index:02}", index)
    return folder


class Cluster:
    """A scheduler and two workers, processes of their own, on loopback."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        self.scheduler = self._start(
            *("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"),
        )
        self.workers = [
            self._start(
                *("worker", "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"),
                *("--no-dashboard", "--local-directory", str(folder / f"worker{index}")),
            )
            for index in range(2)
        ]

    def _start(self, kind: str, *options: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [
                *(sys.executable, "-m", f"distributed.cli.dask_{kind}"),
                *("--scheduler-file", str(self.file), *options),
            ],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=(self._folder / f"{kind}.log").open("ab"),
        )

    def stop(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.terminate()
        for process in (*self.workers, self.scheduler):
            try:
                process.wait(LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        yield cluster
    finally:
        cluster.stop()


def test_a_worker_killed_in_the_middle_loses_nothing_and_doubles_nothing(
    cluster: Cluster, archive: Path, tmp_path: Path, work: batch.Work
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_text("no bag")
    bags = [*batch.find_bags([str(archive)]), broken]
    results = batch.Results(tmp_path / "results.parquet")
    seen: list[batch.Progress] = []

    def report(progress: batch.Progress) -> None:
        seen.append(progress)
        if progress.done == 4:
            cluster.workers[0].send_signal(signal.SIGKILL)

    with Client(scheduler_file=str(cluster.file), timeout=LIMIT, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=LIMIT)
        progress = batch.run(bags, work, results, client, report)
        assert cluster.workers[0].wait(LIMIT) == -signal.SIGKILL
        wait_for(lambda: len(client.scheduler_info()["workers"]) == 1, "the worker's end")
        address = client.scheduler.address
    assert [p.done for p in seen] == list(range(1, 26))
    assert (progress.done, progress.skipped, progress.broken) == (25, 0, 1)
    journal = [
        json.loads(line)["bag"]
        for line in (tmp_path / ".results.parquet.journal").read_text().splitlines()
        if line
    ]
    assert sorted(journal) == sorted(map(str, bags))
    results.save()
    assert sorted(row["bag"] for row in rows_of(results.path)) == sorted(map(str, bags))

    # The command goes on from there, on the worker that is left.
    command = ["batch", str(archive), str(broken), "-o", str(results.path)]
    assert main([*command, "--scheduler", address]) == 0
    assert len(rows_of(results.path)) == 25


def test_processes_of_this_machine_give_what_replay_gives_and_a_second_run_skips(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = tmp_path / "archive"
    shutil.copytree(POSE, archive / "press")
    air(archive / "air", 1)
    (archive / "broken.mcap").write_text("no bag")
    table = tmp_path / "results.parquet"
    config = str(POSE / "identifier.yaml")
    command = ["batch", str(archive), "-o", str(table), "--config", config, "--workers", "1"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "3 bags, 0 of them done before, 1 broken; 2 contacts new" in said.out
    (line,) = (line for line in said.err.splitlines() if line.startswith("broken: "))
    assert str(archive / "broken.mcap") in line and "is not an MCAP file" in line
    rows = rows_of(table)
    assert [Path(row["bag"]).name for row in rows] == ["air", "broken.mcap", "press", "press"]
    assert [bool(row["error"]) for row in rows] == [False, True, False, False]
    assert rows[0]["contact_id"] is None and "no contact was found" in rows[0]["warnings"]

    assert main(["replay", str(POSE), "--config", config, "--json"]) == 0
    contacts = json.loads(capsys.readouterr().out)["contacts"]
    for row, contact in zip(rows[2:], contacts, strict=True):
        for name in (
            *("g", "g_sd", "g_n", "max_force", "start_ns", "converged", "label"),
            *("apparent_stiffness", "apparent_stiffness_sd", "apparent_stiffness_time_scale"),
        ):
            assert row[name] == contact[name]
        known = " ".join(contact["converged_parameters"])
        assert row["converged_parameters"] == known != ""

    # What changed is done again, and it alone.
    shutil.rmtree(archive / "air")
    air(archive / "air", 2)
    assert main(command) == 0
    assert "3 bags, 2 of them done before, 0 broken" in capsys.readouterr().out
    again = rows_of(table)
    assert again[1:] == rows[1:] and again[0]["content"] != rows[0]["content"]


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


def test_a_bag_is_known_by_its_content_and_the_configuration(
    tmp_path: Path, work: batch.Work
) -> None:
    bag = air(tmp_path / "bag", 1, 20)
    other = batch.Work(check({"geometry.thickness": 0.03}), Selection())
    assert work.digest() == batch.Work(check({}), Selection()).digest() != other.digest()
    record = batch.identify(str(bag), work, work.digest(), None)
    assert record["error"] is None and record["pairs"] > 0
    results = batch.Results(tmp_path / "results.parquet")
    results.add(record)
    assert results.known(str(bag), work.digest()) == batch.content_digest(bag)
    assert results.known(str(bag), other.digest()) is None
    known = results.known(str(bag), work.digest())
    assert batch.identify(str(bag), work, work.digest(), known)["unchanged"]
    (bag / "note.txt").write_text("x")
    assert "unchanged" not in batch.identify(str(bag), work, work.digest(), known)


def test_an_interrupted_run_is_taken_up_from_its_journal(tmp_path: Path, work: batch.Work) -> None:
    table = tmp_path / "results.parquet"
    bags = [air(tmp_path / f"bag{index}", index, 20) for index in range(2)]
    first = batch.Results(table)
    for bag in bags:
        first.add(batch.identify(str(bag), work, work.digest(), None))
    # Killed while it wrote: the second line is torn, and there is no table.
    journal = tmp_path / ".results.parquet.journal"
    journal.write_text(journal.read_text()[:-40])
    second = batch.Results(table)
    assert second.known(str(bags[0]), work.digest()) is not None
    assert second.known(str(bags[1]), work.digest()) is None
    second.add(batch.identify(str(bags[1]), work, work.digest(), None))
    third = batch.Results(table)
    assert third.known(str(bags[1]), work.digest()) is not None
    third.save()
    assert [row["bag"] for row in rows_of(table)] == list(map(str, bags))
    assert not journal.exists()


def test_a_bag_lost_with_its_worker_is_tried_again(tmp_path: Path, work: batch.Work) -> None:
    class Lost:
        status = "error"

        def exception(self) -> Exception:
            return RuntimeError("workers died")

    results = batch.Results(tmp_path / "results.parquet")
    record = batch._record_of(Lost(), "/bag", work.digest())
    assert "workers died" in record["error"]
    results.add(record)
    assert results.known("/bag", work.digest()) is None


def test_another_table_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "thesis.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="another kind"):
        batch.Results(path)
    assert path.read_bytes() == before
    path.write_text("words")
    with pytest.raises(InputError, match="no table of results"):
        batch.Results(path)


def test_memory_of_reading_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    data = bytes(100)

    def peak(name: str, count: int) -> int:
        with BagWriter(tmp_path / name) as bag:
            bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
            for index in range(count):
                bag.write("/force", data, START + index)
        tracemalloc.start()
        reader = BagReader(tmp_path / name)
        assert sum(1 for _ in reader.messages()) == count
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return highest

    peak("first", 100)
    # Several chunks each: what is held is the present one and the next.
    assert peak("long", 60_000) < 1.05 * peak("short", 20_000)


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("x",),
        ("x", "-o", "y", "--workers", "0"),
        ("x", "-o", "y", "--workers", "2", "--scheduler", "z"),
    ],
)
def test_wrong_usage_is_2(arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["batch", *arguments])
    assert exit_.value.code == 2


def test_no_bag_is_1_and_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", str(tmp_path), "-o", str(tmp_path / "r.parquet")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "holds no bag" in line
    assert list(tmp_path.iterdir()) == []
