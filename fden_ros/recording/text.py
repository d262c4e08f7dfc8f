# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The layout of a text table: encoding, delimiter, preamble, headings, units and decimal sign.

An unreadable part is named with its line. Only blank lines, comments and
lines below the last row are left out.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import itertools
import math
import re
import zlib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.foreign import reason_of
from fden_ros.recording.headings import BRACKETED, Heading, is_unit
from fden_ros.recording.places import is_folder, is_remote, opened, place, reached

TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
_WORKBOOKS = (".xlsx", ".xls", ".ods")
BAG_SUFFIXES = (".mcap", ".db3", ".bag")

_DELIMITERS = ";\t,| "
#: Lines that decide the layout, and the next number where the first hold no rows.
_HEAD_LINES, _MOST_LINES = 400, 20_000
#: More rows than this above the headings are no results or settings, but rows of the table.
_RESULTS = 10
#: Cells that state that they hold no value.
_NOTHING = frozenset(("", "nan", "na", "n/a", "#n/a", "-", "--", "---", "null", "none"))
_BLANK = " \t\r\n\v\f\0;,|"
_NUMBER = re.compile(r"[-+]?(?=[.,]?\d)\d*(?:[.,]\d{3})*(?:[.,]\d*)?(?:[eE][-+]?\d+)?")
#: 1,234: a decimal number, or one with a thousands separator.
_EITHER = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
_THOUSANDS = {mark: re.compile(rf"[-+]?\d{{1,3}}(?:\{mark}\d{{3}})+(?:[.,]\d*)?") for mark in ".,"}
#: A date or a time of day as ISO 8601 writes them.
_CLOCK = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d[T ])?(?P<time>\d{1,2}:\d\d:\d\d(?:[.,]\d+)?)(?:Z|[-+]\d\d:?\d\d)?"
)
_SHOWN = 60

Line = tuple[int, str]


