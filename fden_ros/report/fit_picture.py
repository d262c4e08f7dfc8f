# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The picture of an experiment: measured points, the model, and what the paper looks at."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from fden_ros.experiments.result import Fit, Panel
from fden_ros.report import style

_COLOURS = (style.MEASURED, style.ESTIMATE, style.TRUTH)
_NAMES = {
    "alpha": "α",
    "g": "G",
    "g_n": "$G_n$",
    "g_i": "$G_i$",
    "x_b": "$x_b$",
    "x_c": "$x_c$",
}
_SIZE = (5.2, 4.4)
#: Up to so many points are drawn as circles.
_FEW = 60


def save_fit_picture(fit: Fit, path: Path, title: str) -> None:
    """Draw a fit and save it as PNG, SVG or PDF, by the ending of `path`."""
    width, height = _SIZE
    size = (width * len(fit.panels), height)
    style.save(lambda figure: _draw(figure, fit, title), path, size)


def _draw(figure: Figure, fit: Fit, title: str) -> None:
    numbers = (
        f"{_NAMES[name]} = {p.value:.4g}" + (f" ± {p.sd:.2g}" if p.sd == p.sd else "")
        for name, p in fit.parameters.items()
        if name in _NAMES
    )
    figure.suptitle(f"{title}\n" + "   ".join(numbers), fontsize="medium")
    panels = figure.subplots(1, len(fit.panels), squeeze=False)[0]
    for axes, panel in zip(panels, fit.panels, strict=True):
        _draw_panel(axes, panel)


def _draw_panel(axes: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        colour, label = _COLOURS[curve.color], curve.label or None
        if curve.line:
            axes.plot(curve.x, curve.y, "--" if curve.dashed else "-", color=colour, label=label)
        else:
            is_few = curve.x.size <= _FEW
            face, size = ("none", 5.0) if is_few else (colour, 2.5)
            axes.plot(
                curve.x, curve.y, "o", color=colour, markerfacecolor=face, markersize=size,
                label=label,
            )  # fmt: skip
    axes.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
    if panel.x_log:
        axes.set_xscale("log")
    if panel.y_log:
        axes.set_yscale("log")
    for axis, is_log in ((axes.xaxis, panel.x_log), (axes.yaxis, panel.y_log)):
        if is_log:
            axis.set_major_formatter(LogFormatter())
            axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.3, 0.4)))
    if any(curve.label for curve in panel.curves):
        axes.legend()
