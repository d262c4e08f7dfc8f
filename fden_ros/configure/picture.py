# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The evidence of a survey as a picture: a panel a finding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure

from fden_ros.configure.session import Session
from fden_ros.configure.survey import Survey
from fden_ros.configure.writer import value_text
from fden_ros.core.arrays import Array

_FORCE, _MOTION, _CONTACT, _LINE = "#0b5fa5", "#3f3f46", "#e8eef5", "#c2410c"
_POINTS = 4000


def save_picture(survey: Survey, path: str | Path) -> None:
    """Draw the evidence and save it as PNG, SVG or PDF, by the ending of `path`."""
    figure = Figure(figsize=(13, 13.5), layout="constrained")
    grid = figure.add_gridspec(4, 2)
    _times(figure.add_subplot(grid[0, :]), survey)
    panels = {
        "force axis": _push,
        "displacement axis": _motion,
        "tool mass": _weight,
        "compliance": _rigid,
        "surface normal": _surface,
    }
    for number, (subject, draw) in enumerate(panels.items(), start=2):
        panel, finding = figure.add_subplot(grid[number // 2, number % 2]), survey.finding(subject)
        text = value_text(finding) if finding.claim else "cannot tell"
        panel.set_title(f"{subject}: {text}", fontsize=10, loc="left")
        if not draw(panel, survey):
            panel.set_axis_off()
            panel.text(0.02, 0.8, finding.evidence, transform=panel.transAxes, wrap=True)
    _words(figure.add_subplot(grid[3, 1]), survey)
    figure.savefig(path, dpi=110)


def _along(survey: Survey, session: Session) -> tuple[Array, Array]:
    """Return force and motion along their axes, or their sizes where those are not known."""
    axes = survey.axes
    push = np.linalg.norm(session.net, axis=1)
    way = np.linalg.norm(session.position - session.position[0], axis=1)
    if axes.force is not None:
        push = session.net @ axes.force.direction
    if axes.displacement is not None:
        way = session.position @ axes.displacement.direction
    return push, way


def _times(panel: Panel, survey: Survey) -> None:
    session = survey.sessions[0]
    push, way = _along(survey, session)
    times = session.times - session.streams.start
    panel.plot(times, push, color=_FORCE, linewidth=0.9)
    panel.set_ylabel("force [N]", color=_FORCE)
    panel.set_xlabel("time [s]")
    for start, end in session.seconds() if session.leaves else ():
        panel.axvspan(start, end, color=_CONTACT, zorder=0)
    beside = panel.twinx()
    beside.plot(times, 1e3 * (way - way.min()), color=_MOTION, linewidth=0.9)
    beside.set_ylabel("displacement [mm]", color=_MOTION)
    panel.set_title(f"lift-off: {value_text(survey.finding('lift-off'))}", fontsize=10, loc="left")


def _push(panel: Panel, survey: Survey) -> bool:
    session = survey.sessions[0]
    push, _ = _along(survey, session)
    for part, column in zip("xyz", session.net.T, strict=False):
        panel.plot(push[~session.turning], column[~session.turning], ".", markersize=2, label=part)
    panel.set_xlabel("force along its axis [N]")
    panel.set_ylabel("components [N]")
    panel.legend(fontsize=8)
    return True


def _motion(panel: Panel, survey: Survey) -> bool:
    session = survey.sessions[0]
    push, way = _along(survey, session)
    for contact in session.contacts[:12]:
        into = 1e3 * (way[contact.span] - way[contact.first])
        panel.plot(into, push[contact.span], linewidth=0.8)
    panel.set_xlabel("displacement along its axis in contact [mm]")
    panel.set_ylabel("force [N]")
    return bool(session.contacts)


def _weight(panel: Panel, survey: Survey) -> bool:
    streams = survey.sessions[0].streams
    load = survey.weight.load(streams) if survey.weight is not None else None
    if survey.weight is None or load is None:
        return False
    times = streams.force_times - streams.start
    inside = np.zeros(times.size, dtype=bool)
    for start, end in survey.weight.seconds:
        inside |= (times >= start) & (times <= end)
    thin = max(int(inside.sum()) // _POINTS, 1)
    for column, fitted in zip(streams.force[inside].T, load[inside].T, strict=True):
        level = float(np.mean(column - fitted))
        panel.plot(times[inside][::thin], column[::thin] - level, ".", markersize=1.5)
        panel.plot(times[inside], fitted, color=_LINE, linewidth=0.8)
    panel.set_xlabel("time [s]")
    panel.set_ylabel("force in the turns [N]")
    return True


def _rigid(panel: Panel, survey: Survey) -> bool:
    axes = survey.axes
    if axes.force is None or axes.displacement is None:
        return False
    for press in survey.presses:
        session, span = press.session, press.contact.span
        push = session.net[span] @ axes.force.direction
        stamps = session.times[span] + press.delay
        way = session.streams.position_at(stamps) @ axes.displacement.direction
        line = np.array([push.min(), push.max()])
        panel.plot(push, 1e3 * (way - way.mean()), ".", markersize=2)
        panel.plot(line, 1e3 * press.compliance * (line - push.mean()), color=_LINE, linewidth=0.8)
    panel.set_xlabel("force on something rigid [N]")
    panel.set_ylabel("displacement, delay taken out [mm]")
    return bool(survey.presses)


def _surface(panel: Panel, survey: Survey) -> bool:
    """Draw the touches as seen along the approach, by their distances from the plane."""
    touches, plane = survey.scan.touches, survey.scan.plane
    if not touches:
        return False
    into = np.mean([touch.approach for touch in touches], axis=0)
    places = 1e3 * np.array([touch.place for touch in touches])
    x, y = np.linalg.svd(into[None])[2][1:] @ (places - places.mean(axis=0)).T
    panel.plot(x, y, "o", color=_FORCE)
    for number, place in enumerate(zip(x, y, strict=True)):
        off = "" if plane is None else f": {1e3 * plane.residuals[number]:+.2f}"
        text = f"{number + 1}{off}"
        panel.annotate(text, place, xytext=(5, 4), textcoords="offset points", fontsize=7)
    panel.margins(0.2)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("touches along the approach; the numbers: distance from the plane [mm]")
    return True


def _words(panel: Panel, survey: Survey) -> None:
    """Write all that is stated."""
    panel.axis("off")
    lines = [f"{f.subject}: {value_text(f)}" for f in survey.findings if f.claim]
    panel.text(0.0, 0.98, "\n".join(lines), va="top", transform=panel.transAxes, fontsize=8)
