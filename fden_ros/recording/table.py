# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings as text tables: columns of time, force and displacement."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.headings import candidates
from fden_ros.recording.places import place
from fden_ros.recording.text import Layout, is_number, layout_of

_COLUMN = re.compile(r"(?P<name>.+?)(?:\*(?P<factor>[-+]?[\d.]+(?:[eE][-+]?\d+)?))?")
_QUANTITIES = ("time", "force", "displacement")
_NS = 1_000_000_000
#: The clock is too coarse where more than this part of the rows have the time of the row before.
_REPEATED = 0.2
#: Times since 1970 lie between 2001 and 2096 [s], rows less than this apart [s].
_EPOCH, _SLOWEST = (1e9, 4e9), 10.0
#: Values repeat where this part of the runs of one value, of this many, is as long as the median.
_ALIKE, _LEAST_CHANGES = 0.8, 10


@dataclass(frozen=True)
class Column:
    """A column by its heading or its number from 1."""

    name: str
    #: Factor of its numbers; None: by the unit in its heading.
    factor: float | None = None

    def __str__(self) -> str:
        name = f'"{self.name}"' if "," in self.name else self.name
        return name if self.factor is None else f"{name}*{self.factor:.12g}"


@dataclass(frozen=True)
class Columns:
    """Where a table has time, force and displacement."""

    time: Column
    force: Column
    displacement: Column

    def __str__(self) -> str:
        return ",".join(map(str, (self.time, self.force, self.displacement)))

    @property
    def headings(self) -> list[str]:
        """Names that can only be headings."""
        names = [column.name for column in (self.time, self.force, self.displacement)]
        return [name for name in names if not (name.isdigit() or name.startswith("@"))]

    @staticmethod
    def parse(text: str) -> Columns:
        """Return the columns of a text such as ``time_s,force_N,depth_mm*1e-3``.

        Time may be ``@500``: rows at 500 Hz. A heading with a comma stands in quotation marks.
        """
        parts = [part.strip() for part in next(csv.reader([text], skipinitialspace=True), [])]
        matches = [match for part in parts if (match := _COLUMN.fullmatch(part))]
        try:
            columns = [
                Column(m["name"], float(m["factor"]) if m["factor"] else None) for m in matches
            ]
            return Columns(*columns)
        except (TypeError, ValueError):
            raise InputError(
                f"{text!r} is not TIME,FORCE,DISPLACEMENT: expected headings or numbers of three "
                "columns, each with an optional factor to s, N and m, such as "
                "time_s,force_N,depth_mm*1e-3"
            ) from None


def stated_columns(layout: Layout) -> Columns:
    """Return the columns that a table's headings state with their units.

    If they do not, the error line has the ``--columns`` to write.
    """
    if not layout.sample:
        below = layout.names or "its first line"
        raise InputError(f"{layout.path} has no rows of numbers below {below}")
    found = {quantity: _fitting(layout, quantity) for quantity in _QUANTITIES}
    several = [quantity for quantity, fitting in found.items() if len(fitting) > 1]
    missing = [q for q, fitting in found.items() if not fitting or fitting[0][1] is None]
    if not several and not missing:
        return Columns(*(_column(layout, *fitting[0]) for fitting in found.values()))
    shown = ",".join(_likely(layout, quantity, fitting) for quantity, fitting in found.items())
    example = f"such as --columns '{shown}'"
    if several:
        listed = "; ".join(
            f"the {quantity}: {', '.join(_name(layout, index) for index, _ in found[quantity])}"
            for quantity in several
        )
        raise InputError(f"{layout.path}: several columns could be {listed}; name them, {example}")
    raise InputError(
        f"{layout.path} is a table whose headings do not say, with a unit, which column is the "
        f"{' and the '.join(missing)}: give time, force and displacement, {example}, each with a "
        f"factor to s, N and m. It has {layout.names or 'no headings'}{_without_numbers(layout)}"
    )


def _fitting(layout: Layout, quantity: str) -> list[tuple[int, float | None]]:
    """Return the columns that can be a quantity, and their factors to SI where these are known."""

    def is_usable(index: int) -> bool:
        return layout.holds_numbers(index) or (quantity == "time" and layout.is_clock(index))

    found = candidates(layout.headings, quantity, is_usable)
    if quantity != "time":
        return found
    return [(index, _time_factor(layout, index)) for index, _ in found]


def _likely(layout: Layout, quantity: str, fitting: Sequence[tuple[int, float | None]]) -> str:
    """Return a column as it could be given: by its heading, its unit, or a number."""
    if fitting:
        index, factor = fitting[0]
        if factor is None:
            return f"{_name(layout, index)}*FACTOR"
        return str(_column(layout, index, factor))
    if quantity == "time" and layout.names:
        return "@RATE"
    for index, heading in enumerate(layout.headings):
        if heading.factor(quantity) is not None and layout.holds_numbers(index):
            return str(_column(layout, index, heading.factor(quantity)))
    number = 1 + _QUANTITIES.index(quantity)
    return f"{quantity.upper() if layout.names else number}*FACTOR"


