# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch`` on a cluster of Dask: a scheduler and workers on the loopback."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fden_ros import __version__
from fden_ros.cli import main
from fden_ros.offline import batch, workers
from fden_ros.parameters import check
from fden_ros.recording.source import Selection

distributed = pytest.importorskip("distributed", reason="the extra is not installed")

ROOT = Path(__file__).parent.parent
POSE = ROOT / "bags" / "golden" / "golden_pose"
CONFIG = POSE / "identifier.yaml"
WORK = batch.Work(check({}), Selection())


def started(*command: str | Path, first: Path | None = None) -> subprocess.Popen[bytes]:
    """Start a module; what lies in the folder `first` is imported before anything else."""
    paths = [first, Path(__file__).parent, os.environ.get("PYTHONPATH")]
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, command)],
        cwd="/",  # not the checkout, which would come first
        env=os.environ
        | {
            "PYTHONPATH": os.pathsep.join(str(path) for path in paths if path),
            # Of the scheduler: a task is given up when two workers have died of it.
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def until(is_so: Callable[[], bool]) -> None:
    from live_helpers import wait_for  # here, because workers import this module without it

    wait_for(is_so, "the cluster", 60.0)


class Cluster:
    """A scheduler; its workers have one thread each, and a nanny that begins them anew."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self._processes = [
            started("distributed.cli.dask_scheduler", *options, "--scheduler-file", self.file)
        ]
        until(self.file.exists)

    def add(self, count: int, first: Path | None = None) -> None:
        options = ("--nworkers", str(count), "--nthreads", "1", "--no-dashboard")
        self._processes.append(
            started(
                "distributed.cli.dask_worker", "--scheduler-file", self.file, *options,
                "--local-directory", self._folder, first=first,
            )
        )  # fmt: skip
        with distributed.Client(scheduler_file=str(self.file)) as client:
            client.wait_for_workers(count, timeout=60)

    def pids(self) -> list[int]:
        with distributed.Client(scheduler_file=str(self.file)) as client:
            return list(client.run(os.getpid).values())

    def stop(self) -> None:
        for process in reversed(self._processes):
            process.terminate()
            process.wait(timeout=30)


@contextmanager
def cluster_in(folder: Path) -> Iterator[Cluster]:
    cluster = Cluster(folder)
    try:
        yield cluster
    finally:
        cluster.stop()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster_in(tmp_path_factory.mktemp("cluster")) as cluster:
        cluster.add(2)
        yield cluster


def archive(folder: Path, count: int) -> Path:
    for number in range(count):
        shutil.copytree(POSE, folder / f"press{number}")
    return folder


def command(places: Path, table: Path, *options: str | Path) -> list[str]:
    return ["batch", *map(str, (places, "-o", table, "--config", CONFIG, *options))]


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(encoding="utf-8", newline="") as file:
        return sorted(csv.DictReader(file), key=lambda row: (row["bag"], row["contact_id"]))


def test_the_table_of_a_cluster_is_that_of_this_machine(tmp_path, cluster, capsys):
    places = archive(tmp_path / "archive", 1)
    (places / "broken.mcap").write_text("no bag")
    here, there = tmp_path / "here.csv", tmp_path / "there.parquet"
    assert main(command(places, here, "--workers", "1")) == 0
    assert main(command(places, there, "--scheduler", cluster.file)) == 0
    assert "2 bags, 0 of them done before, 1 broken; 2 contacts new" in capsys.readouterr().out
    rows = rows_of(here)
    assert len(rows) == 3 and rows_of(there.with_suffix(".csv")) == rows

    parquet = pytest.importorskip("pyarrow.parquet")
    found = parquet.read_table(there).to_pylist()
    found.sort(key=lambda row: (row["bag"], row["contact_id"] or 0))
    for row, typed in zip(rows, found, strict=True):
        shown = {name: "" if value is None else str(value) for name, value in typed.items()}
        assert shown == row
    assert [type(found[1][name]) for name in ("bag", "contact_id", "g", "converged")] == [
        *(str, int, float, bool)
    ]
    # Done already, so that no worker is asked.
    assert main(command(places, there, "--scheduler", cluster.file)) == 0
    assert "2 of them done before" in capsys.readouterr().out


def test_a_worker_that_is_killed_in_the_middle_costs_nothing(tmp_path, cluster):
    places, table = archive(tmp_path / "archive", 3), tmp_path / "results.csv"
    whole = command(places, table, "--scheduler", cluster.file)
    running = started("fden_ros.cli", *whole)
    until(lambda: table.exists() and len(rows_of(table)) >= 2)
    os.kill(cluster.pids()[0], signal.SIGKILL)
    assert running.wait(timeout=120) == 0
    rows = rows_of(table)
    assert len(rows) == 6 and not any(row["error"] for row in rows)
    first = {name: value for name, value in rows[0].items() if name != "bag"}
    assert all(first.items() <= row.items() for row in rows[::2])


def lethal(bag: str, work: batch.Work) -> list[batch.Row]:
    if bag == "lethal":
        os.kill(os.getpid(), signal.SIGKILL)
    return batch.identify(bag, work)


def test_a_recording_that_kills_its_worker_again_and_again_is_a_row(tmp_path, cluster):
    bags = [Path("lethal"), *(ROOT / "examples").glob("press.csv")]
    results = batch.Results(tmp_path / "results.csv", WORK.digest())
    with workers.cluster(str(cluster.file), print) as pool:
        batch.run(bags, WORK, results, pool, lambda rows: None, lethal)
    errors = {row["bag"]: row["error"] for row in rows_of(results.path)}
    assert errors.pop("lethal").startswith(batch.KILLED)
    assert list(errors.values()) == [""]
    again = batch.Results(results.path, WORK.digest())
    assert not again.has("lethal") and again.has(str(bags[1]))


def test_a_worker_of_another_version_is_refused(tmp_path, capsys):
    package = tmp_path / "other" / "fden_ros"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("__version__ = '0.0.9'\n")
    other = tmp_path / "other.csv"
    with cluster_in(tmp_path) as cluster:
        cluster.add(1, first=package.parent)
        assert main(command(ROOT / "examples", other, "--scheduler", cluster.file)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert f"install fden_ros {__version__}" in line
    assert not other.exists()
