# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""An archive of recordings, identified by several processes: a table with one row per contact.

The rows of a bag are in the table as soon as it is done, so an interrupted run continues: a bag
with rows in the table is not identified again.
"""

from __future__ import annotations

import csv
import glob
import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import groupby, islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros import __version__
from fden_ros.core.outputs import Output, TissueState
from fden_ros.errors import InputError
from fden_ros.offline.parquet import write_parquet
from fden_ros.offline.replay import replay
from fden_ros.offline.rows import COLUMNS, contact_row
from fden_ros.offline.workers import SAME_VERSION
from fden_ros.parameters import Parameters
from fden_ros.recording.places import NOT_REACHED, exists, is_folder, is_remote, place, reached
from fden_ros.recording.reader import METADATA_FILE, is_bag_file
from fden_ros.recording.source import Selection
from fden_ros.tissues.library import load_library

#: Of the bag: its configuration, its selection, its problems, its length, and its number of
#: contacts, which shows whether all of its rows are there.
_BAG_COLUMNS = (
    "bag", "configuration", "inputs", "error", "warnings", "seconds", "pairs", "contacts",
)  # fmt: skip

_HEADING = ",".join(_BAG_COLUMNS).encode()
#: Tables that are taken from a folder; a named table may be of any kind.
_TABLES = (".csv", ".tsv")
#: Prefix of the error of a recording that the next run tries again.
KILLED = "its worker was killed"
#: Recordings in work at once: the cores of a large cluster, and little memory.
_UNDER_WAY = 1000

Row = dict[str, Any]


@dataclass(frozen=True)
class Work:
    """The configuration of all bags: parameters, and topics or fields."""

    parameters: Parameters
    selection: Selection

    def digest(self) -> str:
        """Return what distinguishes this configuration, the tissue library included."""
        library = load_library(self.parameters.library or None)
        parts = [__version__, self.parameters.as_dict(), asdict(self.selection), repr(library)]
        text = json.dumps(parts, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def find_bags(places: Sequence[str]) -> list[Path]:
    """Return the recordings in folders, at paths and glob patterns, sorted, each once.

    A folder with a ``metadata.yaml`` is one; elsewhere each file of a bag is one, and each table
    that is not a result of this command. A place without any is returned too, for an error row.

    Raises
    ------
    InputError
        If no place holds any.
    """
    found: set[Path] = set()
    empty: set[Path] = set()
    for text in places:
        paths = _matches(text)
        for path in paths:
            with reached(path):
                bags = set(map(_absolute, _bags_at(path)))
            found |= bags
            empty |= set() if bags else {_absolute(path)}
        empty |= set() if paths else {_absolute(place(text))}
    if not found:
        where = ", ".join(places)
        raise InputError(f"{where} holds no bag: give a folder of bags, or a pattern of some")
    return sorted(found | empty, key=str)


def _matches(text: str) -> list[Path]:
    """Return the existing places for a path or a URL, or by a pattern."""
    path = place(text)
    if not is_remote(path):
        return [path] if path.exists() else list(map(Path, sorted(glob.glob(text))))
    start, star, _ = text.partition("*")
    if not star:
        return [path] if exists(path) else []
    folder = start[: start.rindex("/") + 1]
    with reached(path):
        return sorted(place(folder).glob(text.removeprefix(folder)), key=str)


def _absolute(path: Path) -> Path:
    return path if is_remote(path) else path.resolve()


def _bags_at(path: Path) -> Iterator[Path]:
    # A named place is meant, whatever its name: if it is no bag, its row reports that.
    if not is_folder(path):
        yield path
        return
    is_bag = exists(path / METADATA_FILE)
    if is_bag:
        yield path
    for child in sorted(path.iterdir(), key=str):
        if child.name.startswith("."):
            continue
        if is_folder(child) or (not is_bag and (is_bag_file(child) or _is_table(child))):
            yield from _bags_at(child)


def _is_table(path: Path) -> bool:
    """Return whether a file found in a folder is a recording: a table, and not one of results."""
    name = path.name.lower().removesuffix(".gz")
    if is_remote(path) or path.name.lower().endswith(".gz"):
        # To look into each would read them all twice.
        return name.endswith(_TABLES)
    with path.open("rb") as file:
        return name.endswith(_TABLES) and not file.readline(99).startswith(_HEADING)


def identify(bag: str, work: Work) -> list[Row]:
    """Return the rows of a bag: one a contact, or one that reports none, or an error."""
    row = _row(bag, work.digest())
    try:
        return _identify(row, work)
    except InputError as error:
        return [row | {"error": str(error)}]
    except Exception as error:
        # No error of one bag may end a run of thousands.
        return [row | {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}]


def _row(bag: str, configuration: str) -> Row:
    """Return a row without a contact."""
    row: Row = dict.fromkeys((*_BAG_COLUMNS, *COLUMNS))
    return row | {"bag": bag, "configuration": configuration, "contacts": 0}


def _identify(row: Row, work: Work) -> list[Row]:
    squares: defaultdict[int, list[float]] = defaultdict(list)
    times: list[int] = []

    def see(output: Output, frame: str) -> None:
        if isinstance(output, TissueState) and output.innovation is not None:
            squares[output.contact_id].append(output.innovation.normalized_squared)

    def tick(log_time_ns: int, *_: object) -> None:
        times[1:] = [log_time_ns]

    result = replay(row["bag"], work.parameters, work.selection, on_output=see, on_input=tick)
    row = row | {
        "inputs": ", ".join(f"{stream} from {name}" for stream, name in result.inputs.items()),
        "warnings": "; ".join(result.warnings),
        "seconds": (times[-1] - times[0]) * 1e-9 if times else 0.0,
        "pairs": result.samples,
        "contacts": len(result.summaries),
    }
    found = {number: float(np.mean(values)) for number, values in squares.items()}
    rows = [row | contact_row(one, found.get(one.contact_id)) for one in result.summaries]
    return rows or [row]


class Results:
    """The table: CSV, and next to it Parquet where the path says so.

    Rows are written to the CSV at once. The Parquet file is made from it at the end.

    Raises
    ------
    InputError
        If there is a table that is not of this kind or `configuration`, or nothing can be written.
    """

    def __init__(self, path: str | Path, configuration: str) -> None:
        target = Path(path)
        self._parquet = target if target.suffix.lower() == ".parquet" else None
        self.path = target.with_suffix(".csv") if self._parquet else target
        self.configuration = configuration
        self._is_open = False
        whole = [rows for _, rows in _groups(self.path) if _is_whole(rows)]
        if any(rows[0]["configuration"] != configuration for rows in whole):
            raise InputError(
                f"{self.path} was made with other parameters, version or tissue library: choose "
                "another place, or delete it"
            )
        self._done = {rows[0]["bag"] for rows in whole}

    def has(self, bag: str) -> bool:
        """Return whether all rows of `bag` are there."""
        return bag in self._done

    def add(self, rows: Sequence[Row]) -> None:
        """Add the rows of a bag; they are on the disk when this returns."""
        with _written(self.path):
            if not self._is_open:
                self._write_anew()
            with self.path.open("a", encoding="utf-8", newline="") as file:
                _writer(file).writerows(rows)
        self._done.add(rows[0]["bag"])

    def close(self) -> None:
        """Write the Parquet file."""
        if self._parquet is not None and self.path.exists():
            with _written(self._parquet):
                write_parquet(self.path, self._parquet)

    def _write_anew(self) -> None:
        """Write the table without truncated rows."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_name(f".{self.path.name}.part")
        with draft.open("w", encoding="utf-8", newline="") as file:
            writer = _writer(file)
            writer.writeheader()
            writer.writerows(
                row for _, rows in _groups(self.path) if _is_whole(rows) for row in rows
            )
        draft.replace(self.path)
        self._is_open = True


