# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How a text table is written: encoding, delimiter, preamble, headings, units and numerals."""

from __future__ import annotations

import codecs
import csv
import functools
import gzip
import io
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from dateutil import parser as dates

from fden_ros.errors import InputError
from fden_ros.recording.foreign import reason_of
from fden_ros.recording.places import is_folder, is_remote, opened, place, reached
from fden_ros.recording.units import BRACKETED, is_unit

TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
_WORKBOOKS = (".xlsx", ".xls", ".ods")
BAG_SUFFIXES = (".mcap", ".db3", ".bag")

_DELIMITERS = ";\t,| "
#: Lines by which the layout is decided: a preamble, and enough rows to outvote it.
_HEAD_LINES = 400
#: As many are looked at where the first hold no rows.
_MOST_LINES = 20_000
_HEAD_BYTES = 65536
#: Cells that hold no value and say so.
_NOTHING = frozenset(("", "nan", "na", "n/a", "#n/a", "-", "--", "---", "null", "none"))

#: What lines hold that are empty; NUL where a recording ended early.
_BLANK = " \t\r\n\v\f\0"
#: Fortran writes 1.0D+03, a word processor a minus of its own.
_SPELLING = str.maketrans("dD−", "eE-", " '’\u00a0\u202f_")
_GROUP = "[ '’\u00a0\u202f.,]"
_NUMBER = re.compile(
    rf"[-−+]? ?(?=[.,]?\d)(?:\d{{1,3}}(?:{_GROUP}\d{{3}})+|\d*)(?:[.,]\d*)?(?:[eEdD][-−+]?\d+)?"
)
#: One mark with three digits behind it, as in 1,234: a decimal or one of thousands.
_EITHER = re.compile(r"[-−+]?[1-9]\d{0,2}[.,]\d{3}")
_CLOCK = re.compile(
    r"(?:(?P<date>[^\s:T]+|\S.*?\d{4})(?:T|\s+))?"
    r"(?P<first>\d{1,2}):(?P<second>\d{2}(?P<part>[.,]\d+)?)"
    r"(?::(?P<third>\d{2}(?:[.,:]\d*)?))?\s*(?P<half>[aApP])?\.?(?:[mM]\.?)?"
    r"(?:Z|[-+]\d{2}:?\d{2})?"
)
#: A cell that begins with a quotation mark and goes on in the next line, as a heading may twice.
_OPEN = re.compile(r'^(?:[^"]|"[^"]*")*(?:^|[;,\t|])\s*"[^"]*$')
_MOST_BREAKS = 3
_PARTS = re.compile(r"[\s_/,]+")
_NS = 1_000_000_000
#: From 2001 to 2096, in s since 1970.
_EPOCH = (1e9, 4e9)
_SLOWEST = 10.0
_DAY_NS = 86_400 * _NS


