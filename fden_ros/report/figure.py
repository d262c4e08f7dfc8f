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

"""The picture of a session: what was pressed, and how the estimates came about."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import phi
from fden_ros.core.outputs import ContactSummary, Status, TissueState
from fden_ros.report.limits import interval_limits, symmetric_limit
from fden_ros.report.path_picture import draw_path

_ESTIMATE = "#0b5fa5"
_TRUTH = "#c2410c"
_SIGNAL = "#3f3f46"
_CONTACT = "#e8eef5"
#: Logarithms beyond this are not drawn: no double holds their exponential for long.
_LARGEST_LOG = 600.0


@dataclass(frozen=True)
class Session:
    """What the picture shows.

    Parameters
    ----------
    states : sequence of TissueState
    summaries : sequence of ContactSummary
    truth : mapping
        Site number to its true ``linear_stiffness`` and ``nonlinear_stiffness``; empty if unknown.
    """

    states: Sequence[TissueState]
    summaries: Sequence[ContactSummary]
    truth: Mapping[int, Mapping[str, Any]]


def save_session_figure(session: Session, path: str | Path, title: str) -> None:
    """Draw `session` and save it as PNG, SVG or PDF, by the ending of `path`."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    figure.suptitle(title)
    if any(summary.is_of_path for summary in session.summaries):
        draw_path(figure, session.summaries)
        figure.savefig(path, dpi=110)
        return
    grid = figure.add_gridspec(4, 2, width_ratios=(3, 2))
    time_axes = [figure.add_subplot(grid[row, 0]) for row in range(4)]
    for axes in time_axes[1:]:
        axes.sharex(time_axes[0])
    start_ns = session.states[0].stamp_ns if session.states else 0
    _draw_signal(time_axes[0], session, start_ns, "strain", "strain")
    _draw_signal(time_axes[1], session, start_ns, "stress", "stress [Pa]")
    _draw_parameter(time_axes[2], session, start_ns, 0, "linear_stiffness", "G [Pa s$^\\alpha$]")
    _draw_parameter(time_axes[3], session, start_ns, 1, "nonlinear_stiffness", "$G_n$")
    time_axes[3].set_xlabel("time [s]")
    for axes in time_axes[:3]:
        axes.tick_params(labelbottom=False)
    known = [s for s in session.summaries if s.site_id in session.truth and s.estimate is not None]
    rows = grid[:3, 1] if known else grid[:, 1]
    _draw_characteristics(figure.add_subplot(rows), session)
    if known:
        _draw_errors(figure.add_subplot(grid[3, 1]), session, known)
    figure.savefig(path, dpi=110)


def _seconds(stamp_ns: int, start_ns: int) -> float:
    return (stamp_ns - start_ns) * 1e-9


def _by_contact(session: Session, rows: Sequence[Sequence[float]]) -> Array:
    """Return a row per state as columns, shape (k, n), with a break between two contacts."""
    contacts = np.array([state.contact_id for state in session.states])
    breaks = 1 + np.flatnonzero(np.diff(contacts))
    columns: Array = np.insert(np.array(rows, dtype=float).T, breaks, math.nan, axis=1)
    return columns


def _shade_contacts(axes: Axes, session: Session, start_ns: int) -> None:
    for summary in session.summaries:
        axes.axvspan(
            _seconds(summary.start_ns, start_ns),
            _seconds(summary.end_ns, start_ns),
            color=_CONTACT,
            zorder=0,
        )
    axes.spines[["top", "right"]].set_visible(False)


def _draw_signal(axes: Axes, session: Session, start_ns: int, name: str, label: str) -> None:
    _shade_contacts(axes, session, start_ns)
    shown = [
        (_seconds(s.stamp_ns, start_ns), getattr(s.signals, name) if s.signals else math.nan)
        for s in session.states
    ]
    if shown:
        axes.plot(*_by_contact(session, shown), color=_SIGNAL, linewidth=1.2)
    axes.set_ylabel(label)


