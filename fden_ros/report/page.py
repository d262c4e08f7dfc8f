# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report as one self-contained page of HTML: no network, no other file."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timezone
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from fden_ros import __version__
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource, is_path
from fden_ros.offline.advice import findings
from fden_ros.offline.session import DETAILED_CONTACTS, Contact, Session
from fden_ros.report import plots
from fden_ros.report.numbers import (
    DASH,
    bracketed,
    law,
    order,
    parameter,
    result,
    slope_words,
    stiffness,
)
from fden_ros.report.sentence import lines
from fden_ros.report.table import label_words, status_words
from fden_ros.written import written

#: Earlier stamps are no dates, but times since another zero.
_FIRST_DATE_NS = 946_684_800_000_000_000  # the year 2000
_OPEN_CONTACTS = 8
#: Columns of a press that a place on a path lacks.
_OF_PRESSES = ("G [Pa s^α]", "max strain", "tissue")


Facts = Iterator[tuple[str, str]]


def page(session: Session) -> str:
    """Return the report as HTML."""
    environment = Environment(
        loader=PackageLoader("fden_ros.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    summaries = session.replay.summaries
    on_path = is_path(summaries)
    detailed = [] if on_path else session.contacts[:DETAILED_CONTACTS]
    return environment.get_template("page.html").render(
        name=session.path.name,
        version=__version__,
        lines=lines(session),
        facts=list(_facts(session)),
        warnings=[f"{one[:1].upper()}{one[1:]}." for one in session.replay.warnings],
        drawings=list(_drawings(session, on_path=on_path)),
        is_path=on_path,
        rows=[_row(summary, session, on_path=on_path) for summary in summaries],
        time_scale=f"{session.config.apparent_stiffness_time_scale:g}",
        contacts=[_contact(session, contact) for contact in detailed],
        left_out=0 if on_path else max(0, len(summaries) - DETAILED_CONTACTS),
        open_contacts=len(summaries) <= _OPEN_CONTACTS,
        parameters=sorted(session.parameters.as_dict().items()),
    )


def _drawings(session: Session, *, on_path: bool) -> Iterator[str]:
    summaries = session.replay.summaries
    if session.trace.end_ns:
        yield plots.overview(session)
    if on_path:
        yield plots.path(summaries)
    elif any(s.position for s in summaries):
        yield plots.site_map(session)
    if not on_path and len([s for s in summaries if s.estimate]) > 1:
        yield plots.comparison(session)


def _facts(session: Session) -> Facts:
    start_ns = session.trace.start_ns
    if start_ns >= _FIRST_DATE_NS:
        start = datetime.fromtimestamp(start_ns // 10**9, tz=timezone.utc)
        yield "Recorded", f"{start:%Y-%m-%d %H:%M:%S} UTC"
    yield "Length", f"{session.seconds(session.trace.end_ns):.1f} s"
    for stream, name in session.replay.inputs.items():
        yield stream.capitalize(), name
    for line in session.replay.set_by_recording:
        yield "Set by the recording", line
    rejected = [f"{count:,} rejected ({why})" for why, count in session.replay.rejected.items()]
    yield "Samples", ", ".join([f"{session.replay.samples:,}", *rejected])
    kind = session.parameters.geometry.kind.replace("_", " ")
    yield "Geometry", kind if session.config.geometry.is_stated else f"{kind}, sizes not stated"


def _row(summary: ContactSummary, session: Session, *, on_path: bool) -> dict[str, Any]:
    """Return a line of the table: texts by their heading, and whether there is a result."""
    alone = summary.contact_id in session.replay.with_stiffness_alone
    estimate = summary.estimate
    g = g_n = alpha = DASH
    if estimate is not None:
        g, g_n = (parameter(estimate, index) for index in (0, 1))
        g, g_n = (bracketed(g), bracketed(g_n)) if alone else (g, g_n)
        alpha = order(estimate)
        if summary.order_source is not OrderSource.NONE and not on_path:
            alpha += f" {summary.order_source.name.lower()}"
        if on_path and not estimate.determines(1):
            g_n = DASH
    is_plausible = Flag.IMPLAUSIBLE not in summary.flags
    cells = {
        "#": summary.contact_id,
        "site": summary.site_id,
        "N/m": stiffness(summary.apparent_stiffness) if is_plausible else DASH,
        "slope [N/m]": slope_words(summary.measured.loading).replace(" N/m", ""),
        "G [Pa s^α]": g,
        "Gn": g_n,
        "α": alpha,
        "max strain": f"{summary.max_strain:.3f}",
        "max force [N]": written(summary.max_force, 3),
        "duration [s]": f"{(summary.end_ns - summary.start_ns) * 1e-9:.2f}",
        "status": status_words(summary, on_path=on_path, alone=alone),
        "tissue": label_words(summary),
    }
    cells = {k: text for k, text in cells.items() if not (on_path and k in _OF_PRESSES)}
    return {"cells": cells, "has_result": summary.converged or alone or summary.is_of_path}


def _contact(session: Session, contact: Contact) -> dict[str, Any]:
    summary = contact.summary
    assert summary is not None
    states, truth = contact.states, session.truth.get(summary.site_id)
    found = map(str, findings(summary, session.config))
    drawings = []
    if any(state.signals is not None for state in states):
        drawings += [plots.signals(session, contact)]
        drawings += [plots.characteristic(session, contact, summary)]
    if any(state.estimate is not None for state in states):
        drawings += [plots.convergence(contact, truth)]
    classes = summary.classes
    return {
        "id": summary.contact_id,
        "title": f"site {summary.site_id}, at {session.seconds(summary.start_ns):.2f} s",
        "facts": list(_contact_facts(summary, truth)),
        "remarks": [f"{one[:1].upper()}{one[1:]}." for one in found],
        "drawings": drawings,
        "classes": list(zip(classes.names, classes.probabilities, strict=True)) if classes else [],
    }


def _contact_facts(summary: ContactSummary, truth: dict[str, Any] | None) -> Facts:
    """Yield the details beyond the table."""
    if summary.position is not None:
        place = ", ".join(f"{round(1e3 * value, 1) + 0.0:.1f}" for value in summary.position)
        frame = f" in {summary.position_frame}" if summary.position_frame else ""
        yield "Position", f"{place} mm{frame}"
    estimate = summary.estimate
    if estimate is not None:
        boundary, is_known = estimate.boundary_strain, estimate.determines(1)
        sd = boundary * float(estimate.deviations[1])
        scale = written(estimate.exponential_scale, 3)
        yield "1/Gn", result(boundary, sd, is_of_data=is_known)
        yield "Gi [Pa s^α]", scale if is_known and estimate.determines(0) else f"({scale})"
        if words := law(estimate):
            yield "Difference from the law", words
    yield "Slope of unloading", slope_words(summary.measured.unloading)
    if truth:
        g, g_n = truth["linear_stiffness"], truth["nonlinear_stiffness"]
        yield "Truth (simulated)", f"G {g:.1f}, Gn {g_n:.3f}"
