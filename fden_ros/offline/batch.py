# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""An archive of recordings, identified on Dask: a table with a row a contact.

What a run has done is kept in a journal beside the table, a line a bag, until the table is
written. So a run that is interrupted, or whose workers die, goes on where it was, and a bag whose
content and configuration have not changed is not done again.
"""

from __future__ import annotations

import glob
import hashlib
import itertools
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros import __version__
from fden_ros.core.outputs import Output, TissueState
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.offline.rows import COLUMNS, LISTS, contact_row
from fden_ros.offline.session import Innovations
from fden_ros.parameters import Parameters
from fden_ros.recording.source import Selection
from fden_ros.tissues.library import load_library

if TYPE_CHECKING:
    from distributed import Client

#: Raise when the meaning of a row changes: earlier rows are then made anew.
_FORMAT = 3
_BAG_COLUMNS = ("bag", "content", "configuration", "error", "warnings", "seconds", "pairs")
_LOST = "lost: "
#: Bags that wait at each worker beside the one in work.
_AHEAD = 2
_HASH_BLOCK = 1 << 20
_RECORDINGS = (".mcap", ".mcap.zst", ".mcap.zstd", ".mcap.lz4")

Record = dict[str, Any]


@dataclass(frozen=True)
class Progress:
    """How far a run is."""

    done: int
    total: int
    skipped: int
    broken: int
    contacts: int


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
        text = json.dumps(
            [
                _FORMAT,
                __version__,
                self.parameters.as_dict(),
                asdict(self.selection),
                repr(library),
            ],
            sort_keys=True,
            default=str,
        )
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def find_bags(places: Iterable[str]) -> list[Path]:
    """Return the bags in folders, at paths and glob patterns, sorted, each once.

    A folder with a ``metadata.yaml`` is one bag; elsewhere each MCAP file is one.

    Raises
    ------
    InputError
        If a place holds no bag.
    """
    found: dict[Path, None] = {}
    for place in places:
        paths = [Path(place)] if os.path.exists(place) else map(Path, sorted(glob.glob(place)))
        bags = [bag for path in paths for bag in _bags_at(path)]
        if not bags:
            raise InputError(f"{place} holds no bag: give a folder of bags, or a pattern of some")
        found.update(dict.fromkeys(bag.resolve() for bag in bags))
    return sorted(found)


def _bags_at(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        # What is named is meant, whatever its name: if it is no bag, its row will say so.
        yield path
        return
    if (path / "metadata.yaml").is_file():
        yield path
        return
    for child in sorted(path.iterdir()):
        if child.name.startswith("."):
            continue
        if child.is_dir() or child.name.endswith(_RECORDINGS):
            yield from _bags_at(child)


def content_digest(bag: Path) -> str:
    """Return the digest of a bag's content: of all its files, with their names in a folder."""
    digest = hashlib.sha256()
    folder = bag.is_dir()
    for file in sorted(p for p in bag.rglob("*") if p.is_file()) if folder else [bag]:
        digest.update(
            f"{file.relative_to(bag) if folder else ''}\0{file.stat().st_size}\0".encode()
        )
        with file.open("rb") as stream:
            while block := stream.read(_HASH_BLOCK):
                digest.update(block)
    return digest.hexdigest()[:32]


def identify(bag: str, work: Work, configuration: str, known: str | None) -> Record:
    """Identify one bag; runs on a worker.

    Parameters
    ----------
    bag : str
        Path, as seen by the worker.
    work : Work
    configuration : str
        ``work.digest()``.
    known : str or None
        Content for which the answer is there already.

    Returns
    -------
    dict
        The bag's columns and ``contacts``, a list of rows; with an ``error`` where it is broken.
        With ``unchanged`` set, nothing more.
    """
    record = _empty_record(bag, configuration)
    try:
        record["content"] = content_digest(Path(bag))
        if record["content"] == known:
            return {**record, "unchanged": True}
        return record | _identify(bag, work)
    except InputError as error:
        record["error"] = str(error)
    except Exception as error:
        # One bag must not end a run of thousands, whatever is wrong with it.
        record["error"] = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return record


def _empty_record(bag: str, configuration: str) -> Record:
    return {
        "bag": bag,
        "content": "",
        "configuration": configuration,
        "error": None,
        "warnings": "",
        "seconds": None,
        "pairs": 0,
        "contacts": [],
    }


def _identify(bag: str, work: Work) -> Record:
    innovations: defaultdict[int, Innovations] = defaultdict(Innovations)
    times: list[int] = []

    def see(output: Output, frame: str) -> None:
        if isinstance(output, TissueState) and output.innovation is not None:
            innovations[output.contact_id].add(output.innovation)

    def tick(log_time_ns: int, *_: object) -> None:
        times[1:] = [log_time_ns]

    result = replay(bag, work.parameters, work.selection, on_output=see, on_input=tick)
    return {
        "contacts": [
            contact_row(summary, innovations[summary.contact_id].mean_square)
            for summary in result.summaries
        ],
        "warnings": "; ".join(result.warnings),
        "seconds": (times[-1] - times[0]) * 1e-9 if times else 0.0,
        "pairs": result.samples,
    }


