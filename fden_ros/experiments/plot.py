# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The picture of a fit: measured points, the model, and what the paper would look at."""

from __future__ import annotations

import math
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
    """Draw a fit and save it as PNG, SVG or PDF, by the ending of `path`.

    Raises
    ------
    InputError
        If the ending names no format, or the file cannot be written.
    """
    figure = Figure(figsize=(5.2 * len(fit.panels), 4.4), layout="constrained")
    for axes, panel in zip(
        figure.subplots(1, len(fit.panels), squeeze=False)[0], fit.panels, strict=True
    ):
        draw_panel(axes, panel)
    numbers = (
        f"{_NAMES[name]} = {p.value:.4g} ± {p.sd:.2g}"
        if p.sd == p.sd
        else f"{_NAMES[name]} = {p.value:.4g}"
        for name, p in fit.parameters.items()
        if name in _NAMES
    )
    figure.suptitle(f"{title}\n" + "   ".join(numbers), fontsize="medium")
    save_figure(figure, path)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Save a figure, or raise :class:`InputError` with the reason."""
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
