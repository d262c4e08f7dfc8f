# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings as text tables: columns of time, force and displacement."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

from fden_ros.core.streams import NumberOrVector, Quaternion, Vector, by_rotation_vector
from fden_ros.errors import InputError
from fden_ros.recording.headings import (
    RECORDERS,
    Heading,
    candidates,
    is_in_tool,
    nanoseconds_beside,
    parts_of,
    rivals,
)
from fden_ros.recording.places import place
from fden_ros.recording.text import (
    Calendar,
    Layout,
    clock_ns,
    is_number,
    layout_of,
    numeral,
    stamp_of_clock,
    states_units,
)

_NS = Decimal(1_000_000_000)
_COLUMN = re.compile(r"(?P<name>.+?)(?:\*(?P<factor>[-+]?[\d.]+(?:[eE][-+]?\d+)?))?")
_QUANTITIES = ("time", "force", "displacement")
#: Letters of a cell or a row that a message shows.
_SHOWN = 60
#: Rows of numbers above the headings that may be results or settings.
_RESULTS = 10
#: More rows than this part have the time of the row before where a clock is too coarse.
_REPEATED = 0.2


class Row(NamedTuple):
    """One row: a stamp (ns), a force [N] and a displacement [m].

    None where the row has nothing of it. Force and displacement are numbers or vectors.
    """

    stamp_ns: int
    force: NumberOrVector | None
    displacement: NumberOrVector | None
    turn: Quaternion | None = None  #: of the tool, where the displacement is a pose


@dataclass(frozen=True)
class Column:
    """A column by its heading or its number from 1.

    Parameters
    ----------
    name : str
    factor : Decimal, optional
        What its numbers are multiplied by; None: as the unit in its heading says.
    """

    name: str
    factor: Decimal | None = None

    def __str__(self) -> str:
        name = f'"{self.name}"' if "," in self.name else self.name
        return name if self.factor is None else f"{name}*{self.factor}"


@dataclass(frozen=True)
class Columns:
    """Where a table has time, force and displacement."""

    time: Column
    force: Column
    displacement: Column

    def __str__(self) -> str:
        return ",".join(str(column) for column in self.each)

    @property
    def each(self) -> list[Column]:
        """All of them."""
        return [self.time, self.force, self.displacement]

    @property
    def headings(self) -> list[str]:
        """Names that can only be headings."""
        names = [column.name for column in self.each]
        return [name for name in names if not (name.isdigit() or name.startswith("@"))]

    @staticmethod
    def parse(text: str) -> Columns:
        """Return the columns of a text such as ``time_s,force_N,depth_mm*1e-3``.

        Time may be ``@500``: rows at 500 Hz. A heading with a comma stands in quotation marks.

        Raises
        ------
        InputError
            If `text` is not three columns.
        """
        parts = [part.strip() for part in next(csv.reader([text], skipinitialspace=True), [])]
        matches = [_COLUMN.fullmatch(part) for part in parts]
        if len(parts) != 3 or not all(matches):
            raise InputError(
                f"{text!r} is not TIME,FORCE,DISPLACEMENT: expected headings or numbers of three "
                "columns, each with an optional factor to s, N and m, such as "
                "time_s,force_N,depth_mm*1e-3"
            )
        return Columns(
            *(
                Column(m["name"], Decimal(m["factor"]) if m["factor"] else None)
                for m in matches
                if m
            )
        )


def stated_columns(path: str | Path) -> Columns:
    """Return the columns that a table's headings state with their units.

    Raises
    ------
    InputError
        If they do not say what is what, or in which unit, or several fit.
    """
    layout = layout_of(path)
    headings = _headings(layout)
    names = [heading.text for heading in headings]
    for columns in RECORDERS:
        if all(name in names or parts_of(name, names)[0] for name in _bare(columns)):
            return Columns.parse(",".join(columns))
    found = {
        quantity: candidates(headings, quantity, layout.holds_numbers, layout.clock_of)
        for quantity in _QUANTITIES
    }
    for quantity, fitting in found.items():
        better = rivals(headings, quantity, [i for i, _ in fitting], layout.holds_numbers)
        # Asked for: the unit is that of the neighbour, in what is proposed alone.
        fitting[:0] = [(index, fitting[0][1]) for index in better]
    several = [quantity for quantity, fitting in found.items() if len(fitting) > 1]
    missing = [quantity for quantity, fitting in found.items() if not fitting]
    if not layout.sample:
        raise InputError(f"{path} has no rows of numbers below {', '.join(names)}")
    if missing:
        raise InputError(
            f"{path} is a table whose headings do not say, with a unit, which column is the "
            f"{' and the '.join(missing)}: give the columns of time, force and displacement, "
            f"such as --columns {_example(layout, headings, found)}. "
            f"It has {', '.join(names) or 'no headings'}{_without_numbers(layout, headings)}"
        )
    chosen = Columns(*(_column(headings, *fitting[0]) for fitting in found.values()))
    if several:
        listed = "; ".join(
            f"the {quantity}: {', '.join(_shown(headings, index) for index, _ in found[quantity])}"
            for quantity in several
        )
        raise InputError(
            f"{path}: several columns could be {listed}; name the columns, such as "
            f"--columns '{chosen}'"
        )
    return chosen


