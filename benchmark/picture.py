# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The picture of a benchmark: columns of its tables, a mark a figure, and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmark.score import Share
from fden_ros.core.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Rows = Mapping[str, Mapping[str, Any]]
_Drawn = Mapping[str, tuple[float, float] | None]

_COLUMNS = 3
#: Figures that differ by more than this factor are drawn on a logarithmic axis.
_FAR = 30.0


class Curve(NamedTuple):
    """A line of a panel, with a band about it."""

    label: str
    x: Array  #: shape (n,)
    y: Array  #: shape (n,)
    band: Array | None = None  #: half of its width, shape (n,)
    style: str = "-"


def draw(
    figure: Figure, tables: Sequence[tuple[_Rows, _Drawn]], curves: Mapping[str, Sequence[Curve]]
) -> None:
    """Draw a panel for each drawn column of the tables, and one for each group of curves."""
    columns = [(rows, name, band) for rows, drawn in tables for name, band in drawn.items()]
    count = len(columns) + len(curves)
    wide = min(_COLUMNS, count)
    high = -(-count // wide)
    most = max((len(rows) for rows, _, _ in columns), default=10)
    figure.set_size_inches(5.0 * wide, high * (1.5 + 0.25 * max(most, 8)))
    panels = list(figure.subplots(high, wide, squeeze=False).flat)
    for axes, (rows, name, band) in zip(panels, columns, strict=False):
        _draw_column(axes, rows, name, band)
    for axes, (title, some) in zip(panels[len(columns) :], curves.items(), strict=False):
        _draw_curves(axes, title, some)
    for axes in panels[count:]:
        axes.set_visible(False)


def _draw_column(axes: Axes, rows: _Rows, name: str, band: tuple[float, float] | None) -> None:
    places = np.arange(len(rows))[::-1]
    everything: list[float] = []
    for place, row in zip(places, rows.values(), strict=True):
        values = _numbers(row.get(name))
        everything += values
        if len(values) <= _COLUMNS:
            for index, value in enumerate(values):
                axes.plot([value], [place], "os^"[index], color=f"C{index}", markersize=5)
        else:
            axes.plot(values, np.full(len(values), place), "|", color="C0")
    if band is not None:
        axes.axvspan(*band, color="0.92", zorder=0)
    known = np.abs([value for value in everything if np.isfinite(value) and value != 0.0])
    if known.size and known.max() > _FAR * known.min():
        axes.set_xscale("symlog", linthresh=float(np.quantile(known, 0.1)))
    axes.set_yticks(places, list(rows), fontsize=7)
    axes.set_xlabel(name)


def _draw_curves(axes: Axes, title: str, curves: Sequence[Curve]) -> None:
    for curve in curves:
        (line,) = axes.plot(curve.x, curve.y, curve.style, label=curve.label)
        if curve.band is not None:
            low, high = curve.y - curve.band, curve.y + curve.band
            axes.fill_between(curve.x, low, high, color=line.get_color(), alpha=0.2, linewidth=0.0)
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=7)


def _numbers(value: Any) -> list[float]:
    """Return the numbers of a cell."""
    if isinstance(value, Share):
        value = value.value
    return [float(v) for v in np.ravel([] if value is None else value) if not isinstance(v, str)]
