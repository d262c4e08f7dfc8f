# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one style of pictures, as SVG whose colours are variables of the page's style sheet."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate
from fden_ros.written import written

INK, MUTED, GRID, SHADE = "#1b1f24", "#667080", "#e3e6ea", "#e6edf6"
MEASURED, ESTIMATE, TRUTH = "#3d4654", "#0b63b5", "#c2410c"
_VARIABLES = {
    INK: "--ink", MUTED: "--muted", GRID: "--grid", SHADE: "--shade",
    MEASURED: "--measured", ESTIMATE: "--estimate", TRUTH: "--truth",
}  # fmt: skip
_STYLE = {
    "svg.fonttype": "none", "svg.hashsalt": "fden",
    "font.family": "sans-serif", "font.size": 9.0, "text.color": INK,
    "axes.edgecolor": MUTED, "axes.labelcolor": INK, "axes.facecolor": "none",
    "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.titleweight": "bold",
    "axes.grid": True, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False,
    "grid.color": GRID, "grid.linewidth": 0.6, "xtick.color": MUTED, "xtick.labelcolor": INK,
    "ytick.color": MUTED, "ytick.labelcolor": INK, "legend.frameon": False,
    "legend.fontsize": 8.0, "lines.linewidth": 1.4,
    "path.simplify": True, "path.simplify_threshold": 0.3,
}  # fmt: skip
#: Of every picture [inch]: its letters are legible on a telephone.
_SIZE = (5.2, 3.2)
#: Logarithms beyond this are drawn as this.
_LARGEST_LOG = 600.0
#: Half width of bands and intervals, in standard deviations.
_SDS = 2.0
#: Intervals are shown up to this many times their value, and down to its inverse.
_INTERVAL = 3.0

Plot = Callable[[Figure], None]


def draw(plot: Plot) -> str:
    """Return what `plot` draws as an SVG element that scales to the width of its place."""
    buffer = io.StringIO()
    unsaid = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        plot(figure)
        figure.savefig(buffer, format="svg", transparent=True, metadata=unsaid)
    return _for_page(buffer.getvalue())


def _for_page(svg: str) -> str:
    svg = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    head, rest = svg[svg.index("<svg") :].split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    # Several pictures share a page, so the names of their parts must differ.
    rest = re.sub(r'<g id="[^"]*"', "<g", rest)
    # The page's own font, whatever matplotlib's measurement.
    rest = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", rest)
    rest = re.sub(r"font: (bold|700) ([\d.]+px)[^;\"]*", r"font-weight: bold; font-size: \2", rest)
    for colour, variable in _VARIABLES.items():
        rest = rest.replace(colour, f"var({variable})")
    rest = re.sub(r"\s*\n\s*", "\n", rest)
    return f'<svg {view.group(0) if view else ""} role="img">{rest}'.strip()


def band(axes: Axes, x: Array, low: Array, high: Array) -> None:
    """Fill between the ends of an interval."""
    axes.fill_between(x, low, high, color=ESTIMATE, alpha=0.25, linewidth=0, label="±2 sd")


def intervals(
    axes: Axes, x: Sequence[float], values: tuple[Array, Array, Array], fmt: str, **named: Any
) -> None:
    """Draw values as dots with whiskers to the ends of their intervals, (n,) each."""
    value, low, high = values
    ends = value - low, high - value
    axes.errorbar(x, value, ends, fmt=fmt, markersize=4, linewidth=1.0, capsize=3, **named)


def interval(estimates: Sequence[Estimate | None], index: int) -> tuple[Array, Array, Array]:
    """Return G or Gn and the ends of its interval, shape (n,) each; NaN without an estimate."""
    logs = np.array([np.nan if e is None else e.mean[index] for e in estimates], dtype=float)
    sds = np.array([np.nan if e is None else e.deviations[index] for e in estimates], dtype=float)
    return exp(logs), exp(logs - _SDS * sds), exp(logs + _SDS * sds)


def exp(logs: Array) -> Array:
    """Return e^logs, without an overflow."""
    result: Array = np.exp(np.minimum(logs, _LARGEST_LOG))
    return result


def limit_by_intervals(axes: Axes, value: Array, low: Array, high: Array) -> None:
    """Set the vertical axis by positive values with their intervals, which may be very wide."""
    least = float(np.min(np.fmax(low, value / _INTERVAL)))
    most = float(np.max(np.fmin(high, value * _INTERVAL)))
    margin = 0.08 * (most - least) or 0.08 * most
    axes.set_ylim(least - margin, most + margin)


def limit_by(axes: Axes, values: Array, above: float) -> None:
    """Set the vertical axis by `values`, with `above` of their range left free on top.

    The band of an estimate that has not converged does not count: it may be anywhere.
    """
    finite = values[np.isfinite(values)]
    low, high = min(0.0, float(finite.min(initial=0.0))), float(finite.max(initial=0.0))
    if high > low:
        axes.set_ylim(low - 0.05 * (high - low), high + above * (high - low))


def write_ticks(axes: Axes) -> None:
    """Label the vertical axis with numbers that are written out."""
    axes.yaxis.set_major_formatter(lambda value, _: written(value, 6))


def legend_above(axes: Axes) -> None:
    """Put the legend next to the title: the curves may fill the whole panel."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
    axes.legend(**place, ncols=4, columnspacing=1.0, handlelength=1.4)
