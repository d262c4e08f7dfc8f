# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings as text tables: columns of time, force, displacement and perhaps surface."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

from fden_ros.errors import InputError

TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
BAG_SUFFIXES = (".mcap", ".db3", ".bag")

_NS = Decimal(1_000_000_000)
_DELIMITERS = ",;\t "
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
_COLUMN = re.compile(r"(?P<name>.+?)(?:\*(?P<factor>[-+]?[\d.]+(?:[eE][-+]?\d+)?))?")

#: Words of headings, and units with their factors to s, N and m.
_WORDS = {
    "time": ("time", "t", "stamp", "timestamp", "zeit"),
    "force": ("force", "f", "fz", "load", "kraft"),
    "displacement": (
        "displacement",
        "depth",
        "position",
        "indentation",
        "penetration",
        "z",
        "x",
        "pos",
        "disp",
        "stroke",
        "extension",
        "weg",
    ),
}
_UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "force": {"n": 1.0, "mn": 1e-3, "kn": 1e3, "g": 9.80665e-3, "gf": 9.80665e-3},
    "displacement": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2},
}


#: Headings of recorders that are known by name: time, force, displacement.
_RECORDERS = (
    # Universal Robots' real-time interface, in the robot's base: the tool presses downwards.
    ("timestamp", "actual_TCP_force_2", "actual_TCP_pose_2*-1"),
)


class Row(NamedTuple):
    """One row: a stamp (ns), a force [N], a displacement and the surface's place [m]."""

    stamp_ns: int
    force: float
    displacement: float
    surface: float | None = None


@dataclass(frozen=True)
class Column:
    """A column by its heading or its number from 1, and what its numbers are multiplied by."""

    name: str
    factor: Decimal = Decimal(1)

    def __str__(self) -> str:
        return self.name if self.factor == 1 else f"{self.name}*{self.factor}"


@dataclass(frozen=True)
class Columns:
    """Where a table has time, force, displacement and, if it does, the surface's place."""

    time: Column
    force: Column
    displacement: Column
    surface: Column | None = None

    def __str__(self) -> str:
        columns = (self.time, self.force, self.displacement, self.surface)
        return ",".join(str(column) for column in columns if column is not None)

    @staticmethod
    def parse(text: str) -> Columns:
        """Return the columns of a text such as ``time_s,force_N,depth_mm*1e-3``.

        Time may be ``@500``: rows at 500 Hz.

        Raises
        ------
        InputError
            If `text` is not three columns, or four with the surface's.
        """
        parts = [part.strip() for part in text.split(",")]
        matches = [_COLUMN.fullmatch(part) for part in parts]
        if len(parts) not in (3, 4) or not all(matches):
            raise InputError(
                f"{text!r} is not TIME,FORCE,DISPLACEMENT: expected headings or numbers of three "
                "columns, or four with the surface's, each with an optional factor to s, N and m, "
                "such as time_s,force_N,depth_mm*1e-3"
            )
        return Columns(*(Column(m["name"], Decimal(m["factor"] or 1)) for m in matches if m))


def guessed_columns(headings: list[str]) -> str | None:
    """Return what headings such as ``time_s,force_N,depth_mm`` make of `--columns`, or None."""
    for columns in _RECORDERS:
        if {column.partition("*")[0] for column in columns} <= set(headings):
            return ",".join(columns)
    found: dict[str, str] = {}
    for heading in headings:
        parts = [part for part in re.split(r"[^a-z0-9]+", heading.lower()) if part]
        for quantity, words in _WORDS.items():
            if quantity in found or not parts or parts[0] not in words:
                continue
            factors = [_UNITS[quantity][part] for part in parts[1:] if part in _UNITS[quantity]]
            if len(factors) != 1 or "," in heading or "*" in heading:
                continue
            found[quantity] = heading if factors[0] == 1.0 else f"{heading}*{factors[0]:g}"
            break
    return ",".join(found[quantity] for quantity in _WORDS) if len(found) == len(_WORDS) else None


def stated_columns(path: str | Path) -> Columns:
    """Return the columns that a table's headings state with their units.

    Raises
    ------
    InputError
        If they do not say what is what, or in which unit.
    """
    headings = headings_of(path)
    guess = guessed_columns(headings)
    if guess is None:
        raise InputError(
            f"{path} is a table whose headings do not say what is what: give the columns of "
            "time, force and displacement, such as --columns time_s,force_N,depth_mm*1e-3; "
            f"it has {', '.join(headings)}"
        )
    return Columns.parse(guess)