def _example(
    layout: Layout, headings: Sequence[Heading], found: Mapping[str, list[tuple[int, float]]]
) -> str:
    """Return columns as they could be given: those found, and what their words speak for."""
    chosen = {
        quantity: _column(headings, *fitting[0]) for quantity, fitting in found.items() if fitting
    }
    for quantity in set(found) - set(chosen):
        named = (i for i, heading in enumerate(headings) if heading.names(quantity))
        index = next(filter(layout.holds_numbers, named), None)
        if index is not None:
            chosen[quantity] = Column(f"{_name(headings, index)}*FACTOR")
    if not chosen:
        return "time_s,force_N,depth_mm*1e-3"
    made = ",".join(str(chosen.get(quantity, quantity.upper())) for quantity in found)
    return f"'{made}'" + (", with each FACTOR to s, N and m" if "*FACTOR" in made else "")


def _without_numbers(layout: Layout, headings: Sequence[Heading]) -> str:
    """Return that a column is named with its unit, but holds no numbers, with one of its cells."""
    for index, heading in enumerate(headings):
        cells = layout.cells(index)
        if cells and not layout.holds_numbers(index):
            for quantity in _QUANTITIES:
                if heading.names(quantity) and layout.clock_of(index) is None:
                    cell = next(cell for cell in cells if not is_number(cell))
                    return f"; {heading.text} holds {cell[:_SHOWN]!r}, which is no number"
    return ""


def _bare(columns: Sequence[str]) -> list[str]:
    return [column.partition("*")[0] for column in columns]


def _headings(layout: Layout) -> list[Heading]:
    units = (*layout.units, *[""] * len(layout.headings))
    return [Heading(*one) for one in zip(layout.headings, units, strict=False)]


def _name(headings: Sequence[Heading], index: int) -> str:
    """Return a heading, or the column's number where the heading is no name for `--columns`."""
    text = headings[index].text
    is_one = [heading.text for heading in headings].count(text) == 1
    return text if is_one and not set("*\"'") & set(text) else str(index + 1)


def _shown(headings: Sequence[Heading], index: int) -> str:
    said = _name(headings, index)
    return f"{said} (no unit stated)" if headings[index].is_silent else said


def _column(headings: Sequence[Heading], index: int, factor: float) -> Column:
    return Column(_name(headings, index), None if factor == 1.0 else Decimal(f"{factor:.12g}"))


