# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one style of pictures: colours, axes, curves with bands, intervals, legends; as SVG or file.

On a page the colours are variables of its style sheet, so that one picture is right in light, dark
and print; in a file they are those of the light page.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate

# Each is another, also where two look alike: a page has a variable for each.
INK, MUTED, GRID, SHADE = "#1b1f24", "#667080", "#e3e6ea", "#e6edf6"
MEASURED, ESTIMATE, TRUTH, SURE = "#3d4654", "#0b63b5", "#c2410c", "#0b63b6"
_VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    GRID: "--grid",
    SHADE: "--shade",
    MEASURED: "--measured",
    ESTIMATE: "--estimate",
    TRUTH: "--truth",
    SURE: "--sure",
}
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "fden",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.4,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}
#: Sizes of a picture [inch]: one of several side by side, and one as wide as the page.
PANEL, WIDE = (5.2, 2.9), (10.8, 3.4)
G_LABEL, GN_LABEL = "G [Pa s^α]", "Gn"
#: Logarithms beyond this are drawn as this.
_LARGEST_LOG = 600.0
#: Half width of bands and intervals, in standard deviations.
_SDS = 2.0
_BAND = "±2 sd"
#: Values farther than this factor from the median are astray.
_ASTRAY = 20.0
#: Intervals are shown up to this many times their value, and down to its inverse.
_INTERVAL = 3.0
#: Part of the distance between the limits that is left free at each end.
_MARGIN = 0.08

Plot = Callable[[Figure], None]


def draw(plot: Plot, size: tuple[float, float] = PANEL) -> str:
    """Return what `plot` draws as an SVG element that scales to the width of its place."""
    buffer = io.StringIO()
    unsaid = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with mpl.rc_context(_STYLE):
        _drawn(plot, size).savefig(buffer, format="svg", transparent=True, metadata=unsaid)
    return _for_page(buffer.getvalue())


def save(plot: Plot, path: str | Path) -> None:
    """Save what `plot` draws as PNG, SVG or PDF, by the ending of `path`."""
    with mpl.rc_context(_STYLE):
        _drawn(plot, WIDE).savefig(path, dpi=110)


def _drawn(plot: Plot, size: tuple[float, float]) -> Figure:
    figure = Figure(figsize=size, layout="constrained")
    plot(figure)
    return figure


def _for_page(svg: str) -> str:
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    head, rest = svg.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    # Several pictures share a page: the names of their parts would repeat.
    rest = re.sub(r'<g id="[^"]*"', "<g", rest)
    # The page's own font, whatever matplotlib measured with.
    rest = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", rest)
    rest = re.sub(r"font: (bold|700) ([\d.]+px)[^;\"]*", r"font-weight: bold; font-size: \2", rest)
    for colour, variable in _VARIABLES.items():
        rest = rest.replace(colour, f"var({variable})")
    rest = re.sub(r"\s*\n\s*", "\n", rest)
    return f'<svg {view.group(0) if view else ""} role="img">{rest}'.strip()


# What is drawn on axes


def band(axes: Axes, x: Array, low: Array, high: Array) -> None:
    """Fill between the ends of an interval."""
    axes.fill_between(x, low, high, color=ESTIMATE, alpha=0.25, linewidth=0, label=_BAND)


def intervals(
    axes: Axes,
    x: Sequence[float],
    value: Array,
    low: Array,
    high: Array,
    colour: str = ESTIMATE,
    label: str | None = None,
    joined: bool = False,
) -> None:
    """Draw values as dots with whiskers to the ends of their intervals."""
    axes.errorbar(
        x,
        value,
        [value - low, high - value],
        fmt="o-" if joined else "o",
        markersize=4,
        linewidth=1.0,
        capsize=3,
        color=colour,
        label=label,
    )


def parameter(
    axes: Axes, time: Array, estimates: Sequence[Estimate | None], index: int
) -> tuple[Array, Array, Array]:
    """Draw how G or Gn (`index` 0 or 1) becomes known, and return value and interval, (n,) each.

    Where there is no estimate the curve is broken.
    """
    value, low, high = interval(estimates, index)
    sure = np.array([e is not None and e.knows(index) for e in estimates], dtype=bool)
    band(axes, time, low, high)
    axes.plot(time, value, color=ESTIMATE, linewidth=1.0, label="estimate")
    sure_value = np.where(sure, value, np.nan)
    axes.plot(time, sure_value, color=SURE, linewidth=2.4, label="converged")
    return value, low, high


def interval(estimates: Sequence[Estimate | None], index: int) -> tuple[Array, Array, Array]:
    """Return G or Gn and the ends of its interval, shape (n,) each; NaN without an estimate."""
    logs = np.array([np.nan if e is None else e.mean[index] for e in estimates], dtype=float)
    sds = np.array([np.nan if e is None else e.deviations[index] for e in estimates], dtype=float)
    return exp(logs), exp(logs - _SDS * sds), exp(logs + _SDS * sds)


def shade(axes: Axes, spans: Sequence[tuple[float, float]]) -> None:
    """Shade stretches of the horizontal axis."""
    for start, end in spans:
        axes.axvspan(start, end, color=SHADE, zorder=0, linewidth=0)


def legend_above(axes: Axes) -> None:
    """Put the legend next to the title: what is drawn may fill the whole panel."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.0,
        columnspacing=1.0,
        handlelength=1.4,
    )


def limit_by(axes: Axes, values: Array, above: float) -> None:
    """Set the vertical axis by `values`, with `above` of their range left free on top.

    What is drawn besides, the band of an estimate that has not converged, may be anywhere.
    """
    finite = values[np.isfinite(values)]
    low, high = min(0.0, float(finite.min(initial=0.0))), float(finite.max(initial=0.0))
    if high > low:
        axes.set_ylim(low - 0.05 * (high - low), high + above * (high - low))


def exp(logs: Array) -> Array:
    """Return e^logs, without an overflow."""
    result: Array = np.exp(np.minimum(logs, _LARGEST_LOG))
    return result


def interval_limits(values: Array, low: Array, high: Array) -> tuple[float, float]:
    """Return limits for positive values with their intervals.

    Parameters
    ----------
    values, low, high : ndarray, shape (n,)
        What is not finite or not positive is left out.

    Returns
    -------
    tuple of float
        Lower and upper limit; (0, 1) where there is no value.
    """
    is_good = np.isfinite(values) & (values > 0.0)
    if not is_good.any():
        return 0.0, 1.0
    values, low, high = values[is_good], low[is_good], high[is_good]
    middle = np.sort(values)[(values.size - 1) // 2]
    is_near = np.abs(np.log(values / middle)) <= np.log(_ASTRAY)
    values, low, high = values[is_near], low[is_near], high[is_near]
    least = float(np.min(np.fmax(low, values / _INTERVAL)))
    most = float(np.max(np.fmin(high, values * _INTERVAL)))
    margin = _MARGIN * (most - least) or _MARGIN * most
    return least - margin, most + margin
