# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The evidence of a survey as a picture: a panel a finding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure

from fden_ros.configure.finding import Finding
from fden_ros.configure.session import Session
from fden_ros.configure.survey import Survey
from fden_ros.configure.writer import value_text
from fden_ros.core.arrays import Array

_FORCE, _MOTION, _CONTACT, _LINE = "#0b5fa5", "#3f3f46", "#e8eef5", "#c2410c"
_PARTS = ("x", "y", "z")
_POINTS = 4000


def save_picture(survey: Survey, path: str | Path) -> None:
    """Draw the evidence and save it as PNG, SVG or PDF, by the ending of `path`."""
    figure = Figure(figsize=(13, 13.5), layout="constrained")
    grid = figure.add_gridspec(5, 2)
    session = survey.sessions[0]
    _times(figure.add_subplot(grid[0, :]), survey, session)
    _push(figure.add_subplot(grid[1, 0]), survey, session)
    _motion(figure.add_subplot(grid[1, 1]), survey, session)
    _weight(figure.add_subplot(grid[2, 0]), survey)
    _air(figure.add_subplot(grid[2, 1]), survey, session)
    _rigid(figure.add_subplot(grid[3, 0]), survey)
    _places(figure.add_subplot(grid[3, 1]), survey)
    _surface(figure.add_subplot(grid[4, 0]), survey)
    _words(figure.add_subplot(grid[4, 1]), survey)
    figure.savefig(path, dpi=110)


def _title(panel: Panel, finding: Finding) -> None:
    text = value_text(finding) if finding.claim else "cannot tell"
    panel.set_title(f"{finding.subject}: {text}", fontsize=10, loc="left")


def _without_data(panel: Panel, finding: Finding) -> None:
    """Say in place of a picture why there is none."""
    panel.set_axis_off()
    panel.text(0.02, 0.8, finding.evidence, transform=panel.transAxes, wrap=True, color=_MOTION)


def _along(survey: Survey, session: Session) -> tuple[Array, Array]:
    axes = survey.axes
    force = axes.force.direction if axes.force is not None else None
    motion = axes.displacement.direction if axes.displacement is not None else None
    push = session.net @ force if force is not None else np.linalg.norm(session.net, axis=1)
    if motion is not None:
        return push, session.position @ motion
    return push, np.linalg.norm(session.position - session.position[0], axis=1)


def _times(panel: Panel, survey: Survey, session: Session) -> None:
    push, way = _along(survey, session)
    times = session.times - session.streams.start
    panel.plot(times, push, color=_FORCE, linewidth=0.9)
    panel.set_ylabel("force [N]", color=_FORCE)
    panel.set_xlabel("time [s]")
    if session.leaves:
        for start, end in session.seconds():
            panel.axvspan(start, end, color=_CONTACT, zorder=0)
    beside = panel.twinx()
    beside.plot(times, 1e3 * (way - way.min()), color=_MOTION, linewidth=0.9)
    beside.set_ylabel("displacement [mm]", color=_MOTION)
    _title(panel, survey.finding("lift-off"))


def _push(panel: Panel, survey: Survey, session: Session) -> None:
    push, _ = _along(survey, session)
    for part, column in zip(_PARTS, session.net.T, strict=False):
        panel.plot(push[~session.turning], column[~session.turning], ".", markersize=2, label=part)
    panel.set_xlabel("force along its axis [N]")
    panel.set_ylabel("components [N]")
    panel.legend(fontsize=8)
    _title(panel, survey.finding("force axis"))


def _motion(panel: Panel, survey: Survey, session: Session) -> None:
    push, way = _along(survey, session)
    for contact in session.contacts[:12]:
        span = slice(contact.first, contact.last)
        panel.plot(1e3 * (way[span] - way[span][0]), push[span], linewidth=0.8)
    panel.set_xlabel("displacement along its axis in contact [mm]")
    panel.set_ylabel("force [N]")
    _title(panel, survey.finding("displacement axis"))


