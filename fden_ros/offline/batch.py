# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""An archive of recordings, identified by several processes: a table with a row a contact.

The rows of a bag are in the table as soon as it is done. So a run that is interrupted goes on
where it was: a bag whose rows are there with the same configuration is not done again.
"""

from __future__ import annotations

import csv
import glob
import hashlib
import json
import multiprocessing
import os
import signal
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fden_ros import __version__
from fden_ros.core.outputs import Output, TissueState
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.offline.rows import COLUMNS, contact_row
from fden_ros.offline.session import Innovations
from fden_ros.parameters import Parameters
from fden_ros.recording.reader import METADATA_FILE, is_bag_file
from fden_ros.recording.source import Selection
from fden_ros.recording.text import TABLE_SUFFIXES, layout_of
from fden_ros.tissues.library import load_library

#: Of the bag: what it was identified with, what was chosen in it, what is wrong with it, its
#: length, and how many contacts it has, which tells whether all of its rows are there.
_BAG_COLUMNS = (
    "bag", "configuration", "inputs", "error", "warnings", "seconds", "pairs", "contacts",
)  # fmt: skip

Row = dict[str, Any]


@dataclass(frozen=True)
class Work:
    """What every bag is identified with.

    Parameters
    ----------
    parameters : Parameters
    selection : Selection
        Topics or fields.
    """

    parameters: Parameters
    selection: Selection

    def digest(self) -> str:
        """Return what tells this configuration from others, the tissue library included."""
        library = load_library(self.parameters.classifier.library or None)
        parts = [__version__, self.parameters.as_dict(), asdict(self.selection), repr(library)]
        text = json.dumps(parts, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def find_bags(places: Sequence[str]) -> list[Path]:
    """Return the recordings in folders, at paths and glob patterns, sorted, each once.

    A folder with a ``metadata.yaml`` is one; elsewhere each file of a bag is one, and each table
    that does not come from here. A place that holds none is returned too: its row will say so.

    Raises
    ------
    InputError
        If no place holds any.
    """
    found: dict[Path, None] = {}
    empty: dict[Path, None] = {}
    for place in places:
        paths = sorted(glob.glob(place)) if not os.path.exists(place) else [place]
        for path in map(Path, paths or [place]):
            bags = dict.fromkeys(bag.resolve() for bag in _bags_at(path)) if paths else {}
            found |= bags
            empty |= {} if bags else {path.resolve(): None}
    if not found:
        where = ", ".join(places)
        raise InputError(f"{where} holds no bag: give a folder of bags, or a pattern of some")
    return sorted(found | empty)


def _bags_at(path: Path) -> Iterator[Path]:
    # What is named is meant, whatever its name: if it is no bag, its row will say so.
    if not path.is_dir():
        yield path
        return
    is_bag = (path / METADATA_FILE).is_file()
    if is_bag:
        yield path
    for child in sorted(path.iterdir()):
        if child.name.startswith("."):
            continue
        if child.is_dir() or (not is_bag and (is_bag_file(child) or _is_table(child))):
            yield from _bags_at(child)


def _is_table(path: Path) -> bool:
    """Return whether a file found in a folder is a recording: a table, not of results, no text."""
    suffix = (Path(path.stem) if path.suffix.lower() == ".gz" else path).suffix.lower()
    if suffix not in TABLE_SUFFIXES:
        return False
    is_text = suffix == ".txt"
    try:
        layout = layout_of(path)
    except InputError:
        return not is_text
    if layout.headings[: len(_BAG_COLUMNS)] == tuple(_BAG_COLUMNS):
        return False
    numbers = sum(layout.holds_numbers(index) for index in range(layout.width))
    return not is_text or numbers > 1


def identify(bag: str, work: Work) -> list[Row]:
    """Return the rows of a bag: one a contact, or one that says that there is none, or why.

    Parameters
    ----------
    bag : str
        Path.
    work : Work
    """
    row: Row = dict.fromkeys((*_BAG_COLUMNS, *COLUMNS))
    row |= {"bag": bag, "configuration": work.digest(), "contacts": 0}
    try:
        return _identify(row, work)
    except InputError as error:
        return [row | {"error": str(error)}]
    except Exception as error:
        # One bag must not end a run of thousands, whatever is wrong with it.
        return [row | {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}]


def _identify(row: Row, work: Work) -> list[Row]:
    innovations: defaultdict[int, Innovations] = defaultdict(Innovations)
    times: list[int] = []

    def see(output: Output, frame: str) -> None:
        if isinstance(output, TissueState) and output.innovation is not None:
            innovations[output.contact_id].add(output.innovation)

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
    rows = [
        row | contact_row(summary, innovations[summary.contact_id].mean_square)
        for summary in result.summaries
    ]
    return rows or [row]


class Results:
    """The table, CSV.

    Parameters
    ----------
    path : path
    configuration : str
        That of the run: rows of another one are left out when their bag is done again.

    Raises
    ------
    InputError
        If there is a table that is not of this kind, or nothing can be written there.
    """

    def __init__(self, path: str | Path, configuration: str) -> None:
        self.path = Path(path)
        self._configuration = configuration
        self._rows = _read_table(self.path)
        self._is_written = False

    def has(self, bag: str) -> bool:
        """Return whether all rows of `bag` are there, of this configuration."""
        rows = self._rows.get(bag, [])
        return bool(rows) and all(
            row["configuration"] == self._configuration
            and len(rows) == max(1, int(row["contacts"] or 0))
            for row in rows
        )

    def add(self, rows: Sequence[Row]) -> None:
        """Keep the rows of a bag; they are on the disk when this returns."""
        bag = rows[0]["bag"]
        can_follow = self._is_written and bag not in self._rows
        self._rows[bag] = list(rows)
        try:
            if can_follow:
                with self.path.open("a", encoding="utf-8", newline="") as file:
                    _writer(file).writerows(rows)
                return
            self._write_anew()
        except OSError as error:
            raise InputError(
                f"{self.path} cannot be written ({error.strerror}): choose another place"
            ) from None

    def _write_anew(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_name(f".{self.path.name}.part")
        with draft.open("w", encoding="utf-8", newline="") as file:
            writer = _writer(file)
            writer.writeheader()
            for rows in self._rows.values():
                writer.writerows(rows)
        draft.replace(self.path)
        self._is_written = True


def _writer(file: Any) -> csv.DictWriter[str]:
    return csv.DictWriter(file, (*_BAG_COLUMNS, *COLUMNS), lineterminator="\n")


def _read_table(path: Path) -> dict[str, list[Row]]:
    """Return the rows of a table by bag; without a line that was cut off."""
    found: defaultdict[str, list[Row]] = defaultdict(list)
    if not path.exists():
        return found
    try:
        whole, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
        reader = csv.DictReader(whole.splitlines())
        if reader.fieldnames != [*_BAG_COLUMNS, *COLUMNS]:
            raise InputError(f"{path} is a table of another kind: choose another place")
        for row in reader:
            found[row["bag"]].append(row)
    except (OSError, UnicodeDecodeError, csv.Error):
        raise InputError(f"{path} is no table of results: choose another place") from None
    return found


def run(
    bags: Sequence[Path], work: Work, results: Results, workers: int, on_bag: Callable[..., object]
) -> None:
    """Identify `bags` with `workers` processes and keep each as it comes.

    Parameters
    ----------
    bags : sequence of path
    work : Work
    results : Results
    workers : int
    on_bag : callable
        Called with the rows of each bag.

    Raises
    ------
    InputError
        If a process was killed, as for want of memory.
    """
    others = multiprocessing.active_children()
    # A fork would take the threads of the numerics with it.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_ignore_interrupts)
    try:
        for future in as_completed([pool.submit(identify, str(bag), work) for bag in bags]):
            rows = future.result()
            results.add(rows)
            on_bag(rows)
    except KeyboardInterrupt:
        # What they are at is not kept: nobody waits for it.
        for process in set(multiprocessing.active_children()) - set(others):
            process.terminate()
        raise
    except BrokenProcessPool:
        raise InputError(
            f"a process was killed: {results.path} has what was done before; run it again, with "
            "fewer --workers where memory is short"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