def _draw_parameter(
    axes: Axes, session: Session, start_ns: int, index: int, key: str, label: str
) -> None:
    _shade_contacts(axes, session, start_ns)
    rows = []
    for state in session.states:
        estimate = state.estimate
        in_contact = state.status in (Status.CONVERGING, Status.CONVERGED)
        if estimate is None or not in_contact:
            rows.append((_seconds(state.stamp_ns, start_ns), *[math.nan] * 4))
            continue
        value = float(estimate.mean[index])
        sd = float(estimate.deviations[index])
        band = (_exp(v) for v in (value, value - 2 * sd, value + 2 * sd))
        rows.append(
            (
                _seconds(state.stamp_ns, start_ns),
                *band,
                _exp(value) if estimate.knows(index) else math.nan,
            )
        )
    if rows:
        time, middle, low, high, converged = _by_contact(session, rows)
        axes.fill_between(time, low, high, color=_ESTIMATE, alpha=0.2, linewidth=0, label="±2 sd")
        axes.plot(time, middle, color=_ESTIMATE, linewidth=1, alpha=0.6, label="converging")
        axes.plot(time, converged, color=_ESTIMATE, linewidth=2.4, label="converged")
    for number, summary in enumerate(session.summaries):
        site = session.truth.get(summary.site_id)
        if site is None:
            continue
        span = [_seconds(t, start_ns) for t in (summary.start_ns, summary.end_ns)]
        axes.plot(
            span,
            [site[key]] * 2,
            color=_TRUTH,
            linestyle="--",
            linewidth=1.4,
            label="truth" if number == 0 else None,
        )
    values = np.array([_exp(s.estimate.mean[index]) for s in session.summaries if s.estimate])
    axes.set_ylim(0.0, 1.25 * interval_limits(values, values, values)[1])
    axes.set_ylabel(label)
    if index == 0:
        # For both parameters, above the panel: its curves begin at its left end, far up.
        axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize="small", frameon=False
        )


def _draw_characteristics(axes: Axes, session: Session) -> None:
    colours = _colours(len(session.summaries))
    highest = 0.0
    for colour, summary in zip(colours, session.summaries, strict=True):
        points = [
            (s.signals.strain, s.signals.fractional_stress)
            for s in session.states
            if s.contact_id == summary.contact_id and s.signals is not None and s.innovation
        ]
        if points:
            axes.plot(*np.array(points).T, ".", color=colour, markersize=3, alpha=0.5)
            highest = max(highest, *(stress for _, stress in points))
        strain = np.linspace(0.0, max(summary.max_strain, 1e-6), 200, dtype=np.float64)
        if summary.estimate is not None:
            axes.plot(
                strain,
                phi(
                    strain,
                    summary.estimate.linear_stiffness,
                    summary.estimate.nonlinear_stiffness,
                ),
                color=colour,
                linewidth=1.6,
                label=_name(summary),
            )
        site = session.truth.get(summary.site_id)
        if site is not None:
            truth = phi(strain, site["linear_stiffness"], site["nonlinear_stiffness"])
            label = "truth" if summary is session.summaries[-1] else None
            axes.plot(strain, truth, color="black", linestyle=":", linewidth=1.2, label=label)
    axes.set_xlabel("strain")
    axes.set_ylabel("fractional stress [Pa s$^\\alpha$]")
    axes.set_title("elastic characteristic, measured (dots) and estimated (lines)", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    if highest > 0.0:
        # By what was measured: the law of an estimate that has not converged may be anywhere.
        axes.set_ylim(-0.05 * highest, 1.3 * highest)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", frameon=False)


def _exp(value: float) -> float:
    """Return e^value, NaN where it overflows."""
    return math.exp(value) if value < _LARGEST_LOG else math.nan


def _name(summary: ContactSummary) -> str:
    label = summary.classes.label if summary.classes is not None else ""
    label = label or "undetermined"
    return f"site {summary.site_id}, contact {summary.contact_id}: {label}"


def _colours(count: int) -> list[Any]:
    from matplotlib import colormaps

    return [colormaps["viridis"](v) for v in np.linspace(0.05, 0.85, max(count, 1))][:count]


def _draw_errors(axes: Axes, session: Session, known: Sequence[ContactSummary]) -> None:
    reaches: list[float] = []
    axes.spines[["top", "right"]].set_visible(False)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_title("error of the estimate, with ±2 sd", fontsize=10)
    for offset, index, key, name, colour in (
        (-0.1, 0, "linear_stiffness", "G", _ESTIMATE),
        (0.1, 1, "nonlinear_stiffness", "$G_n$", _TRUTH),
    ):
        rows = []
        for summary in known:
            assert summary.estimate is not None
            error = summary.estimate.mean[index] - math.log(session.truth[summary.site_id][key])
            sd = summary.estimate.deviations[index]
            rows.append((summary.contact_id + offset, 100 * error, 200 * sd))
            reaches.append(100 * abs(error) + 200 * sd)
        place, error, width = np.array(rows).T
        axes.errorbar(place, error, width, fmt="o", capsize=3, color=colour, label=name)
    limit = symmetric_limit(np.array(reaches), 0.1, share=0.5, factor=10.0)
    axes.set_ylim(-limit, limit)
    axes.legend(fontsize="small", frameon=False, ncols=2)
    axes.set_xticks([s.contact_id for s in known])
    axes.set_xlabel("contact")
    axes.set_ylabel("error [%]")