@dataclass(frozen=True)
class Layout:
    """How a text table is written.

    Parameters
    ----------
    path : Path
    encoding : str
    delimiter : str
        A blank stands for any number of them.
    preamble : tuple of str
        What stands before the headings, a line each.
    headings : tuple of str
        Those of the columns; empty where there are none.
    units : tuple of str
        Of a row of units below the headings; empty where there is none.
    before : int
        Number of the last line before the rows, from 1; 0: none.
    sample : tuple of tuple of str
        The first rows.
    """

    path: Path
    encoding: str
    delimiter: str
    preamble: tuple[str, ...]
    headings: tuple[str, ...]
    units: tuple[str, ...]
    before: int
    sample: tuple[tuple[str, ...], ...]
    is_halved: bool = False  #: whether decimal commas have cut every number into two cells

    @property
    def rows_above(self) -> int:
        """Lines with two values and more above the headings, as of another table."""
        return sum(_values(_split(line, self.delimiter)) >= 2 for line in self.preamble)

    @property
    def width(self) -> int:
        """Columns."""
        return max((len(self.headings), *map(len, self.sample)))

    @functools.cached_property
    def decimals(self) -> tuple[str, ...]:
        """Decimal mark of each column, a point or a comma."""
        columns = [[row[i] for row in self.sample if i < len(row)] for i in range(self.width)]
        proven = [_decimal(cells) or _beside_thousands(cells) for cells in columns]
        whole = _decimal(cell for cells in columns for cell in cells)
        whole = whole or next(filter(None, proven), None)
        each = zip(proven, columns, strict=True)
        return tuple(mark or whole or self._mark_of(cells) for mark, cells in each)

    def _mark_of(self, cells: Sequence[str]) -> str:
        """Return the mark of numbers that all look like 1,234: a decimal, but between commas."""
        has_commas = any("," in cell for cell in cells if _NUMBER.fullmatch(cell))
        return "," if has_commas and self.delimiter != "," else "."

    def cells(self, index: int) -> list[str]:
        """Return the cells of a column in the first rows, those without a value left out."""
        found = (row[index] for row in self.sample if index < len(row))
        return [cell for cell in found if cell.lower() not in _NOTHING]

    def is_clock(self, index: int) -> bool:
        """Return whether most cells of a column are times of day, or dates with them."""
        cells = self.cells(index)
        return sum(_CLOCK.fullmatch(cell) is not None for cell in cells) > 0.5 * len(cells)

    def clock_of(self, index: int) -> float | None:
        """Return the factor to s of a column of times of day, or of times since 1970, or None."""
        return 1.0 if self.is_clock(index) else self.epoch_of(index)

    def epoch_of(self, index: int) -> float | None:
        """Return the factor to s of a column of times since 1970, or None where it holds others.

        They lie in the years of :data:`_EPOCH`, rows less than :data:`_SLOWEST` apart. Whole
        numbers of that size could count ns as well, so seconds have decimals.
        """
        cells = [numeral(cell, self.decimals[index]) for cell in self.cells(index)]
        if len(cells) < 2 or not all(map(is_number, cells)):
            return None
        numbers = [float(cell) for cell in cells]
        steps = sorted(abs(b - a) for a, b in itertools.pairwise(numbers))
        step = steps[len(steps) // 2]
        for factor in (1.0, 1e-3, 1e-6, 1e-9):
            if _EPOCH[0] <= factor * min(numbers) <= factor * max(numbers) < _EPOCH[1]:
                is_whole = all(number.is_integer() for number in numbers)
                is_second = factor == 1.0
                return None if factor * step > _SLOWEST or (is_second and is_whole) else factor
        return None

    def holds_numbers(self, index: int) -> bool:
        """Return whether most cells of a column are numbers."""
        cells = self.cells(index)
        return sum(map(is_number, cells)) > 0.5 * len(cells) > 0.0

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows, each with the number of its line; comments and empty lines left out.

        Raises
        ------
        InputError
            If the file cannot be read.
        """
        numbers: list[int] = [0]

        def lines() -> Iterator[str]:
            for number, line in lines_of(self.path, self.encoding):
                if number > self.before:
                    numbers[0] = number
                    yield line

        try:
            for cells in cells_of(lines(), self.delimiter):
                yield numbers[0], _mended(cells) if self.is_halved else cells
        except csv.Error:
            raise _unreadable(self.path, "it is no text of comma-separated values") from None


def layout_of(path: str | Path, names: Iterable[str] = ()) -> Layout:
    """Return how a table is written.

    The delimiter is the one by which most cells of the first lines are values. The headings are
    the fullest line above the rows without a number in it; a comment where nothing else is.

    Parameters
    ----------
    path : path
    names : iterable of str
        Headings that the table must have: their line is that of the headings.

    Raises
    ------
    InputError
        If the file cannot be read or is empty.
    """
    path = place(path)
    encoding = _encoding(path)
    for most in (_HEAD_LINES, _MOST_LINES):
        head = _joined(islice(lines_of(path, encoding, comments=True), most))
        lines = [(number, line) for number, line in head if not is_comment(line)]
        if not lines:
            raise InputError(f"{path} is empty: expected a table of comma-separated values")
        delimiter = delimiter_of([line for _, line in lines])
        table = [_split(line, delimiter) for _, line in lines]
        first = _first_row(table)
        if first < len(table):
            break
    wanted = set(names)
    heading = _heading(table, first)
    if wanted and not (heading is not None and wanted <= set(table[heading])):
        heading = next((i for i, row in enumerate(table) if wanted <= set(row)), heading)
    units = () if heading is None else _units_below(table, heading)
    headings: tuple[str, ...] = ()
    if heading is not None:
        width = len(table[first]) if first < len(table) else 0
        headings = tuple(_headings_of(lines[heading][1], delimiter, width))
    begin = first if heading is None else heading + 1 + bool(units)
    before = lines[begin - 1][0] if begin else 0
    if heading is None:
        headings = _commented(head, lines[begin][0], table[begin], delimiter)
    rows = [tuple(row) for row in table[begin:]]
    is_halved = delimiter == "," and _are_halved(path, rows, len(headings))
    comments = [line.lstrip("# \t") for number, line in head if is_comment(line)]
    return Layout(
        path,
        encoding,
        delimiter,
        (*comments, *(line for _, line in lines[: first if heading is None else heading])),
        headings,
        units,
        before,
        tuple(tuple(_mended(row)) if is_halved else row for row in rows),
        is_halved,
    )


def looks_like_a_table(path: str | Path) -> bool:
    """Return whether `path` is a text table by its name, or else by what it begins with."""
    path = place(path)
    suffix = Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix
    if suffix.lower() in (*TABLE_SUFFIXES, *_WORKBOOKS):
        return not is_folder(path)
    if suffix.lower() in BAG_SUFFIXES or is_folder(path):
        return False
    return (is_remote(path) or path.is_file()) and _begins_as_text(path)


def _begins_as_text(path: Path) -> bool:
    try:
        head = _head(path)[:4096]
        text = codecs.getincrementaldecoder(_encoding(path))().decode(head)
    except (OSError, InputError, UnicodeDecodeError):
        return False
    return bool(text) and all(letter.isprintable() or letter.isspace() for letter in text)


def lines_of(path: Path, encoding: str, *, comments: bool = False) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text table with their numbers from 1, less comments and empty ones.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with reached(path), _opened(path) as raw:
            file = io.TextIOWrapper(raw, encoding, errors="replace")
            for number, line in enumerate(file, start=1):
                if line.strip(_BLANK) and (comments or not is_comment(line)):
                    yield number, line.rstrip("\n")
    except (OSError, EOFError) as error:
        raise _not_opened(path, error) from None


def is_comment(line: str) -> bool:
    """Return whether a line is a comment."""
    return line.lstrip().startswith("#")


def cells_of(lines: Iterable[str], delimiter: str) -> Iterator[list[str]]:
    """Return the rows of lines, as lists of cells."""
    if delimiter == " ":
        return (line.split() for line in lines)
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)


def delimiter_of(lines: Sequence[str]) -> str:
    """Return what stands between the cells of lines: by it most of them are values."""

    def votes(delimiter: str) -> tuple[float, int, int]:
        share, values = 0.0, 0
        for line in lines:
            cells = [cell for cell in _split(line, delimiter) if cell.lower() not in _NOTHING]
            found = sum(map(is_value, cells))
            if found >= 2:
                share, values = share + found / len(cells), values + found
        # Headings alone may hold blanks and commas.
        return round(share, 6), values, lines[0].strip().count(delimiter) * (delimiter != " ")

    return max(_DELIMITERS, key=votes)


def is_value(cell: str) -> bool:
    """Return whether a cell is a number or a time of day."""
    return is_number(cell) or _CLOCK.fullmatch(cell) is not None


def is_number(cell: str) -> bool:
    """Return whether a cell is a finite number, however it is written."""
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return _NUMBER.fullmatch(cell) is not None


def numeral(cell: str, decimal: str) -> str:
    """Return a number as Python writes it, without marks of thousands; "" where there is none.

    Parameters
    ----------
    cell : str
    decimal : str
        Decimal mark of its column.
    """
    if cell.strip().lower() in _NOTHING:
        return ""
    text = cell.strip().translate(_SPELLING)
    other = "," if decimal == "." else "."
    if other in text:
        whole, mark, rest = text.partition(decimal)
        if re.fullmatch(rf"[-+]?\d{{1,3}}(?:\{other}\d{{3}})+", whole):
            text = whole.replace(other, "") + mark + rest
    return text.replace(",", ".")


def clock_ns(cell: str) -> tuple[str | None, int]:
    """Return the date as it is written (None where it is not) and the time of that day [ns].

    Raises
    ------
    ValueError
        If it is none.
    """
    match = _CLOCK.fullmatch(cell.strip())
    if match is None:
        raise ValueError(cell)
    first, second = int(match["first"]), match["second"].replace(",", ".")
    if match["part"] is not None:
        hours, minutes, seconds = 0, first, Decimal(second)
    else:
        hours, minutes = first, int(second)
        seconds = _seconds(match["third"] or "0")
    if match["half"] is not None:
        hours = hours % 12 + 12 * (match["half"] in "pP")
    return match["date"], (hours * 3600 + minutes * 60) * _NS + int(seconds * _NS)


def _seconds(text: str) -> Decimal:
    """Return seconds; behind a colon stand ms, as a number that may lack its zeros."""
    whole, colon, rest = text.partition(":")
    if colon and len(rest) <= 3:
        return Decimal(whole) + Decimal(int(rest or "0")) / 1000
    return Decimal(re.sub("[,:]", ".", text))


class _Months(dates.parserinfo):
    """Names of months in English, German, French, Italian and Spanish."""

    MONTHS = [  # noqa: RUF012 (as its class has it)
        ("jan", "january", "januar", "jän", "jänner", "janv", "janvier", "gen", "gennaio",
         "ene", "enero"),
        ("feb", "february", "februar", "févr", "février", "febbraio", "febrero"),
        ("mar", "march", "mär", "märz", "mrz", "mars", "marzo"),
        ("apr", "april", "avr", "avril", "aprile", "abr", "abril"),
        ("may", "mai", "mag", "maggio", "mayo"),
        ("jun", "june", "juni", "juin", "giu", "giugno", "junio"),
        ("jul", "july", "juli", "juil", "juillet", "lug", "luglio", "julio"),
        ("aug", "august", "août", "ago", "agosto"),
        ("sep", "sept", "september", "septembre", "set", "settembre", "septiembre"),
        ("oct", "october", "okt", "oktober", "octobre", "ott", "ottobre", "octubre"),
        ("nov", "november", "novembre", "noviembre"),
        ("dec", "december", "dez", "dezember", "déc", "décembre", "dic", "dicembre",
         "diciembre"),
    ]  # fmt: skip


@functools.lru_cache(maxsize=64)
def _day(text: str, has_day_first: bool) -> int:
    """Return a date as its number of days since 1970."""
    date = dates.parse(text, _Months(), dayfirst=has_day_first)
    return (date - datetime(1970, 1, 1)).days


class Calendar:
    """The days of dates in the order of rows.

    Whether the day or the month comes first is not known: what is true makes the smaller step.
    """

    def __init__(self) -> None:
        self._text = ""
        self._day = 0

    def day_of(self, text: str) -> int:
        """Return the number of the day since 1970; one with points begins with the day."""
        if text == self._text:
            return self._day
        orders = (True,) if "." in text else (False, True)
        if self._text:
            steps = [_day(text, order) - _day(self._text, order) for order in orders]
            self._day += min(steps, key=abs)
        else:
            self._day = _day(text, orders[0])
        self._text = text
        return self._day


def stamp_of_clock(day: int | None, time_ns: int, last: int | None) -> int:
    """Return a stamp [ns] from a time of day: without a date the day after follows midnight."""
    if day is not None:
        return day * _DAY_NS + time_ns
    if last is None:
        return time_ns
    stamp = last - last % _DAY_NS + time_ns
    return stamp + _DAY_NS if stamp < last - _DAY_NS // 2 else stamp


def _decimal(cells: Iterable[str]) -> str | None:
    """Return the decimal mark that numbers prove, or None where none of them does."""
    votes = dict.fromkeys(".,", 0)
    for cell in cells:
        marks = [letter for letter in cell if letter in ".,"]
        if not marks or not _NUMBER.fullmatch(cell) or _EITHER.fullmatch(cell):
            continue
        if len(marks) > 1 and len(set(marks)) == 1:
            votes["," if marks[0] == "." else "."] += 1
        else:
            votes[marks[-1]] += 1
    if votes["."] == votes[","]:
        return None
    return max(votes, key=lambda mark: votes[mark])


def _beside_thousands(cells: Iterable[str]) -> str | None:
    """Return the decimal mark of whole numbers, of which those above 999 look like 1.020 or 1,020.

    What writes the last 0 of a decimal would write 980 as 980.000.
    """
    marked = [cell for cell in cells if _EITHER.fullmatch(cell)]
    whole = any(cell.strip("+-−").isdigit() and cell.strip("+-−0") for cell in cells)
    if not (whole and any(cell.endswith("0") for cell in marked)):
        return None
    return "," if "." in marked[0] else "."


def _split(line: str, delimiter: str) -> list[str]:
    try:
        # A line by itself: in a preamble a quotation mark may stand for inches.
        return [cell.strip() for cell in next(cells_of([line], delimiter), [])]
    except csv.Error:
        return [line]


def _joined(lines: Iterable[tuple[int, str]]) -> list[tuple[int, str]]:
    """Return lines, a cell in quotation marks that goes on below in one, numbered as the last."""
    found: list[tuple[int, str]] = []
    begin = 0
    for number, line in lines:
        found.append((number, line))
        text = " ".join(part for _, part in found[begin:])
        if not _OPEN.search(text):
            found[begin:] = [(number, text)]
        elif len(found) - begin <= _MOST_BREAKS:
            continue
        begin = len(found)
    return found


def _headings_of(line: str, delimiter: str, width: int) -> list[str]:
    """Return the headings of a line; as many as there are columns, where blanks stand between.

    Headings may hold blanks themselves, "Load (N)", or stand between other marks than the rows.
    """
    cells = _split(line, delimiter)
    if delimiter != " " or len(cells) == width:
        return cells
    text = line.strip()
    others = (re.split(r"\s{2,}|\t", text), re.split(r"\s+(?![(\[{<])", text))
    marked = (_split(text, mark) for mark in _DELIMITERS.strip())
    return next((made for made in (*others, *marked) if len(made) == width), cells)


def _values(row: Sequence[str]) -> int:
    return sum(map(is_value, row))


def _filled(row: Sequence[str]) -> int:
    return sum(map(bool, row))


def _first_row(table: Sequence[Sequence[str]]) -> int:
    """Return the index of the first row with two values that another such row follows.

    It is one of the part that has most such rows, where results or settings stand above it.
    """
    has_values = [_values(row) >= 2 for row in table]
    seen: list[Sequence[str]] = []
    begins = [0]
    for index, row in enumerate(table):
        if not has_values[index] and _begins_a_part(row) and row not in seen:
            begins.append(index)
            seen.append(row)
    parts = [range(*part) for part in itertools.pairwise((*begins, len(table)))]
    best = max(parts, key=lambda part: sum(has_values[i] for i in part))
    rows = [index for index in best if has_values[index]]
    following = [i for i in rows if all(has_values[i + 1 : i + 2])]
    return next(iter(following or rows), len(table))


def _begins_a_part(row: Sequence[str]) -> bool:
    """Return whether a row is that of headings or units of a part of the table.

    LabVIEW ends each part of its preamble with stars.
    """
    return row[0].startswith("***") or states_units(row)


def states_units(row: Sequence[str]) -> bool:
    """Return whether a row holds no values, but headings with their units, or a row of units."""
    return not _values(row) and sum(map(_states_a_unit, row)) >= 2


def _states_a_unit(cell: str) -> bool:
    brackets = BRACKETED.findall(cell)
    said = brackets or _PARTS.split(cell)[-1:]
    return any(is_unit(text) and not text.isdigit() for text in said)


def _heading(table: Sequence[Sequence[str]], first: int) -> int | None:
    """Return the index of the headings: of what is above the rows the fullest, and the last."""
    if first == len(table):
        return 0
    above = [i for i in range(first) if _filled(table[i]) >= 2 and not _values(table[i])]
    named = [i for i in above if not _is_of_units(table[i])] or above
    return max(named, key=lambda i: (_filled(table[i]), i), default=None)


def _units_below(table: Sequence[Sequence[str]], heading: int) -> tuple[str, ...]:
    below = table[heading + 1 : heading + 2]
    return tuple(below[0]) if below and _is_of_units(below[0]) else ()


def _is_of_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: two that are known, and no long words."""
    return sum(map(is_unit, row)) >= 2 and all(len(cell) <= 12 for cell in row)


def _are_halved(path: Path, rows: Sequence[Sequence[str]], count: int) -> bool:
    """Return whether decimal commas have cut every number of `count` columns into two cells.

    Raises
    ------
    InputError
        If they have cut some.
    """
    if not count or not rows or any("." in cell or not cell for row in rows for cell in row):
        return False
    whole = [_values(row) == len(row) for row in rows]
    if not all(whole) or any(len(row) <= count for row in rows):
        return False
    if all(len(row) == 2 * count for row in rows):
        return True
    raise InputError(
        f"{path}: decimal commas look like the commas between its columns: write "
        "semicolons between them, or quotation marks about the numbers"
    )


def _mended(cells: Sequence[str]) -> list[str]:
    """Return numbers whose decimal commas have cut them into two cells each."""
    return [f"{whole},{rest}" for whole, rest in zip(cells[::2], cells[1::2], strict=False)]


def _commented(
    head: Sequence[tuple[int, str]], end: int, row: Sequence[str], delimiter: str
) -> tuple[str, ...]:
    """Return the last comment before the line `end` that has a heading for each cell of `row`."""
    for number, line in reversed(head):
        if number < end and is_comment(line):
            cells = _headings_of(line.lstrip("# \t"), delimiter, len(row))
            if len(cells) == len(row) and not _values(cells):
                return tuple(cells)
    return ()


def _encoding(path: Path) -> str:
    """Return the encoding of a text file: UTF-8, UTF-16, or else that of Western Windows.

    Raises
    ------
    InputError
        If the file cannot be read, or is no text.
    """
    try:
        head = _head(path)
    except (OSError, EOFError) as error:
        raise _not_opened(path, error) from None
    if path.suffix.lower() in _WORKBOOKS:
        raise _unreadable(path, "it is a workbook: save its sheet as CSV")
    if reason := reason_of(head):
        raise _unreadable(path, reason)
    # What was set aside for a recording that ended early.
    head = head.rstrip(b"\0")
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    pairs = max(len(head) // 2, 1)
    # Letters and digits have a zero in UTF-16, and nothing else has.
    if head[1::2].count(0) > 0.5 * pairs:
        return "utf-16-le"
    if head[::2].count(0) > 0.5 * pairs:
        return "utf-16-be"
    if b"\0" in head:
        raise _unreadable(path, "it is no text of comma-separated values")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _head(path: Path) -> bytes:
    with reached(path), _opened(path) as file:
        return file.read(_HEAD_BYTES)


def _opened(path: Path) -> BinaryIO | gzip.GzipFile:
    if path.suffix.lower() != ".gz":
        return opened(path)
    return gzip.GzipFile(fileobj=opened(path)) if is_remote(path) else gzip.GzipFile(path)


def _not_opened(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{path} does not exist: give a table of comma-separated values")
    return _unreadable(path, getattr(error, "strerror", None) or "it is no complete gzip file")


def _unreadable(path: Path, reason: str) -> InputError:
    return InputError(f"{path} cannot be read: {reason}")
