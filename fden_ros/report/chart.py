# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A curve with its band in the terminal, four by two dots of Braille a character."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.text import Text

from fden_ros.core.arrays import Array

Dots = NDArray[np.bool_]

_BRAILLE = 0x2800
#: Bits of the dots of a character, by row and column.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_SHADE = "░"
_LABEL = 10
_LEAST_WIDTH = _LABEL + 12


def _nothing() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Chart:
    """The newest part of a curve, as wide as its place.

    Parameters
    ----------
    title : str
        Quantity and unit.
    ages : ndarray, shape (n,)
        Time before now [s], falling.
    values : ndarray, shape (n,)
        The curve; NaN breaks it.
    limits : tuple of float
        Lower and upper end of the axis.
    low, high : ndarray, shape (n,)
        Ends of the band; empty: there is none.
    span : float
        Time from the left end to now [s].
    height : int
        Lines of the plot.
    """

    title: str
    ages: Array
    values: Array
    limits: tuple[float, float]
    low: Array = field(default_factory=_nothing)
    high: Array = field(default_factory=_nothing)
    span: float = 20.0
    height: int = 6

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Return that it takes what there is."""
        return Measurement(_LEAST_WIDTH, max(options.max_width, _LEAST_WIDTH))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield title, plot and time axis, a line each."""
        width = max(options.max_width, _LEAST_WIDTH) - _LABEL - 1
        yield Text(f"{'':{_LABEL}} {self.title}", style="dim", no_wrap=True)
        yield from self._lines(width)
        left = f"-{self.span:g} s"
        yield Text(f"{'':{_LABEL}} {left:<{width - 3}}now", style="dim", no_wrap=True)

    def _lines(self, width: int) -> Iterator[Text]:
        dots, shaded = self._dots(width), self._shaded(width)
        low, high = self.limits
        for row in range(self.height):
            share = {0: 1.0, self.height - 1: 0.0}.get(row)
            label = "" if share is None else f"{low + share * (high - low):.4g}"
            line = Text(f"{label:>{_LABEL}} ", style="dim", no_wrap=True)
            block = dots[4 * row : 4 * row + 4].reshape(4, width, 2)
            codes = np.einsum("rwc,rc->w", block.astype(int), _BITS)
            for code, is_shaded in zip(codes.tolist(), shaded[row].tolist(), strict=True):
                if code:
                    line.append(chr(_BRAILLE + code), style="bold cyan")
                else:
                    line.append(_SHADE if is_shaded else " ", style="blue")
            yield line

    def _columns(self, count: int) -> NDArray[np.int64]:
        """Return the column that each time falls into, -1 where it is too old."""
        columns = np.floor(count * (1.0 - self.ages / self.span)).astype(np.int64)
        columns = np.minimum(columns, count - 1)
        columns[columns < 0] = -1
        return columns

    def _heights(self, values: Array, count: int) -> Array:
        """Return how high values stand, from 0 at the lower limit to `count` at the upper."""
        low, high = self.limits
        result: Array = count * (values - low) / ((high - low) or 1.0)
        return result

    def _dots(self, width: int) -> Dots:
        """Return the dots of the curve, shape (4 height, 2 width), the top first."""
        rows, columns = 4 * self.height, 2 * width
        dots = np.zeros((rows, columns), dtype=bool)
        heights = self._heights(self.values, rows)
        places = self._columns(columns)
        before: tuple[int, float] | None = None
        for place, height in zip(places.tolist(), heights.tolist(), strict=True):
            if place < 0 or not np.isfinite(height):
                before = None
                continue
            # A steep curve is a line up or down, not dots apart.
            start = before[1] if before is not None and place - before[0] <= 2 else height
            bottom, top = (int(np.floor(h)) for h in sorted((start, height)))
            if bottom < rows and top >= 0:
                bottom, top = max(bottom, 0), min(top, rows - 1)
                dots[rows - 1 - top : rows - bottom, place] = True
            before = place, height
        return dots

    def _shaded(self, width: int) -> Dots:
        """Return the characters that the band covers, shape (height, width), the top first."""
        shaded = np.zeros((self.height, width), dtype=bool)
        if not self.low.size:
            return shaded
        places = self._columns(width)
        floors = np.arange(self.height - 1, -1, -1) + 0.5
        lows, highs = (self._heights(end, self.height) for end in (self.low, self.high))
        for place, low, high in zip(places.tolist(), lows.tolist(), highs.tolist(), strict=True):
            if place >= 0 and np.isfinite(low) and not np.isnan(high):
                shaded[:, place] = (floors > low - 0.5) & (floors < high + 0.5)
        return shaded