class Results:
    """The table and its journal.

    Parameters
    ----------
    path : path
        The table, Parquet.

    Raises
    ------
    InputError
        If there is a table that is not of this kind, or nothing can be written there.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._journal_path = self.path.with_name(f".{self.path.name}.journal")
        self._records: dict[str, Record] = {}
        for record in (*_read_table(self.path), *_read_journal(self._journal_path)):
            self._records[record["bag"]] = record
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._journal = self._journal_path.open("a", encoding="utf-8")
            # A line that was torn must not swallow the next one; empty lines do no harm.
            self._journal.write("\n")
        except OSError as error:
            raise self._unwritable(error) from None

    def known(self, bag: str, configuration: str) -> str | None:
        """Return the content of `bag` that is done with this configuration; None without."""
        record = self._records.get(bag)
        if record is None or record["configuration"] != configuration:
            return None
        # What was lost with a worker says nothing of the bag.
        return None if (record["error"] or "").startswith(_LOST) else record["content"]

    def add(self, record: Record) -> None:
        """Keep a bag's record; it is on the disk when this returns."""
        self._records[record["bag"]] = record
        try:
            self._journal.write(json.dumps(record, allow_nan=False) + "\n")
            self._journal.flush()
            os.fsync(self._journal.fileno())
        except OSError as error:
            raise self._unwritable(error) from None

    def save(self) -> None:
        """Write the table, and do away with the journal."""
        import pyarrow.parquet

        draft = self.path.with_name(f".{self.path.name}.part")
        try:
            pyarrow.parquet.write_table(self._table(), draft)
            draft.replace(self.path)
        except OSError as error:
            draft.unlink(missing_ok=True)
            raise self._unwritable(error) from None
        self._journal.close()
        self._journal_path.unlink()

    def _table(self) -> Any:
        import pyarrow

        rows = [row for bag in sorted(self._records) for row in _rows(self._records[bag])]
        return pyarrow.Table.from_pylist(rows, schema=_schema())

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(
            f"{self.path} cannot be written ({error.strerror}): choose another place"
        )


def run(
    bags: list[Path],
    work: Work,
    results: Results,
    client: Client,
    report: Callable[[Progress], object] = lambda progress: None,
    on_broken: Callable[[str, str], object] = lambda bag, error: None,
) -> Progress:
    """Identify `bags` on the workers of `client` and keep each as it comes.

    Parameters
    ----------
    bags : list of path
        Paths that the workers see too.
    work : Work
    results : Results
    client : distributed.Client
    report : callable
        Called after each bag.
    on_broken : callable
        Called with the path and the error of each bag that cannot be used.

    Returns
    -------
    Progress
        Of the whole run.
    """
    from distributed import as_completed

    configuration = work.digest()
    waiting = iter(bags)
    paths: dict[str, str] = {}

    def submit(bag: Path) -> Any:
        path = str(bag)
        future = client.submit(
            identify, path, work, configuration, results.known(path, configuration), pure=False
        )
        paths[future.key] = path
        return future

    done = skipped = broken = contacts = 0
    ahead = max(4, _AHEAD * sum(client.nthreads().values()) + 1)
    pending = as_completed(
        [submit(bag) for bag in itertools.islice(waiting, ahead)], loop=client.loop
    )
    for future in pending:
        record = _record_of(future, paths.pop(future.key), configuration)
        future.release()
        following = next(waiting, None)
        if following is not None:
            pending.add(submit(following))
        done += 1
        if record.pop("unchanged", False):
            skipped += 1
        else:
            results.add(record)
            if record["error"] is not None:
                broken += 1
                on_broken(record["bag"], record["error"])
            contacts += len(record["contacts"])
        report(Progress(done, len(bags), skipped, broken, contacts))
    return Progress(done, len(bags), skipped, broken, contacts)


def _record_of(future: Any, bag: str, configuration: str) -> Record:
    """Return the record that a future holds, or one that says how it was lost."""
    if future.status == "finished":
        record: Record = future.result()
        return record
    error = future.exception()
    reason = f"{type(error).__name__}: {' '.join(str(error).split())}" if error else future.status
    return _empty_record(bag, configuration) | {"error": f"{_LOST}{reason}"}


def _rows(record: Record) -> Iterator[dict[str, Any]]:
    """Yield a row a contact; one without a contact for a bag that has none, or is broken."""
    head = {name: record[name] for name in _BAG_COLUMNS}
    for contact in record["contacts"] or [dict.fromkeys(COLUMNS)]:
        yield {**head, **contact}


def _schema() -> Any:
    import pyarrow

    texts = {"bag", "content", "configuration", "error", "warnings"}
    texts |= {"alpha_source", "frame", "label", *LISTS}
    integers = {"contact_id", "site", "start_ns", "end_ns", "samples", "rejected", "pairs"}
    booleans = {"converged", "complete"}

    def kind(name: str) -> Any:
        if name in texts:
            return pyarrow.string()
        if name in integers:
            return pyarrow.int64()
        return pyarrow.bool_() if name in booleans else pyarrow.float64()

    return pyarrow.schema([(name, kind(name)) for name in (*_BAG_COLUMNS, *COLUMNS)])


def _read_table(path: Path) -> Iterator[Record]:
    import pyarrow
    import pyarrow.parquet

    if not path.exists():
        return
    try:
        table = pyarrow.parquet.read_table(path)
    except (OSError, pyarrow.ArrowInvalid):
        raise InputError(f"{path} is no table of results: choose another place") from None
    if table.schema.names != list(_schema().names):
        raise InputError(f"{path} is a table of another kind: choose another place")
    records: dict[str, Record] = {}
    for row in table.to_pylist():
        head = {name: row[name] for name in _BAG_COLUMNS}
        record = records.setdefault(row["bag"], {**head, "contacts": []})
        if row["contact_id"] is not None:
            record["contacts"].append({name: row[name] for name in COLUMNS})
    yield from records.values()


def _read_journal(path: Path) -> Iterator[Record]:
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line:
            continue
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            # Written halfway: that bag is done again.
            continue