@contextmanager
def _written(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        why = f"{path} cannot be written ({error.strerror}): choose another place"
        raise InputError(why) from None


def _writer(file: Any) -> csv.DictWriter[str]:
    return csv.DictWriter(file, (*_BAG_COLUMNS, *COLUMNS), lineterminator="\n")


def _groups(path: Path) -> Iterator[tuple[str, list[Row]]]:
    """Yield the rows of each bag in a table, without a truncated line."""
    if not path.exists():
        return
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(line for line in file if line.endswith("\n"))
            if reader.fieldnames != [*_BAG_COLUMNS, *COLUMNS]:
                raise InputError(f"{path} is a table of another kind: choose another place")
            for (bag, _), rows in groupby(reader, key=itemgetter("bag", "configuration")):
                yield bag, list(rows)
    except (OSError, UnicodeDecodeError, csv.Error):
        raise InputError(f"{path} is not a table of results: choose another place") from None


def _is_whole(rows: Sequence[Row]) -> bool:
    """Return whether all rows of a bag are there and reliable."""
    error, contacts = rows[0]["error"], rows[0]["contacts"]
    # A worker may not have the folder mounted yet.
    may_pass = error.startswith(KILLED) or NOT_REACHED in error or "does not exist" in error
    return not may_pass and len(rows) == max(1, int(contacts or 0))


def run(
    bags: Iterable[Path],
    work: Work,
    results: Results,
    pool: Executor,
    on_bag: Callable[[list[Row]], object],
    task: Callable[[str, Work], list[Row]] = identify,
) -> None:
    """Identify `bags` in the processes of `pool`, keep each result, and call `on_bag`.

    Raises
    ------
    InputError
        If a process of this machine was killed, or a worker computes something else.
    """
    left = iter(bags)
    under_way: dict[Future[list[Row]], str] = {}
    while True:
        for bag in map(str, islice(left, _UNDER_WAY - len(under_way))):
            under_way[pool.submit(task, bag, work)] = bag
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            rows = _rows_of(future, under_way.pop(future), results)
            results.add(rows)
            on_bag(rows)


def _rows_of(future: Future[list[Row]], bag: str, results: Results) -> list[Row]:
    kept = f"{results.path} has the results so far; run the same command again"
    try:
        rows = future.result()
    except BrokenProcessPool:
        why = f"a process was killed: {kept}, with fewer --workers if memory is short"
        raise InputError(why) from None
    except CancelledError:
        raise InputError(f"the scheduler is gone: start it; {kept}") from None
    except Exception as error:
        # Dask drops a task when each of its workers was killed.
        if type(error).__name__ != "KilledWorker":
            raise InputError(f"a worker cannot do it ({error}): {SAME_VERSION}") from None
        why = f"{KILLED} each time it was tried: does it have enough memory?"
        return [_row(bag, results.configuration) | {"error": why}]
    if rows[0]["configuration"] != results.configuration:
        raise InputError(f"a worker has another version or tissue library: {SAME_VERSION}")
    return rows
