# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The picture of a session: what was pressed, and how the estimates came about."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.law.characteristic import phi
from fden_ros.core.outputs import ContactSummary, Status, TissueState
from fden_ros.report import style
from fden_ros.report.limits import interval_limits, symmetric_limit
from fden_ros.report.path_picture import draw_path
from fden_ros.report.table import label_words

_SIZE = (12.0, 9.0)
_PARAMETERS = (
    ("linear_stiffness", style.G_LABEL, style.ESTIMATE),
    ("nonlinear_stiffness", style.GN_LABEL, style.TRUTH),
)


@dataclass(frozen=True)
class Session:
    """What the picture shows."""

    states: Sequence[TissueState]
    summaries: Sequence[ContactSummary]
    #: Site to its true ``linear_stiffness`` and ``nonlinear_stiffness``; empty if unknown.
    truth: Mapping[int, Mapping[str, Any]]

    def seconds(self, stamp_ns: int) -> float:
        """Return the time since the first state [s]."""
        return (stamp_ns - self.states[0].stamp_ns) * 1e-9 if self.states else 0.0

    def spans(self) -> list[tuple[float, float]]:
        """Return the times of the contacts [s]."""
        return [(self.seconds(s.start_ns), self.seconds(s.end_ns)) for s in self.summaries]

    def by_state(self, values: Sequence[Any]) -> list[Any]:
        """Return `values`, one a state, with a break between two contacts: None."""
        contacts = [state.contact_id for state in self.states]
        broken: list[Any] = []
        for index, value in enumerate(values):
            if index and contacts[index] != contacts[index - 1]:
                broken.append(None)
            broken.append(value)
        return broken


def save_session_figure(session: Session, path: str | Path, title: str) -> None:
    """Draw `session` and save it as PNG, SVG or PDF, by the ending of `path`."""
    style.save(lambda figure: draw_session(figure, session, title), path, _SIZE)


def draw_session(figure: Figure, session: Session, title: str) -> None:
    """Draw a session: over time, and the elastic characteristics; of a path, what is along it."""
    figure.suptitle(title)
    if any(summary.is_of_path for summary in session.summaries):
        draw_path(figure, session.summaries)
        return
    grid = figure.add_gridspec(4, 2, width_ratios=(3, 2))
    panels = [figure.add_subplot(grid[row, 0]) for row in range(4)]
    time = np.array(
        session.by_state([session.seconds(state.stamp_ns) for state in session.states]), float
    )
    for panel in panels:
        panel.sharex(panels[0])
        panel.tick_params(labelbottom=panel is panels[-1])
        style.shade(panel, session.spans())
    panels[-1].set_xlabel("time [s]")
    _draw_signal(panels[0], session, time, "strain", "strain")
    _draw_signal(panels[1], session, time, "stress", "stress [Pa]")
    for index in (0, 1):
        _draw_parameter(panels[2 + index], session, time, index)
    style.legend_above(panels[2])
    known = [s for s in session.summaries if s.site_id in session.truth and s.estimate is not None]
    _draw_characteristics(figure.add_subplot(grid[:3, 1] if known else grid[:, 1]), session)
    if known:
        _draw_errors(figure.add_subplot(grid[3, 1]), session, known)


def _draw_signal(axes: Axes, session: Session, time: Array, name: str, label: str) -> None:
    shown = [getattr(s.signals, name) if s.signals else None for s in session.states]
    axes.plot(time, np.array(session.by_state(shown), float), color=style.MEASURED, linewidth=1.2)
    axes.set_ylabel(label)


def _draw_parameter(axes: Axes, session: Session, time: Array, index: int) -> None:
    key, label, _ = _PARAMETERS[index]
    in_contact = (Status.CONVERGING, Status.CONVERGED)
    shown = [s.estimate if s.status in in_contact else None for s in session.states]
    estimates: list[Estimate | None] = session.by_state(shown)
    style.parameter(axes, time, estimates, index)
    label_of_truth: str | None = "truth"
    for summary, span in zip(session.summaries, session.spans(), strict=True):
        site = session.truth.get(summary.site_id)
        if site is not None:
            axes.plot(span, [site[key]] * 2, "--", color=style.TRUTH, label=label_of_truth)
            label_of_truth = None
    final, _, _ = style.interval([s.estimate for s in session.summaries], index)
    axes.set_ylim(0.0, 1.25 * interval_limits(final, final, final)[1])
    axes.set_ylabel(label)


def _draw_characteristics(axes: Axes, session: Session) -> None:
    places = np.linspace(0.05, 0.85, max(len(session.summaries), 1))
    measured = [np.zeros(0)]
    for summary, place in zip(session.summaries, places, strict=False):
        colour = colormaps["viridis"](place)
        points = [
            (s.signals.strain, s.signals.fractional_stress)
            for s in session.states
            if s.contact_id == summary.contact_id and s.signals is not None and s.innovation
        ]
        if points:
            axes.plot(*np.array(points).T, ".", color=colour, markersize=3, alpha=0.5)
            measured.append(np.array(points)[:, 1])
        strain = np.linspace(0.0, max(summary.max_strain, 1e-6), 200, dtype=np.float64)
        estimate, site = summary.estimate, session.truth.get(summary.site_id)
        if estimate is not None:
            law = phi(strain, estimate.linear_stiffness, estimate.nonlinear_stiffness)
            name = f"site {summary.site_id}, contact {summary.contact_id}: {label_words(summary)}"
            axes.plot(strain, law, color=colour, label=name)
        if site is not None:
            truth = phi(strain, site["linear_stiffness"], site["nonlinear_stiffness"])
            label = "truth" if summary is session.summaries[-1] else None
            axes.plot(strain, truth, ":", color=style.INK, label=label)
    axes.set_xlabel("strain")
    axes.set_ylabel("fractional stress [Pa s^α]")
    axes.set_title("Elastic characteristic (dots: measured)")
    style.limit_by(axes, np.concatenate(measured), 0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left")


def _draw_errors(axes: Axes, session: Session, known: Sequence[ContactSummary]) -> None:
    reaches: list[float] = []
    axes.axhline(0.0, color=style.MUTED, linewidth=0.8)
    axes.set_title("Error of the estimate, ±2 sd")
    for index, (key, label, colour) in enumerate(_PARAMETERS):
        places, errors, widths = [], [], []
        for summary in known:
            assert summary.estimate is not None
            error = summary.estimate.mean[index] - math.log(session.truth[summary.site_id][key])
            places.append(summary.contact_id + (-0.1, 0.1)[index])
            errors.append(100.0 * error)
            widths.append(200.0 * float(summary.estimate.deviations[index]))
        error, width = np.array(errors), np.array(widths)
        reaches += (np.abs(error) + width).tolist()
        name = label.partition(" ")[0]
        style.intervals(axes, places, error, error - width, error + width, colour, name)
    limit = symmetric_limit(np.array(reaches), 0.1, share=0.5, factor=10.0)
    axes.set_ylim(-limit, limit)
    axes.legend(ncols=2)
    axes.set_xticks([s.contact_id for s in known])
    axes.set_xlabel("contact")
    axes.set_ylabel("error [%]")