def _without_numbers(layout: Layout) -> str:
    """Return that a named column holds no numbers, with one of its cells."""
    for index, heading in enumerate(layout.headings):
        cells = [cell for cell in layout.cells(index) if not is_number(cell)]
        is_named = any(heading.names(quantity) for quantity in _QUANTITIES)
        if cells and is_named and not layout.is_clock(index) and not layout.holds_numbers(index):
            return f"; {heading.text} holds {cells[0]!r}, which is not a number"
    return ""


def _name(layout: Layout, index: int) -> str:
    """Return a heading, or the column's number where the heading is no name for `--columns`."""
    text = layout.headings[index].text
    is_one = len(layout.places(text)) == 1
    return text if is_one and text and not set("*\"'") & set(text) else str(index + 1)


def _column(layout: Layout, index: int, factor: float | None) -> Column:
    return Column(_name(layout, index), None if factor == 1.0 else factor)


def _time_factor(layout: Layout, index: int) -> float | None:
    """Return the factor to s of a column: of its unit, or of times since 1970 by their size."""
    stated = layout.headings[index].factor("time")
    if stated is not None:
        return stated
    if layout.is_clock(index):
        return 1.0
    cells = layout.cells(index)
    if len(cells) < 2 or not all(map(is_number, cells)):
        return None
    numbers = np.array([layout.number(cell) for cell in cells])
    step = float(np.median(np.abs(np.diff(numbers))))
    for factor in (1.0, 1e-3, 1e-6, 1e-9):
        if _EPOCH[0] <= factor * numbers.min() <= factor * numbers.max() < _EPOCH[1]:
            # Whole numbers of that size could also be ns.
            is_open = factor == 1.0 and bool(np.all(numbers == np.rint(numbers)))
            return None if is_open or factor * step > _SLOWEST else factor
    # PlotJuggler's time is in s.
    return 1.0 if layout.headings[index].text == "__time" else None