def _weight(panel: Panel, survey: Survey) -> None:
    finding, weight = survey.finding("tool mass"), survey.weight
    _title(panel, finding)
    if weight is None:
        _without_data(panel, finding)
        return
    streams = survey.sessions[0].streams
    load = weight.load(streams)
    if load is None:
        return
    times = streams.force_times - streams.start
    inside = np.zeros(times.size, dtype=bool)
    for start, end in weight.seconds:
        inside |= (times >= start) & (times <= end)
    thin = max(int(inside.sum()) // _POINTS, 1)
    for column, fitted in zip(streams.force[inside].T, load[inside].T, strict=True):
        level = float(np.mean(column - fitted))
        panel.plot(times[inside][::thin], column[::thin] - level, ".", markersize=1.5)
        panel.plot(times[inside], fitted, color=_LINE, linewidth=0.8)
    panel.set_xlabel("time [s]")
    panel.set_ylabel("force in the turns [N]")


def _air(panel: Panel, survey: Survey, session: Session) -> None:
    axis = survey.axes.force
    _title(panel, survey.finding("force drift"))
    if axis is None or not session.air.any():
        return
    times = session.times - session.streams.start
    level = session.force @ axis.direction
    panel.plot(times[session.air], level[session.air], ".", markersize=2, color=_FORCE)
    panel.plot(times, session.baseline @ axis.direction, color=_LINE, linewidth=0.8)
    panel.set_xlabel("time [s]")
    panel.set_ylabel("force in the air [N]")


def _rigid(panel: Panel, survey: Survey) -> None:
    finding = survey.finding("compliance")
    _title(panel, finding)
    axes = survey.axes
    if not survey.presses or axes.force is None or axes.displacement is None:
        _without_data(panel, finding)
        return
    for press in survey.presses:
        session, contact = press.session, press.contact
        span = slice(contact.first, contact.last)
        push = session.net[span] @ axes.force.direction
        stamps = session.times[span] + press.delay
        way = session.streams.position_at(stamps) @ axes.displacement.direction
        line = np.array([push.min(), push.max()])
        panel.plot(push, 1e3 * (way - way.mean()), ".", markersize=2)
        panel.plot(line, 1e3 * press.compliance * (line - push.mean()), color=_LINE, linewidth=0.8)
    panel.set_xlabel("force on something rigid [N]")
    panel.set_ylabel("displacement, delay taken out [mm]")


def _places(panel: Panel, survey: Survey) -> None:
    """Draw the touches as seen along the approach, by their distances from the plane."""
    scan = survey.scan
    panel.set_title("touches, seen along the approach", fontsize=10, loc="left")
    if not scan.touches:
        _without_data(panel, scan.finding)
        return
    into = np.mean([touch.approach for touch in scan.touches], axis=0)
    sideways = np.linalg.svd(into[None])[2][1:]
    places = 1e3 * np.array([touch.place for touch in scan.touches])
    x, y = sideways @ (places - places.mean(axis=0)).T
    off = 1e3 * scan.plane.residuals if scan.plane is not None else np.zeros(x.size)
    panel.plot(x, y, "o", color=_FORCE)
    for number, (across, along, away) in enumerate(zip(x, y, off, strict=True), start=1):
        text = f"{number}: {away:+.2f}" if scan.plane is not None else f"{number}"
        panel.annotate(
            text, (across, along), xytext=(5, 4), textcoords="offset points", fontsize=7
        )
    panel.margins(0.2)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("place [mm]; the numbers: distance from the plane [mm]")


def _surface(panel: Panel, survey: Survey) -> None:
    """Draw the depth of the touches along the way down of the fitted plane."""
    scan = survey.scan
    _title(panel, scan.finding)
    if scan.plane is None:
        _without_data(panel, scan.finding)
        return
    into = np.mean([touch.approach for touch in scan.touches], axis=0)
    into /= np.linalg.norm(into)
    aside = scan.plane.normal - float(scan.plane.normal @ into) * into
    if float(np.linalg.norm(aside)) < 1e-6:
        aside = np.linalg.svd(into[None])[2][1]
    down = -aside / np.linalg.norm(aside)
    apart = 1e3 * (np.array([touch.place for touch in scan.touches]) - scan.plane.centre)
    along, depth = apart @ down, apart @ into
    panel.plot(along, depth, "o", color=_FORCE)
    ends = np.array([along.min(), along.max()])
    slope = -float(scan.plane.normal @ down) / float(scan.plane.normal @ into)
    panel.plot(ends, slope * ends, color=_LINE, linewidth=0.8)
    panel.invert_yaxis()
    panel.set_xlabel("way down the fitted plane [mm]")
    panel.set_ylabel("first touch, along\nthe approach [mm]")


def _words(panel: Panel, survey: Survey) -> None:
    panel.axis("off")
    lines = []
    for name in ("delay", "force noise", "displacement noise", "force unit", "displacement unit"):
        finding = survey.finding(name)
        text = value_text(finding) if finding.claim else "cannot tell"
        lines.append(f"{name}: {text}")
    panel.text(0.0, 0.95, "\n".join(lines), va="top", transform=panel.transAxes, fontsize=10)
    delay = survey.finding("delay")
    panel.text(
        0.0, 0.5, delay.evidence, va="top", transform=panel.transAxes, fontsize=8, wrap=True
    )
