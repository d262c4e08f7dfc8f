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

"""The pictures of a report, as SVG that takes its colours from the page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import elastic_response
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.offline.session import Contact, Session, normalized_innovation, predicted_stress
from fden_ros.offline.signals import Envelope
from fden_ros.parameters import unit_vector
from fden_ros.report.limits import interval_limits, symmetric_limit

# Each stands for a colour of the page, which differs in light and dark; see the page's style.
INK, MUTED, GRID, SHADE, MEASURED, ESTIMATE, TRUTH, SURE = (
    f"#0{index}0{index}0{index}" for index in range(1, 9)
)
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
_POINTS = 350
#: Logarithms beyond this are drawn as this.
_LARGEST_LOG = 600.0
#: Makes the logarithm of 0 finite.
_TINY = 1e-300
_PANEL = (5.2, 2.9)
_WIDE = (10.8, 3.4)


def draw(plot: Callable[[Figure], None], size: tuple[float, float] = _PANEL) -> str:
    """Return what `plot` draws as an SVG element that scales to the width of its place."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        plot(figure)
        buffer = io.StringIO()
        figure.savefig(
            buffer,
            format="svg",
            transparent=True,
            metadata={key: None for key in ("Creator", "Date", "Format", "Type")},
        )
    return _for_page(buffer.getvalue())


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


# Across the session