@dataclass(frozen=True)
class Layout:
    """How a text table is written, and its lines."""

    path: Path
    delimiter: str  #: a blank stands for any number of them
    decimal: str  #: a point or a comma
    preamble: tuple[str, ...]  #: the lines before the headings
    #: Of every column, with the unit of a row below; without text where it has none.
    headings: tuple[Heading, ...]
    lines: tuple[Line, ...]  #: the rows with their numbers from 1, no comments, no blank lines
    sample: tuple[tuple[str, ...], ...]  #: cells of the first rows

    @property
    def names(self) -> str:
        """The headings in one line; empty where there are none."""
        return ", ".join(heading.text for heading in self.headings if heading.text)

    def places(self, name: str) -> list[int]:
        """Return the indices of the columns with that heading."""
        return [index for index, heading in enumerate(self.headings) if heading.text == name]

    def cells(self, index: int) -> list[str]:
        """Return the cells of a column in the first rows, without those that hold no value."""
        found = (row[index] for row in self.sample if index < len(row))
        return [cell for cell in found if cell.lower() not in _NOTHING]

    def is_clock(self, index: int) -> bool:
        """Return whether the cells of a column are ISO dates or times of day."""
        cells = self.cells(index)
        return sum(map(is_clock, cells)) > 0.5 * len(cells)

    def holds_numbers(self, index: int) -> bool:
        """Return whether most cells of a column are numbers."""
        cells = self.cells(index)
        return sum(map(is_number, cells)) > 0.5 * len(cells) > 0.0

    def split(self, line: str) -> list[str]:
        """Return the cells of a line."""
        return _split(line, self.delimiter)

    def number(self, cell: str) -> float:
        """Return the number in a cell, NaN where it states that it has none.

        Raises
        ------
        ValueError
            If it holds something else.
        """
        text = cell.strip()
        if not text[-1:].isdigit() and text.lower() in _NOTHING:
            return math.nan
        mark = "," if self.decimal == "." else "."
        if mark in text:
            if not _THOUSANDS[mark].fullmatch(text):
                raise ValueError(cell)
            text = text.replace(mark, "")
        value = float(text.replace(",", "."))
        if not math.isfinite(value):
            raise ValueError(cell)
        return value

    def numbers(
        self, columns: Sequence[int], lines: Sequence[Line] | None = None, clock: int | None = None
    ) -> tuple[Array, Sequence[Line], str]:
        """Return the numbers of some columns, shape (n, k), their lines, and what is left out.

        A cell that states that it has no number is NaN.

        Parameters
        ----------
        columns : sequence of int
        lines : sequence of (int, str), optional
            The lines to read; all when None.
        clock : int, optional
            Column of dates or times of day, whose cells also end the rows.
        """
        lines, left_out = self.lines if lines is None else lines, ""
        values: list[list[float]] = []
        for _, line in lines:
            row = self._row(self.split(line), columns, clock)
            if row is None:
                wanted = [*columns, *([] if clock is None else [clock])]
                left_out = self._end(lines[len(values) :], wanted, clock)
                break
            values.append(row)
        found = np.array(values, dtype=float).reshape(len(values), len(columns))
        return found, lines[: len(values)], left_out

    def times_of_day(self, column: int, lines: Sequence[Line]) -> Any:
        """Return ISO dates or times of day as ns, shape (n,); after midnight is the next day."""
        found = []
        for number, line in lines:
            match = _CLOCK.fullmatch(self.split(line)[column])
            if match is None:
                raise self._no_number(number, line, [column])
            date = (match["date"] or "1970-01-01T").replace(" ", "T")
            time = match["time"].replace(",", ".")
            found.append(date + time.rjust(len(time) + (time[1] == ":"), "0"))
        try:
            stamps = np.array(found, dtype="datetime64[ns]").astype(np.int64)
        except ValueError as error:
            raise InputError(f"{self.path} holds no date or time: {error}") from None
        day = 86_400_000_000_000
        return stamps + day * np.cumsum(np.diff(stamps, prepend=stamps[:1]) < -day // 2)

    def _row(
        self, cells: Sequence[str], columns: Sequence[int], clock: int | None
    ) -> list[float] | None:
        """Return a number for each column; None where a cell holds something else."""
        try:
            if clock is None or is_clock(cells[clock]):
                return [self.number(cells[column]) for column in columns]
        except (ValueError, IndexError):
            pass
        return None

    def _end(self, lines: Sequence[Line], wanted: Sequence[int], clock: int | None) -> str:
        """Return the lines from the end of the table on, if the first of them is no row."""
        (number, line), *below = lines
        cells = self.split(line)
        named = [cells[column].lower() for column in wanted if column < len(cells)]
        is_text = not any(is_number(c) or is_clock(c) or c in _NOTHING for c in named)
        heads = (cells, *(self.split(text) for _, text in below[:1]))
        own = [[one.text for one in self.headings], [one.unit for one in self.headings]]
        is_other = any(states_units(row) and row not in own for row in heads)
        columns = [column for column in wanted if column != clock]
        goes_on = any(self._row(self.split(text), columns, clock) for _, text in below)
        if below and not (is_text and (is_other or not goes_on)):
            raise self._no_number(number, line, wanted)
        shown = ", ".join(filter(None, cells))[:_SHOWN]
        return (
            f"{self.path.name} ends at line {number} ({shown}): {len(lines)} "
            f"{'lines are' if below else 'line is'} left out from there on"
        )

    def _no_number(self, number: int, line: str, wanted: Iterable[int]) -> InputError:
        return InputError(
            f"{self.path}, line {number}: {line.strip()[:_SHOWN]!r} has no number in column "
            f"{' or '.join(str(column + 1) for column in wanted)}: correct the line, leave the "
            "cell empty, or make it a comment (#)"
        )


def layout_of(path: str | Path, names: Iterable[str] = ()) -> Layout:
    """Return the layout of a table; a line with all `names` is that of the headings."""
    path = place(path)
    numbered = enumerate(re.split("\r\n|\r|\n", _text(path)), start=1)
    lines = [(number, line) for number, line in numbered if line.strip(_BLANK)]
    comments = [line.lstrip("# \t") for _, line in lines if line.lstrip().startswith("#")]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if not lines:
        raise InputError(f"{path} is empty: expected a table of comma-separated values")
    for most in (_HEAD_LINES, _MOST_LINES):
        delimiter = _delimiter([line for _, line in lines[:most]])
        table = [_split(line, delimiter) for _, line in lines[:most]]
        first = _first_row(table)
        if first < len(table):
            break
    heading = _heading(table, first, set(names))
    headings, units, begin = [], [], first
    width = len(table[first]) if first < len(table) else 0
    if heading is not None:
        headings = _headings_of(lines[heading][1], delimiter, width)
        begin = heading + 1
        if begin < len(table) and _is_of_units(table[begin]):
            units, begin = table[begin], begin + 1
        _check_above(path, lines[heading], table[:heading], width, _RESULTS)
    elif first < len(table):
        _check_above(path, lines[first], table[:first], width, 0)
    sample = tuple(map(tuple, table[begin:]))
    top = lines[begin - 1][0] if begin else 0
    preamble = [line for _, line in lines[: begin if heading is None else heading]]
    most = max((sum(map(bool, row)) for row in sample), default=0)
    if headings and most > len(headings):
        raise InputError(
            f"{path} has rows of {most} cells below {len(headings)} headings: name every column; "
            "with decimal commas, separate cells by semicolons"
        )
    columns = range(max((len(headings), *map(len, sample))))
    return Layout(
        path,
        delimiter,
        _decimal(path, sample, delimiter),
        (*comments, *preamble),
        tuple(Heading(*("".join(row[i : i + 1]) for row in (headings, units))) for i in columns),
        tuple(line for line in lines if line[0] > top),
        sample,
    )


def looks_like_a_table(path: str | Path) -> bool:
    """Return whether `path` is a text table by its name, otherwise by its first bytes."""
    path = place(path)
    suffix = Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix
    if suffix.lower() in (*TABLE_SUFFIXES, *_WORKBOOKS):
        return not is_folder(path)
    if suffix.lower() in BAG_SUFFIXES or is_folder(path):
        return False
    try:
        text = _decoded(path, _bytes(path, 4096)) if is_remote(path) or path.is_file() else ""
    except InputError:
        return False
    return bool(text) and all(letter.isprintable() or letter.isspace() for letter in text)


def is_clock(cell: str) -> bool:
    """Return whether a cell is a date or a time of day as ISO 8601 writes them."""
    return _CLOCK.fullmatch(cell) is not None


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with a decimal point or comma."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def states_units(row: Sequence[str]) -> bool:
    """Return whether a row holds no values, but headings with their units, or a row of units."""
    return not _values(row) and sum(map(_states_a_unit, row)) >= 2


def _states_a_unit(cell: str) -> bool:
    said = BRACKETED.findall(cell) or re.split(r"[\s_/,]+", cell)[-1:]
    return any(is_unit(text) and not text.isdigit() for text in said)


def _delimiter(lines: Sequence[str]) -> str:
    """Return the delimiter with which most cells of the lines are values."""

    def votes(delimiter: str) -> tuple[float, int, int]:
        share, values = 0.0, 0
        for line in lines:
            cells = [cell for cell in _split(line, delimiter) if cell.lower() not in _NOTHING]
            found = _values(cells)
            if found >= 2:
                share, values = share + found / len(cells), values + found
        # Headings alone may hold blanks and commas.
        return round(share, 6), values, lines[0].strip().count(delimiter) * (delimiter != " ")

    return max(_DELIMITERS, key=votes)


def _decimal(path: Path, sample: Sequence[Sequence[str]], delimiter: str) -> str:
    """Return the decimal sign that the numbers of the first rows prove."""
    marked = [c for row in sample for c in row if is_number(c) and not c.isdigit()]
    marked = [cell for cell in marked if "." in cell or "," in cell]
    for cell in marked:
        marks = re.findall("[.,]", cell)
        if len(marks) > 1 and len(set(marks)) == 1:
            return "," if marks[0] == "." else "."
        if len(marks) > 1 or not _EITHER.fullmatch(cell):
            return str(marks[-1])
    commas = [cell for cell in marked if "," in cell]
    for column in itertools.zip_longest(*sample, fillvalue=""):
        either = [cell for cell in column if _EITHER.fullmatch(cell)]
        has_whole = any(cell.isdigit() and int(cell) for cell in column)
        if either and (has_whole or (delimiter == "," and "," in either[0])):
            raise InputError(
                f"{path}: {either[0]!r} may have a thousands separator or a decimal sign: write "
                "numbers with decimal points and without thousands separators"
            )
    return "," if commas else "."


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        # Line by line: in a preamble a quotation mark may stand for inches.
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return [line]
    return [cell.strip() for cell in cells]


def _values(row: Sequence[str]) -> int:
    return sum(is_number(cell) or is_clock(cell) for cell in row)


def _first_row(table: Sequence[Sequence[str]]) -> int:
    """Return the index of the first row of the longest run of rows with two values and more."""
    runs: list[tuple[int, int]] = []
    for is_row, run in itertools.groupby(enumerate(table), lambda one: _has_values(one[1])):
        indices = [index for index, _ in run]
        if is_row:
            runs.append((len(indices), -indices[0]))
    return -max(runs)[1] if runs else len(table)


def _has_values(cells: Sequence[str]) -> bool:
    values, filled = _values(cells), sum(cell.lower() not in _NOTHING for cell in cells)
    return values >= 2 or (values == 1 == filled and len(cells) > 1)


def _heading(table: Sequence[Sequence[str]], first: int, names: Collection[str]) -> int | None:
    """Return the index of the headings: of the three lines above the rows the fullest, the last.

    It is the line with all `names` where there is one.
    """
    if names:
        named = [i for i, row in enumerate(table) if set(names) <= set(row)]
        if named:
            return max((i for i in named if i < first), default=named[0])
    if first == len(table):
        return 0
    above = range(max(first - 3, 0), first)
    filled = {i: sum(map(bool, table[i])) for i in above if not _values(table[i])}
    some = [i for i in filled if filled[i] >= 2 and not _is_of_units(table[i])]
    return max(some, key=lambda i: (filled[i], i), default=None)


def _is_of_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: two that are known, and more of them than others."""
    units = sum(map(is_unit, row))
    return units >= 2 and 2 * units > sum(map(bool, row))


def _headings_of(line: str, delimiter: str, width: int) -> list[str]:
    """Return the headings of a line, one per column if blanks separate them."""
    cells = _split(line, delimiter)
    if delimiter != " " or len(cells) == width:
        return cells
    text = line.strip()
    splits = [re.split(r"\s{2,}|\t", text), re.split(r"\s+(?![(\[{<])", text), text.split(",")]
    return next((made for made in splits if len(made) == width), cells)


def _check_above(
    path: Path, line: Line, above: Iterable[Sequence[str]], width: int, most: int
) -> None:
    count = sum(_has_values(row) and len(row) == width for row in above)
    if count > most:
        raise InputError(
            f"{path}: {count} rows of numbers are above line {line[0]} "
            f"({line[1].strip()[:_SHOWN]!r}), apart from the others: remove what is between them"
        )


def _text(path: Path) -> str:
    content = _bytes(path)
    if path.suffix.lower() in _WORKBOOKS:
        raise _unreadable(path, "it is a workbook: save its sheet as CSV")
    return _decoded(path, content)


def _decoded(path: Path, data: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16 with its mark, or that of Western Windows."""
    if reason := reason_of(data):
        raise _unreadable(path, reason)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    # The rest belongs to a recording that ended early.
    data = data.rstrip(b"\0")
    if b"\0" in data:
        raise _unreadable(path, "it is not a text file of comma-separated values")
    try:
        return codecs.getincrementaldecoder("utf-8-sig")().decode(data)
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _bytes(path: Path, most: int = -1) -> bytes:
    try:
        with reached(path), _opened(path) as file:
            data: bytes = file.read(most)
            return data
    except FileNotFoundError:
        raise InputError(
            f"{path} does not exist: give a table of comma-separated values"
        ) from None
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or "it is not a complete gzip file"
        raise _unreadable(path, reason) from None


def _opened(path: Path) -> Any:
    if path.suffix.lower() != ".gz":
        return opened(path)
    return gzip.GzipFile(fileobj=opened(path)) if is_remote(path) else gzip.GzipFile(path)


def _unreadable(path: Path, reason: str) -> InputError:
    return InputError(f"{path} cannot be read: {reason}")