class TableReader:
    """Read a text table row by row, in the order of the file.

    Parameters
    ----------
    path : path
        As :func:`~fden_ros.recording.text.layout_of` finds it written: what stands before the
        headings, a row of units and comments are left out.
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
        self.path = place(path)
        self.skipped = 0
        self._first_skipped = ""
        self._repeated = self._rows = 0
        #: Rows between the first and the last change of the time, and what lies between these.
        self._timed = self._span_ns = 0
        self._left_out = ""
        self.layout = layout_of(self.path, columns.headings)
        self._columns = columns
        self._rate = self._rate_of(columns.time)
        self._time = self._index(columns.time.name) if self._rate is None else -1
        self._nanoseconds = nanoseconds_beside(self._time, self.layout.headings)
        self._is_clock = self._rate is None and self.layout.is_clock(self._time)
        #: Whether the force's vector turns with the tool.
        self.is_in_tool = is_in_tool(columns.force.name)
        self._turn = self._turn_of(columns.displacement)
        self._numbers = [
            self._reader("force", columns.force),
            self._reader("displacement", columns.displacement),
        ]
        self._where = (self._index(where[0]), where[1]) if where is not None else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the rows read so far, a line each."""
        headings = _headings(self.layout)
        lines = [
            f"{self.named(column)} is commanded by its heading, not measured"
            for column in self._columns.each[1:]
            if not (self._parts(column) or column.name.isdigit())
            and not headings[self._index(column.name)].rank
        ]
        if self.skipped:
            lines.append(
                f"{self.skipped} rows of {self.path.name} hold no number where one is needed, "
                f"the first in {self._first_skipped}"
            )
        if self._repeated > _REPEATED * self._rows:
            rate = 1e9 * self._timed / self._span_ns if self._span_ns else 0.0
            lines.append(
                f"{self._repeated} rows of {self.path.name} have the time of the row before: give "
                f"their rate as the first of --columns, such as @{rate or 500:.3g}"
            )
        if self._left_out:
            lines.append(self._left_out)
        if self.layout.rows_above > _RESULTS:
            lines.append(
                f"{self.layout.rows_above} rows of {self.path.name} above line "
                f"{self.layout.before + 1} are of another table, and left out"
            )
        return tuple(lines)

    @property
    def has_vectors(self) -> tuple[bool, bool]:
        """Whether force and displacement are vectors."""
        each = (self._columns.force, self._columns.displacement)
        force, displacement = (bool(self._parts(column)) for column in each)
        return force, displacement

    @property
    def has_turns(self) -> bool:
        """Whether the displacement is a pose: a place and the tool's orientation."""
        return self._turn is not None

    def named(self, column: Column) -> str:
        """Return a column in words: with the heading of a number, and the unit below it.

        Of a vector the frame is said, of a number a factor that turns its sign.
        """
        if column.name.startswith("@"):
            return f"{column.name[1:]} rows a second"
        if parts := self._parts(column):
            first, *_, last = [self.layout.headings[index] for index in parts]
            frame = ""
            if column == self._columns.force:
                frame = ", in the tool's frame" if self.is_in_tool else ", in the base's frame"
            elif self.has_turns:
                frame = " and the tool's orientation beside them"
            return f"columns {first} to {last}{frame}"
        index = self._index(column.name)
        heading = self.layout.headings[index : index + 1]
        words = [f"column {column.name}"]
        words += [f"({name})" for name in heading if name != column.name]
        words += [f"[{unit}]" for unit in self.layout.units[index : index + 1] if unit]
        if column == self._columns.time and self._nanoseconds is not None:
            words.append(f"and {self.layout.headings[self._nanoseconds]}")
        words += ["with its sign turned"] if column.factor and column.factor < 0 else []
        return " ".join(words)

    def rows(self) -> Iterator[Row]:
        """Yield the rows; stamps are shifted to begin at 1 s where the table's begin below 0.

        Where most rows have one of the quantities alone, as where each topic has rows of its own,
        those are yielded; else a row needs them all.
        """
        self.skipped = self._repeated = self._rows = 0
        self._left_out = ""
        shift: int | None = None
        begin = last = begun = 0
        is_sparse = self._is_sparse()
        stamp_of = self._stamps()
        for number, (line, cells) in enumerate(self._cells()):
            try:
                stamp_ns = stamp_of(number, cells)
                values = [number_of(cells) for number_of in self._numbers]
            except (ValueError, ArithmeticError, IndexError):
                if self._ends_at(line, cells):
                    return
                continue
            if None in values and not (is_sparse and any(v is not None for v in values)):
                self._skip(line, cells)
                continue
            turn = self._turn(cells) if self._turn is not None else None
            if shift is None:
                # 0 stands for "no stamp" everywhere in ROS.
                shift = 0 if stamp_ns > 0 else 1_000_000_000 - stamp_ns
                last = stamp_ns - 1
            if stamp_ns == last:
                self._repeated += not is_sparse
            elif not begun and self._rows:
                begin, begun, last = stamp_ns, self._rows, stamp_ns
            else:
                self._timed, self._span_ns, last = self._rows - begun, stamp_ns - begin, stamp_ns
            self._rows += 1
            force, displacement = values
            yield Row(stamp_ns + shift, force, displacement, turn)

    def _skip(self, line: int, cells: Sequence[str]) -> None:
        if not self.skipped:
            self._first_skipped = f"line {line}: {', '.join(cells)[:_SHOWN]}"
        self.skipped += 1

    def _ends_at(self, line: int, cells: Sequence[str]) -> bool:
        """Return whether a row without numbers has the headings of another table; else skip it.

        The same headings again begin another test, in the same columns.
        """
        stripped = tuple(cell.strip() for cell in cells)
        if stripped in (self.layout.headings, self.layout.units):
            return False
        if states_units(stripped):
            self._left_out = (
                f"the rows of {self.path.name} from line {line} on are of another table, with "
                f"{', '.join(filter(None, stripped))[:_SHOWN]}, and left out"
            )
            return True
        self._skip(line, cells)
        return False

    def _is_sparse(self) -> bool:
        """Return whether more of the first rows hold one quantity than hold all."""
        some = every = 0
        for cells in self.layout.sample:
            try:
                values = [number_of(cells) is not None for number_of in self._numbers]
            except (ValueError, IndexError):
                continue
            every += all(values)
            some += any(values) and not all(values)
        return some > every

    def _parts(self, column: Column) -> list[int]:
        return parts_of(column.name, self.layout.headings)[0]

    def _reader(
        self, quantity: str, column: Column
    ) -> Callable[[Sequence[str]], NumberOrVector | None]:
        """Return what reads a column, or the three columns of a vector."""
        parts = self._parts(column)
        if not parts:
            return self._number(quantity, column)
        numbers = [self._number(quantity, Column(str(i + 1), column.factor)) for i in parts]

        def read(cells: Sequence[str]) -> Vector | None:
            x, y, z = (number_of(cells) for number_of in numbers)
            return None if x is None or y is None or z is None else (x, y, z)

        return read

    def _turn_of(self, column: Column) -> Callable[[Sequence[str]], Quaternion | None] | None:
        """Return what reads the rotation vector [rad] beside a place; None where there is none."""
        turns = parts_of(column.name, self.layout.headings)[1]
        if not turns:
            return None
        numbers = [self._number("angle", Column(str(i + 1), Decimal(1))) for i in turns]

        def read(cells: Sequence[str]) -> Quaternion | None:
            x, y, z = (number_of(cells) for number_of in numbers)
            return None if x is None or y is None or z is None else by_rotation_vector((x, y, z))

        return read

    def _number(self, quantity: str, column: Column) -> Callable[[Sequence[str]], float | None]:
        """Return what reads a column: its number in SI, None where it holds none."""
        index = self._index(column.name)
        decimal = self.layout.decimals[index]
        has_points = decimal == "."
        factor = self._factor(quantity, column, index)

        def read(cells: Sequence[str]) -> float | None:
            cell = cells[index]
            if not has_points:
                cell = numeral(cell, ",") if "." in cell else cell.replace(",", ".")
            try:
                value = float(cell)
            except ValueError:
                text = numeral(cell, decimal)
                if not text:
                    return None
                value = float(text)
            # NaN is nothing too.
            return factor * value if value == value else None

        return read

    def _factor(self, quantity: str, column: Column, index: int) -> float:
        if column.factor is not None:
            return float(column.factor)
        headings = _headings(self.layout)
        if index >= len(headings):
            return 1.0
        # With geometry.kind pass_through the columns are stress and strain.
        kinds = (quantity, {"force": "stress", "displacement": "strain"}.get(quantity, quantity))
        epoch = self.layout.epoch_of(index) if quantity == "time" else None
        if epoch is not None and headings[index].stated("time") is None:
            return epoch
        stated = (headings[index].factor(kind) for kind in kinds)
        return next((factor for factor in stated if factor is not None), 1.0)

    def _stamps(self) -> Callable[[int, Sequence[str]], int]:
        """Return what gives a row's stamp [ns] from its number and its cells."""
        rate, index = self._rate, self._time
        if rate is not None:
            return lambda number, cells: round(number * _NS / rate)
        if self._is_clock:
            last: list[int | None] = [None]
            calendar = Calendar()

            def of_clock(number: int, cells: Sequence[str]) -> int:
                date, time_ns = clock_ns(cells[index])
                day = calendar.day_of(date) if date else None
                last[0] = stamp = stamp_of_clock(day, time_ns, last[0])
                return stamp

            return of_clock
        factor = Decimal(f"{self._factor('time', self._columns.time, index):.12g}") * _NS
        decimal = self.layout.decimals[index]
        has_points = decimal == "."

        def of_number(number: int, cells: Sequence[str]) -> int:
            cell = cells[index].strip()
            if not has_points:
                cell = numeral(cell, ",") if "." in cell else cell.replace(",", ".")
            try:
                value = Decimal(cell)
            except InvalidOperation:
                value = Decimal(numeral(cell, decimal))
            return round(value * factor)

        if self._nanoseconds is None:
            return of_number
        rest = self._nanoseconds
        return lambda number, cells: of_number(number, cells) + int(cells[rest])

    def _cells(self) -> Iterator[tuple[int, list[str]]]:
        where = self._where
        for line, cells in self.layout.rows():
            if where is None or (where[0] < len(cells) and cells[where[0]].strip() == where[1]):
                yield line, cells

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
        headings = self.layout.headings
        places = [index for index, heading in enumerate(headings) if heading == name]
        if len(places) > 1:
            numbers = " and ".join(str(index + 1) for index in places)
            raise InputError(f"{self.path} has several columns {name}: give {numbers} by number")
        if places:
            return places[0]
        width = self.layout.width
        if name.isdigit() and 1 <= int(name) <= width:
            return int(name) - 1
        known = ", ".join(headings) if headings else "no headings"
        raise InputError(
            f"{self.path} has no column {name}: it has {known}; give headings, or numbers from 1 "
            f"to {width}"
        )
