# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The picture of a fit: measured points, the model, and what the paper would look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from fden_ros.errors import InputError
from fden_ros.experiments.result import Fit, Panel

_COLORS = ("#0b5fa5", "#c2410c", "#71717a")
_NAMES = {
    "alpha": "α",
    "g": "G",
    "g_n": "$G_n$",
    "g_i": "$G_i$",
    "x_b": "$x_b$",
    "x_c": "$x_c$",
    "f_c": "$f_c$",
}


def save_fit_figure(fit: Fit, path: str | Path, title: str) -> None:
    """Draw a fit and save it, see :func:`save_panels`."""
    numbers = (
        f"{_NAMES[name]} = {p.value:.4g}" + (f" ± {p.sd:.2g}" if p.sd == p.sd else "")
        for name, p in fit.parameters.items()
        if name in _NAMES
    )
    save_panels(fit.panels, path, f"{title}\n" + "   ".join(numbers))


def save_panels(panels: Sequence[Panel], path: str | Path, title: str = "") -> None:
    """Draw panels side by side and save them as PNG, SVG or PDF, by the ending of `path`.

    Raises
    ------
    InputError
        If the ending names no format, or the file cannot be written.
    """
    figure = Figure(figsize=(5.2 * len(panels), 4.4), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        draw_panel(axes, panel)
    figure.suptitle(title, fontsize="medium")
    try:
        figure.savefig(path, dpi=120)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "end it in .png, .svg or .pdf"
        raise InputError(f"{path} cannot be written: {reason}") from None


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw one panel."""
    for curve in panel.curves:
        color = _COLORS[curve.color]
        label = curve.label or None
        if curve.line:
            style = "--" if curve.dashed else "-"
            axes.plot(curve.x, curve.y, style, color=color, linewidth=1.6, label=label, zorder=3)
        else:
            few = curve.x.size <= 60
            axes.plot(
                curve.x, curve.y, "o", color=color, markersize=5 if few else 2.5,
                markerfacecolor="none" if few else color, alpha=1.0 if few else 0.5,
                markeredgewidth=1.2 if few else 0.0, label=label,
            )  # fmt: skip
    axes.set(
        title=panel.title,
        xlabel=panel.x_label,
        ylabel=panel.y_label,
        xscale="log" if panel.x_log else "linear",
        yscale="log" if panel.y_log else "linear",
    )
    for axis, log in ((axes.xaxis, panel.x_log), (axes.yaxis, panel.y_log)):
        if log:
            _label_logarithmic(axis)
    axes.grid(True, which="both", color="#e4e4e7", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if any(curve.label for curve in panel.curves):
        axes.legend(frameon=False, fontsize="small")


def _label_logarithmic(axis: Axis) -> None:
    """Write plain numbers at as many ticks as there is room for."""
    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low)
    if decades > 4.0:
        axis.set_minor_formatter(NullFormatter())
        return
    digits = range(1, 10) if decades < 0.4 else (2, 3, 4, 6) if decades < 1.3 else (3,)

    def label(value: float, _: object) -> str:
        leading = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        return f"{value:g}" if leading in digits else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(FuncFormatter(label) if decades < 2.0 else NullFormatter())