def overview(session: Session) -> str:
    """Force and displacement over the whole recording, contacts shaded."""

    def plot(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        _envelope(upper, session.force, session.start_ns, 1.0)
        _envelope(lower, session.displacement, session.start_ns, 1e3)
        for axes in (upper, lower):
            for summary in session.replay.summaries:
                start, end = (_seconds(ns, session) for ns in (summary.start_ns, summary.end_ns))
                axes.axvspan(start, end, color=SHADE, zorder=0, linewidth=0)
        for summary in session.replay.summaries[:40]:
            middle = _seconds((summary.start_ns + summary.end_ns) // 2, session)
            upper.annotate(
                str(summary.contact_id),
                (middle, 1.0),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="bottom",
                fontsize=8,
                color=MUTED,
            )
        upper.set_ylabel("force [N]")
        lower.set_ylabel("displacement [mm]")
        lower.set_xlabel("time [s]")
        figure.align_ylabels()

    return draw(plot, _WIDE)


def comparison(session: Session) -> str:
    """G and Gn of every contact with their intervals."""
    known = [s for s in session.replay.summaries if s.estimate is not None]

    def plot(figure: Figure) -> None:
        for axes, index, key, label in zip(
            figure.subplots(1, 2),
            (0, 1),
            ("linear_stiffness", "nonlinear_stiffness"),
            ("G [Pa s^α]", "Gn"),
            strict=True,
        ):
            for converged, colour, name in (
                (True, ESTIMATE, "converged, ±2 sd"),
                (False, MUTED, "not converged, ±2 sd"),
            ):
                chosen = [s for s in known if s.estimate and s.estimate.knows(index) is converged]
                if chosen:
                    _intervals(axes, chosen, index, colour, name)
            true = [
                (s.contact_id, session.truth[s.site_id][key])
                for s in known
                if s.site_id in session.truth
            ]
            if true:
                axes.plot(*np.array(true).T, "_", color=TRUTH, markersize=14, label="truth")
            axes.set_xlabel("contact")
            axes.set_title(label)
            axes.locator_params(axis="x", integer=True)
            axes.margins(x=0.08)
            value, low, high = _values_with_intervals(known, index)
            values = [value, *([np.array(true)[:, 1]] if true else [])]
            axes.set_ylim(
                *interval_limits(
                    np.concatenate(values),
                    np.concatenate([low, *values[1:]]),
                    np.concatenate([high, *values[1:]]),
                )
            )
            axes.grid(axis="x", visible=False)
        figure.axes[0].legend(loc="best")

    return draw(plot, _WIDE)


def site_map(session: Session) -> str:
    """Where it was pressed, seen along the approach, with G as colour and number."""
    placed = [s for s in session.replay.summaries if s.position is not None]
    first, second = _lateral_axes(session.parameters.displacement.axis)

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        places = 1e3 * np.array([s.position for s in placed])
        x, y = places @ first, places @ second
        values = np.array(
            [s.estimate.linear_stiffness if s.estimate is not None else math.nan for s in placed]
        )
        axes.scatter(x, y, s=260, c="none", edgecolors=MUTED)
        if np.isfinite(values).any():
            low, high = interval_limits(values, values, values)
            axes.scatter(
                x, y, s=260, c=values, cmap="viridis", edgecolors=MUTED, vmin=low, vmax=high
            )
        for across, along, value, summary in zip(x, y, values, placed, strict=True):
            text = f"{summary.contact_id}: {value:.4g}" if math.isfinite(value) else "no estimate"
            axes.annotate(
                text, (across, along), xytext=(0, 12), textcoords="offset points", ha="center"
            )
        frame = placed[0].position_frame
        where = f" in {frame}" if frame else ""
        axes.set_title(f"Where it was pressed{where} (contact: G in Pa s^α)")
        axes.set_xlabel(f"{_axis_name(first)} [mm]")
        axes.set_ylabel(f"{_axis_name(second)} [mm]")
        # Room for the labels, also where all places are one.
        room = 0.15 * max(np.ptp(x), np.ptp(y)) + 2.0
        axes.set_xlim(x.min() - room, x.max() + room)
        axes.set_ylim(y.min() - room, y.max() + 1.5 * room)
        axes.set_aspect("equal")

    return draw(plot, (10.8, 4.2))


def _lateral_axes(approach: Sequence[float]) -> tuple[Array, Array]:
    axis = np.array(unit_vector(approach))
    # The axes of the frame that are least along the approach, made perpendicular to it.
    order = np.argsort(np.abs(axis), kind="stable")
    first = np.eye(3)[min(order[0], order[1])]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    if second[int(np.argmax(np.abs(second)))] < 0.0:
        second = -second
    return first, second


def _axis_name(axis: Array) -> str:
    index = int(np.argmax(np.abs(axis)))
    return "xyz"[index] if abs(axis[index]) > 0.999 else f"near {'xyz'[index]}"


# One contact


def signals(session: Session, contact: Contact) -> str:
    """Depth and force of a contact, and the force that was predicted."""
    geometry = session.geometry
    states = _with_signals(contact)
    time, _, predicted = predicted_stress(contact)
    start_ns = states[0].stamp_ns

    def plot(figure: Figure) -> None:
        lower, upper = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        depth = [
            1e3 * geometry.length * geometry.compression(s.signals.strain)
            for s in states
            if s.signals is not None
        ]
        force = [s.signals.stress / geometry.stress_per_force for s in states if s.signals]
        seconds = np.array([(s.stamp_ns - start_ns) / NANOSECONDS for s in states])
        lower.plot(*_thin(seconds, np.array(depth)), color=MEASURED)
        lower.set_ylabel("depth [mm]")
        lower.set_title("Depth and force")
        upper.plot(*_thin(seconds, np.array(force)), color=MEASURED, label="measured")
        if time.size:
            first = next(s.stamp_ns for s in states if s.innovation is not None)
            shifted = time + (first - start_ns) / NANOSECONDS
            upper.plot(
                *_thin(shifted, predicted / geometry.stress_per_force),
                color=ESTIMATE,
                linestyle="--",
                label="predicted, one step ahead",
            )
            span = max(force) - min(0.0, *force)
            upper.set_ylim(min(0.0, *force) - 0.08 * span, max(force) + 0.25 * span)
        upper.set_ylabel("force [N]")
        upper.set_xlabel("time since the touch [s]")
        upper.legend(loc="upper right", ncols=2)
        figure.align_ylabels()

    return draw(plot)


def characteristic(contact: Contact, summary: ContactSummary) -> str:
    """Fractional stress against strain, with the fitted law and its band."""
    points = np.array(
        [
            (s.signals.strain, s.signals.fractional_stress)
            for s in contact.states.items
            if s.signals is not None
        ]
    )

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        step = -(-len(points) // _POINTS)
        axes.plot(*points[::step].T, ".", color=MEASURED, markersize=3, label="measured")
        estimate = summary.estimate
        if estimate is not None:
            strain = np.linspace(0.0, max(summary.max_strain, 1e-6), 120)
            response, deviation = _law(strain, summary)
            axes.fill_between(
                strain,
                _exp(np.log(response + _TINY) - 2 * deviation),
                _exp(np.log(response + _TINY) + 2 * deviation),
                color=ESTIMATE,
                alpha=0.25,
                linewidth=0,
                label="±2 sd",
            )
            axes.plot(strain, response, color=ESTIMATE, label="FDEN")
            boundary = math.exp(-estimate.log_nonlinear_stiffness)
            if boundary < summary.max_strain:
                axes.axvline(boundary, color=MUTED, linestyle=":", linewidth=1)
                axes.annotate(
                    "1/Gn",
                    (boundary, 0.0),
                    xycoords=("data", "axes fraction"),
                    xytext=(3, 3),
                    textcoords="offset points",
                    color=MUTED,
                    fontsize=8,
                )
        axes.set_title("Fractional stress against strain")
        axes.set_xlabel("strain")
        axes.set_ylabel("f' [Pa s^α]")
        # By what was measured: the band of an estimate that has not converged may be anywhere.
        low, high = float(min(0.0, points[:, 1].min())), float(points[:, 1].max())
        if high > low:
            axes.set_ylim(low - 0.05 * (high - low), high + 0.3 * (high - low))
        axes.legend(loc="upper left")

    return draw(plot)


def _law(strain: Array, summary: ContactSummary) -> tuple[Array, Array]:
    """Return the fitted law over `strain`, and the standard deviation of its logarithm."""
    estimate = summary.estimate
    assert estimate is not None
    stiffness, nonlinear = estimate.linear_stiffness, estimate.nonlinear_stiffness
    response = np.array([elastic_response(x, stiffness, nonlinear).value for x in strain])
    # d ln phi by (ln G, ln Gn).
    gradient = np.array([np.ones_like(strain), np.maximum(nonlinear * strain - 1.0, 0.0)])
    variance = np.einsum("in,ij,jn->n", gradient, estimate.covariance[:2, :2], gradient)
    return response, np.sqrt(np.maximum(variance, 0.0))


def convergence(contact: Contact, truth: dict[str, Any] | None) -> str:
    """How G and Gn became known."""
    states = [s for s in contact.states.items if s.estimate is not None]

    def plot(figure: Figure) -> None:
        start_ns = contact.states.items[0].stamp_ns
        time = np.array([(s.stamp_ns - start_ns) / NANOSECONDS for s in states])
        for axes, index, key, label in zip(
            figure.subplots(2, 1, sharex=True),
            (0, 1),
            ("linear_stiffness", "nonlinear_stiffness"),
            ("G [Pa s^α]", "Gn"),
            strict=True,
        ):
            value = np.array([s.estimate[index] for s in states])
            deviation = np.sqrt([s.estimate.covariance[index, index] for s in states])
            low, high = _exp(value - 2 * deviation), _exp(value + 2 * deviation)
            sure = np.array([s.estimate.knows(index) for s in states])
            step = -(-time.size // _POINTS)
            axes.fill_between(
                time[::step], low[::step], high[::step], color=ESTIMATE, alpha=0.25, linewidth=0,
                label="±2 sd",
            )  # fmt: skip
            axes.plot(*_thin(time, _exp(value)), color=ESTIMATE, linewidth=1, label="estimate")
            axes.plot(
                *_thin(time, np.where(sure, _exp(value), math.nan)),
                color=SURE,
                linewidth=2.4,
                label="converged",
            )
            if truth is not None:
                axes.axhline(truth[key], color=TRUTH, linestyle=":", label="truth")
            final = float(_exp(value)[-1])
            away = np.abs(np.concatenate([low, high]) - final)
            spread = min(float(np.quantile(away, 0.9)), 2.0 * final)
            axes.set_ylim(final - 1.3 * spread - 0.02 * final, final + 1.3 * spread + 0.02 * final)
            axes.set_ylabel(label)
        figure.axes[0].set_title("The estimate converging")
        # Beside the title: the band may fill the whole panel.
        figure.axes[0].legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.0,
            columnspacing=1.0, handlelength=1.4,
        )  # fmt: skip
        figure.axes[-1].set_xlabel("time since the touch [s]")
        figure.align_ylabels()

    return draw(plot)


def innovations(contact: Contact) -> str:
    """Innovations over their standard deviation, which stay within ±2 nearly always."""
    states = [s for s in contact.states.items if s.innovation is not None]

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        start_ns = contact.states.items[0].stamp_ns
        time = np.array([(s.stamp_ns - start_ns) / NANOSECONDS for s in states])
        values = np.array([normalized_innovation(s.innovation) for s in states if s.innovation])
        axes.axhspan(-2.0, 2.0, color=SHADE, zorder=0, linewidth=0)
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        step = -(-time.size // _POINTS)
        axes.plot(time[::step], values[::step], ".", color=MEASURED, markersize=3)
        axes.set_title("Innovations over their standard deviation")
        axes.set_xlabel("time since the touch [s]")
        extent = symmetric_limit(values, 3.0)
        axes.set_ylim(-extent, extent)
        beyond = int(np.count_nonzero(np.abs(values) > extent))
        if beyond:
            axes.annotate(
                f"{beyond} beyond, up to {np.max(np.abs(values)):.3g}",
                (0.99, 0.97),
                xycoords="axes fraction",
                ha="right",
                va="top",
                fontsize=8,
                color=MUTED,
            )

    return draw(plot)


def _with_signals(contact: Contact) -> list[TissueState]:
    return [state for state in contact.states.items if state.signals is not None]


def _thin(x: Array, y: Array) -> tuple[Array, Array]:
    """Return at most `_POINTS` of a curve's points, the last among them."""
    step = -(-x.size // _POINTS)
    keep = np.unique(np.append(np.arange(0, x.size, step), x.size - 1))
    return x[keep], y[keep]


def _intervals(
    axes: Axes, summaries: Sequence[ContactSummary], index: int, colour: str, name: str
) -> None:
    value, low, high = _values_with_intervals(summaries, index)
    axes.errorbar(
        [s.contact_id for s in summaries],
        value,
        [value - low, high - value],
        fmt="o",
        markersize=4,
        capsize=3,
        color=colour,
        label=name,
    )


def _values_with_intervals(
    summaries: Sequence[ContactSummary], index: int
) -> tuple[Array, Array, Array]:
    """Return G or Gn and the ends of its interval of ±2 deviations, shape (n,) each."""
    estimates = [s.estimate for s in summaries if s.estimate is not None]
    logs = np.array([estimate[index] for estimate in estimates])
    reach = 2.0 * np.array([estimate.deviations[index] for estimate in estimates])
    return _exp(logs), _exp(logs - reach), _exp(logs + reach)


def _exp(logs: Array) -> Array:
    """Return e^logs, without an overflow."""
    result: Array = np.exp(np.minimum(logs, _LARGEST_LOG))
    return result


def _envelope(axes: Axes, envelope: Envelope, start_ns: int, scale: float) -> None:
    time, low, high = envelope.arrays(start_ns)
    if time.size:
        # Drawn as a line up and down: where there is one value only, a band has no width.
        x = np.repeat(time, 2)
        y = scale * np.column_stack([low, high]).ravel()
        axes.plot(x, y, color=MEASURED, linewidth=0.9)


def _seconds(stamp_ns: int, session: Session) -> float:
    return (stamp_ns - session.start_ns) / NANOSECONDS