class TableReader:
    """Read a text table row by row, in the order of the file.

    Parameters
    ----------
    path : path
        Comma, semicolon, tab or blanks between the columns; decimal commas where it is none of
        these. Lines that begin with # are skipped.
    columns : Columns
    where : (str, str), optional
        Use only rows that hold this text in this column.

    Raises
    ------
    InputError
        If the file cannot be read or a column is not there.
    """

    def __init__(
        self, path: str | Path, columns: Columns, where: tuple[str, str] | None = None
    ) -> None:
        self.path = Path(path)
        self.skipped = 0
        first = _first_line(self.path)
        self._delimiter = delimiter_of(first)
        self.headings = headings_of(self.path)
        self.has_heading = not any(map(is_number, self.headings))
        self._columns = columns
        self._rate = self._rate_of(columns.time)
        self._time = self._index(columns.time.name) if self._rate is None else -1
        self._force = self._index(columns.force.name)
        self._displacement = self._index(columns.displacement.name)
        self._surface = self._index(columns.surface.name) if columns.surface else None
        self._where = (self._index(where[0]), where[1]) if where is not None else None

    @property
    def size(self) -> int:
        """Size of the file [bytes]."""
        return self.path.stat().st_size

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the rows read so far, a line each."""
        if not self.skipped:
            return ()
        return (f"{self.skipped} rows of {self.path.name} hold no number where one is needed",)

    def rows(self) -> Iterator[Row]:
        """Yield the rows; stamps are shifted to begin at 1 s where the table's begin below 0."""
        shift: int | None = None
        force_factor = float(self._columns.force.factor)
        displacement_factor = float(self._columns.displacement.factor)
        surface_factor = float(self._columns.surface.factor) if self._columns.surface else 0.0
        has_points = self._delimiter == ","
        for number, cells in enumerate(self._cells()):
            if not has_points:
                cells = [cell.replace(",", ".") for cell in cells]
            try:
                stamp_ns = self._stamp(number, cells)
                force = force_factor * float(cells[self._force])
                displacement = displacement_factor * float(cells[self._displacement])
                surface = None
                if self._surface is not None:
                    surface = surface_factor * float(cells[self._surface])
            except (ValueError, ArithmeticError, IndexError):
                self.skipped += 1
                continue
            if shift is None:
                # 0 stands for "no stamp" everywhere in ROS.
                shift = 0 if stamp_ns > 0 else 1_000_000_000 - stamp_ns
            yield Row(stamp_ns + shift, force, displacement, surface)

    def _stamp(self, number: int, cells: list[str]) -> int:
        if self._rate is not None:
            return round(number * _NS / self._rate)
        return round(Decimal(cells[self._time].strip()) * self._columns.time.factor * _NS)

    def _cells(self) -> Iterator[list[str]]:
        where = self._where
        try:
            reader = cells_of((line for _, line in lines_of(self.path)), self._delimiter)
            if self.has_heading:
                next(reader, None)
            for cells in reader:
                if where is None or (
                    where[0] < len(cells) and cells[where[0]].strip() == where[1]
                ):
                    yield cells
        except csv.Error as error:
            raise _unreadable(self.path, error) from None

    def _rate_of(self, time: Column) -> Decimal | None:
        if not time.name.startswith("@"):
            return None
        try:
            rate = Decimal(time.name[1:])
        except InvalidOperation:
            rate = Decimal(0)
        if not (rate.is_finite() and rate > 0):
            raise InputError(f"{time.name} is no rate: expected @ and rows per second, @500")
        return rate

    def _index(self, name: str) -> int:
        if self.has_heading and name in self.headings:
            return self.headings.index(name)
        if name.isdigit() and 1 <= int(name) <= len(self.headings):
            return int(name) - 1
        known = ", ".join(self.headings) if self.has_heading else "no headings"
        raise InputError(
            f"{self.path} has no column {name}: it has {known}; give headings, or numbers from 1 "
            f"to {len(self.headings)}"
        )


def looks_like_a_table(path: str | Path) -> bool:
    """Return whether `path` is a text table by its name, or else by what it begins with."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in TABLE_SUFFIXES:
        return not path.is_dir()
    return suffix not in BAG_SUFFIXES and path.is_file() and _begins_as_text(path)


def _begins_as_text(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(4096)
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(head)
    except (OSError, UnicodeDecodeError):
        return False
    return bool(text) and "\0" not in text


def headings_of(path: str | Path) -> list[str]:
    """Return the cells of a table's first row.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    first = _first_line(Path(path))
    return [cell.strip() for cell in next(cells_of([first], delimiter_of(first)), [])]


def lines_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text table with their numbers from 1, less comments and empty ones.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for number, line in enumerate(file, start=1):
                if line.strip() and not line.lstrip().startswith("#"):
                    yield number, line.rstrip("\r\n")
    except FileNotFoundError:
        raise InputError(
            f"{path} does not exist: give a table of comma-separated values"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(path, error) from None


def cells_of(lines: Iterable[str], delimiter: str) -> Iterator[list[str]]:
    """Return the rows of lines, as lists of cells."""
    if delimiter == " ":
        return (line.split() for line in lines)
    return csv.reader(lines, delimiter=delimiter)


def _first_line(path: Path) -> str:
    for _, line in lines_of(path):
        return line
    raise InputError(f"{path} is empty: expected a table of comma-separated values")


def _unreadable(path: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or "it is no text of comma-separated values"
    return InputError(f"{path} cannot be read: {reason}")


def delimiter_of(line: str) -> str:
    """Return what stands between the cells of a line."""
    if ";" in line or "\t" in line:
        line = _DECIMAL_COMMA.sub(".", line)
    for delimiter in ";\t":
        # Headings may hold blanks and commas.
        if line.count(delimiter) > 1:
            return delimiter
    return max(_DELIMITERS, key=lambda delimiter: line.strip().count(delimiter))


def is_number(cell: str) -> bool:
    """Return whether a cell is a finite number, with a point or a comma."""
    try:
        return math.isfinite(float(cell.replace(",", ".")))
    except ValueError:
        return False
