# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch`` on a cluster of Dask: a scheduler and workers on the loopback."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import command_helpers
import pytest
from command_helpers import POSE, ROOT
from live_helpers import wait_for

from fden_ros import __version__
from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.offline import batch, workers
from fden_ros.parameters import check
from fden_ros.recording.source import Selection

distributed = pytest.importorskip("distributed", reason="the extra is not installed")
dask = pytest.importorskip("dask")

CONFIG = POSE / "identifier.yaml"
WORK = batch.Work(check({}), Selection())


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """A client of two workers of one thread each, with nannies that begin them anew."""
    # A task is given up when two workers have died of it.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def scheduler(client: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file in which a scheduler says where it is."""
    path = tmp_path_factory.mktemp("scheduler") / "scheduler.json"
    client.write_scheduler_file(str(path))
    return path


def archive(folder: Path, count: int) -> Path:
    for number in range(count):
        shutil.copytree(POSE, folder / f"press{number}")
    return folder


def command(places: Path, table: Path, *options: str | Path) -> list[str]:
    return ["batch", *map(str, (places, "-o", table, "--config", CONFIG, *options))]


def rows_of(table: Path) -> list[dict[str, str]]:
    return sorted(command_helpers.rows_of(table), key=lambda row: (row["bag"], row["contact_id"]))


def test_the_table_of_a_cluster_is_that_of_this_machine(tmp_path, scheduler, capsys):
    places = archive(tmp_path / "archive", 1)
    (places / "broken.mcap").write_text("no bag")
    here, there = tmp_path / "here.csv", tmp_path / "there.parquet"
    assert main(command(places, here, "--workers", "1")) == 0
    assert main(command(places, there, "--scheduler", scheduler)) == 0
    assert "2 bags, 0 of them done before, 1 broken; 2 new contacts" in capsys.readouterr().out
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
    assert main(command(places, there, "--scheduler", scheduler)) == 0
    assert "2 of them done before" in capsys.readouterr().out


def test_a_worker_that_is_killed_in_the_middle_costs_nothing(tmp_path, client, scheduler):
    places, table = archive(tmp_path / "archive", 3), tmp_path / "results.csv"
    whole = command(places, table, "--scheduler", scheduler)

    def kill() -> None:
        wait_for(lambda: table.exists() and len(rows_of(table)) >= 2, "the first rows", 60.0)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

    with ThreadPoolExecutor(1) as beside:
        killed = beside.submit(kill)
        assert main(whole) == 0
        killed.result()
    rows = rows_of(table)
    assert len(rows) == 6 and not any(row["error"] for row in rows)
    first = {name: value for name, value in rows[0].items() if name != "bag"}
    assert all(first.items() <= row.items() for row in rows[::2])


def lethal(bag: str, work: batch.Work) -> list[batch.Row]:
    if bag == "lethal":
        os.kill(os.getpid(), signal.SIGKILL)
    return batch.identify(bag, work)


def test_a_recording_that_kills_its_worker_again_and_again_is_a_row(tmp_path, scheduler):
    bags = [Path("lethal"), *(ROOT / "examples").glob("press.csv")]
    results = batch.Results(tmp_path / "results.csv", WORK.digest())
    with workers.cluster(str(scheduler), print) as pool:
        batch.run(bags, WORK, results, pool, lambda rows: None, lethal)
    errors = {row["bag"]: row["error"] for row in rows_of(results.path)}
    assert errors.pop("lethal").startswith(batch.KILLED)
    assert list(errors.values()) == [""]
    again = batch.Results(results.path, WORK.digest())
    assert not again.has("lethal") and again.has(str(bags[1]))


def take_for(version: str) -> None:
    batch.__version__ = version


def lacking(bag: str, work: batch.Work) -> list[batch.Row]:
    raise ModuleNotFoundError("No module named 'fden_ros'")


def test_a_worker_of_another_version_is_refused(tmp_path, capsys, client, scheduler):
    words, other = f"install fden_ros {__version__}", tmp_path / "other.csv"
    client.run(take_for, "0.0.9")
    assert main(command(ROOT / "examples", other, "--scheduler", scheduler)) == 1
    client.run(take_for, __version__)
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line and not other.exists()
    results = batch.Results(other, WORK.digest())
    with (
        workers.cluster(str(scheduler), print) as pool,
        pytest.raises(InputError, match=rf"a worker cannot do it \(.*\): {words}"),
    ):
        batch.run([Path("press.csv")], WORK, results, pool, lambda rows: None, lacking)