class TableReader:
    """Read a text table.

    Parameters
    ----------
    path : path
        In a layout that :func:`~fden_ros.recording.text.layout_of` recognises.
    columns : Columns, optional
        If None, those that the headings state.
    where : (str, str), optional
        Use only rows that hold this text in this column.

    Attributes
    ----------
    stamps : array of int64
        Of the rows [ns], shape (n,).
    force, displacement : Array
        [N], [m], shape (n,); NaN where a row has none.
    warnings : tuple of str
        The problems of the rows, a line each.
    """

    def __init__(
        self,
        path: str | Path,
        columns: Columns | None = None,
        where: tuple[str, str] | None = None,
    ) -> None:
        self.path = place(path)
        self.layout = layout_of(self.path, columns.headings if columns is not None else ())
        self.columns = columns = columns or stated_columns(self.layout)
        lines: Sequence[tuple[int, str]] = self.layout.lines
        if where is not None:
            kept = self._index(where[0])
            cells = ((line, self.layout.split(line[1])) for line in lines)
            lines = tuple(line for line, row in cells if row[kept : kept + 1] == [where[1]])
        index = [self._index(column.name) for column in (columns.force, columns.displacement)]
        rate = _rate_of(columns.time)
        time = None if rate is not None else self._index(columns.time.name)
        clock = time if time is not None and self.layout.is_clock(time) else None
        if time is not None and clock is None:
            index.append(time)
        values, lines, left_out = self.layout.numbers(index, lines, clock)
        self.force = self._factor("force", columns.force) * values[:, 0]
        self.displacement = self._factor("displacement", columns.displacement) * values[:, 1]
        if rate is not None:
            self.stamps = np.rint(np.arange(len(values)) * (_NS / rate)).astype(np.int64)
        elif clock is not None:
            self.stamps = self.layout.times_of_day(clock, lines)
        else:
            self.stamps = self._numbered(columns.time, values[:, 2], lines)
        self.warnings = (
            *self._other_by_heading(),
            *([left_out] if left_out else []),
            *self._gaps(),
        )

    def named(self, column: Column) -> str:
        """Return a column in words: with the heading of a number, the unit below it, its sign."""
        if column.name.startswith("@"):
            return f"{column.name[1:]} rows a second"
        heading = self.layout.headings[self._index(column.name)]
        words = [f"column {column.name}"]
        words += [f"({heading.text})"] if heading.text not in ("", column.name) else []
        words += [f"[{heading.unit}]"] if heading.unit else []
        words += ["with the opposite sign"] if column.factor and column.factor < 0 else []
        return " ".join(words)

    def _numbered(self, column: Column, times: Array, lines: Sequence[tuple[int, str]]) -> Any:
        """Return stamps [ns] of a column of times."""
        if np.isnan(times).any():
            number, _ = lines[int(np.argmax(np.isnan(times)))]
            raise InputError(f"{self.path}, line {number} has no time: remove it, or give @RATE")
        stamps = np.rint(times * (self._factor("time", column) * _NS)).astype(np.int64)
        of_force = stamps[~np.isnan(self.force)]
        repeated = np.diff(of_force) == 0
        if repeated.sum() > _REPEATED * max(of_force.size, 5):
            changes = np.flatnonzero(~repeated)
            span = 1e-9 * float(np.ptp(of_force[changes + 1])) if changes.size else 0.0
            rate = np.ptp(changes) / span if span else 500.0
            raise InputError(
                f"{self.path}: {repeated.sum()} rows have the time of the row before: give their "
                f"rate as the first of --columns, such as @{rate:.3g}"
            )
        return stamps

    def _factor(self, quantity: str, column: Column) -> float:
        if column.factor is not None:
            return column.factor
        index = self._index(column.name)
        if quantity == "time":
            return _time_factor(self.layout, index) or 1.0
        # With geometry.kind pass_through the columns are stress and strain.
        kinds = (quantity, {"force": "stress", "displacement": "strain"}[quantity])
        stated = (self.layout.headings[index].factor(kind) for kind in kinds)
        return next((factor for factor in stated if factor is not None), 1.0)

    def _other_by_heading(self) -> Iterator[str]:
        for column in (self.columns.force, self.columns.displacement):
            heading = self.layout.headings[self._index(column.name)]
            if column.name.isdigit():
                continue
            if not heading.rank:
                yield f"{self.named(column)} is commanded, not measured, as its heading says"
            if heading.is_magnitude and column is self.columns.force:
                yield (
                    f"{self.named(column)} is a magnitude, as its heading says: a bias or a force "
                    "aside makes G and N/m wrong; record the force along the axis"
                )

    def _gaps(self) -> Iterator[str]:
        """Warn about gaps of the rows; of repeated values the force keeps the first."""
        for word, values in (("force", self.force), ("displacement", self.displacement)):
            if lacking := int(np.isnan(values).sum()):
                yield f"{lacking} of {values.size} rows of {self.path.name} have no {word}"
        back = np.flatnonzero(np.diff(self.stamps) < 0)
        if back.size:
            yield (
                f"the time of {self.path.name} goes back {back.size} times, first at row "
                f"{back[0] + 2}: if it holds several recordings, choose one with --rows"
            )
        every = np.count_nonzero(~np.isnan(self.force))
        if _thin(self.force):
            kept = np.count_nonzero(~np.isnan(self.force))
            rate = 1e9 * kept / float(np.ptp(self.stamps))
            yield (
                f"each force of {self.path.name} is repeated in {every / kept:.2g} rows: the "
                f"first of them is used, at {rate:.3g} Hz"
            )

    def _index(self, name: str) -> int:
        places, width = self.layout.places(name), len(self.layout.headings)
        if len(places) > 1:
            numbers = " and ".join(str(index + 1) for index in places)
            raise InputError(f"{self.path} has several columns {name}: give {numbers} by number")
        if places:
            return places[0]
        if name.isdigit() and 1 <= int(name) <= width:
            return int(name) - 1
        raise InputError(
            f"{self.path} has no column {name}: it has {self.layout.names or 'no headings'}; give "
            f"headings, or numbers from 1 to {width}"
        )


def _rate_of(time: Column) -> float | None:
    if not time.name.startswith("@"):
        return None
    try:
        rate = float(time.name[1:])
    except ValueError:
        rate = 0.0
    if not 0.0 < rate < math.inf:
        raise InputError(f"{time.name} is not a rate: expected @ and rows per second, @500")
    return rate


def _thin(values: Array) -> bool:
    """Keep the first of numbers that several rows repeat, as a slower instrument does.

    The others become NaN. Runs of such numbers have one length, within one row; those of a
    coarse reading do not.
    """
    present = np.flatnonzero(~np.isnan(values))
    changes = np.flatnonzero(np.diff(values[present], prepend=np.nan) != 0.0)
    lengths = np.diff(changes)
    if lengths.size < _LEAST_CHANGES:
        return False
    usual = float(np.median(lengths))
    alike = np.abs(lengths - usual) <= 1.0
    if usual < 2.0 or alike.mean() < _ALIKE:
        return False
    number = np.arange(present.size)
    begin = changes[np.searchsorted(changes, number, side="right") - 1]
    # A longer run was measured again.
    values[present[(number - begin) % (round(usual) + 1) > 0]] = np.nan
    return True
