# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report as one page of HTML that needs nothing else: no network, no other file."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timezone
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from fden_ros import __version__
from fden_ros.core.estimation import ParameterSet
from fden_ros.core.input_warnings import unusual
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource, is_path
from fden_ros.offline.advice import remarks
from fden_ros.offline.session import DETAILED_CONTACTS, Contact, Session
from fden_ros.report import plots
from fden_ros.report.numbers import DASH, law, order, parameter, result, stiffness
from fden_ros.report.path_picture import draw_path
from fden_ros.report.sentence import sentence
from fden_ros.report.style import draw
from fden_ros.report.table import bracketed, label_words, status_words
from fden_ros.written import written

#: Stamps before this are no dates, but times since something else began.
_FIRST_DATE_NS = 946_684_800_000_000_000  # the year 2000
_OPEN_CONTACTS = 8
#: Of the picture of a path [inch].
_PATH_SIZE = (10.8, 5.0)

_SOURCES = {
    OrderSource.NONE: "",
    OrderSource.GIVEN: "given",
    OrderSource.PRIOR: "prior",
    OrderSource.LEARNED: "learned",
}


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
        facts=list(_facts(session)),
        sentence=sentence(session),
        headline=_headline(session),
        warnings=list(_warnings(session)),
        overview=plots.overview(session) if session.end_ns else None,
        comparison=_comparison(session, on_path=on_path),
        site_map=(
            plots.site_map(session) if any(s.position for s in summaries) and not on_path else None
        ),
        is_path=on_path,
        rows=[
            _row(s, on_path=on_path, alone=s.contact_id in session.replay.with_stiffness_alone)
            for s in summaries
        ],
        time_scale=f"{session.config.apparent_stiffness_time_scale:g}",
        contacts=[_contact(session, contact) for contact in detailed],
        left_out=0 if on_path else max(0, len(summaries) - DETAILED_CONTACTS),
        open_contacts=len(summaries) <= _OPEN_CONTACTS,
        parameters=sorted(session.parameters.as_dict().items()),
    )


def _comparison(session: Session, *, on_path: bool) -> str | None:
    summaries = session.replay.summaries
    if on_path:
        return draw(functools.partial(draw_path, summaries=summaries), _PATH_SIZE)
    return plots.comparison(session) if any(s.estimate for s in summaries) else None


def _facts(session: Session) -> Iterator[tuple[str, str]]:
    if session.start_ns >= _FIRST_DATE_NS:
        start = datetime.fromtimestamp(session.start_ns // 10**9, tz=timezone.utc)
        yield "Recorded", f"{start:%Y-%m-%d %H:%M:%S} UTC"
    yield "Length", f"{session.duration:.1f} s"
    for stream, name in session.replay.inputs.items():
        yield stream.capitalize(), name
    for line in session.replay.set_by_recording:
        yield "Set by the recording", line
    rejected = sum(session.replay.rejected.values())
    yield "Samples", f"{session.replay.samples:,}, {rejected:,} rejected"
    kind = session.parameters.geometry.kind.replace("_", " ")
    yield "Geometry", kind if session.geometry.is_stated else f"{kind}, sizes not stated"


def _headline(session: Session) -> str:
    summaries = session.replay.summaries
    if session.config.is_continuous or not summaries:
        return ""
    sites = len({summary.site_id for summary in summaries})
    converged = sum(summary.converged for summary in summaries)
    words = (
        f"{_count(len(summaries), 'contact')} at {_count(sites, 'site')}; "
        f"{'all' if converged == len(summaries) else converged or 'none'} converged"
    )
    known = (
        (sum(map(_knows_g_alone, summaries)), "G is known, Gn is not"),
        (len(session.replay.with_stiffness_alone), "N/m is known, G and Gn are not"),
    )
    return "; ".join([words, *(f"of {count} {what}" for count, what in known if count)]) + "."


def _knows_g_alone(summary: ContactSummary) -> bool:
    estimate = summary.estimate
    return (
        estimate is not None
        and not summary.converged
        and ParameterSet.LINEAR_STIFFNESS in estimate.known
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def _warnings(session: Session) -> Iterator[str]:
    for warning in session.replay.warnings:
        yield warning[:1].upper() + warning[1:] + "."
    rejected = session.replay.rejected
    for reason, count in rejected.items() if unusual(Counter(rejected)) else ():
        stream, _, why = reason.partition(".")
        were = f"{_count(count, 'sample')} of the {stream} {'was' if count == 1 else 'were'}"
        yield f"{were} rejected: {why.replace('_', ' ')}."
    summaries = session.replay.summaries
    if is_path(summaries):
        return
    linear = [str(s.contact_id) for s in summaries if _knows_g_alone(s)]
    if linear:
        yield f"Contact {', '.join(linear)}: G is known, Gn is not; see there why."
    alone = session.replay.with_stiffness_alone
    if alone:
        numbers = ", ".join(map(str, sorted(alone)))
        yield f"Contact {numbers}: N/m is known, G and Gn are not; see there why."
    unsure = [
        str(s.contact_id)
        for s in summaries
        if not (s.converged or _knows_g_alone(s) or s.contact_id in alone)
    ]
    if unsure:
        yield (f"Contact {', '.join(unsure)}: the data do not allow a conclusion; see there why.")
    tests = [(c.contact_id, c.innovations.test) for c in session.contacts]
    poor = [str(n) for n, test in tests if test and test.count >= 10 and test.mean_square > 2.0]
    if poor:
        yield (
            f"Contact {', '.join(poor)}: the innovations are larger than model and noise explain, "
            "so the intervals are too narrow."
        )


def _row(summary: ContactSummary, *, on_path: bool, alone: bool) -> dict[str, Any]:
    """Return a line of the table: texts, and a dash where there is nothing."""
    row = dict.fromkeys(("g", "gn", "boundary", "gi", "alpha", "apparent"), DASH)
    estimate = summary.estimate
    if estimate is not None and summary.is_of_path:
        row["alpha"] = order(estimate)
        if estimate.determines(1):
            row["gn"] = parameter(estimate, 1)
    elif estimate is not None:
        is_known = estimate.determines(1)
        boundary = estimate.boundary_strain
        sd = boundary * float(estimate.deviations[1])
        scale = written(estimate.exponential_scale, 3)
        row |= {
            "g": bracketed(parameter(estimate, 0)) if alone else parameter(estimate, 0),
            "gn": bracketed(parameter(estimate, 1)) if alone else parameter(estimate, 1),
            "boundary": result(boundary, sd, is_of_data=is_known),
            "gi": scale if is_known and estimate.determines(0) else f"({scale})",
            "alpha": f"{order(estimate)} {_SOURCES[summary.order_source]}".strip(),
        }
    if not summary.flags & Flag.IMPLAUSIBLE:
        row["apparent"] = stiffness(summary.apparent_stiffness)
    measured = summary.measured
    row["measured"], row["unloading"] = map(stiffness, (measured.loading, measured.unloading))
    return {
        **row,
        "id": summary.contact_id,
        "site": summary.site_id,
        "seconds": f"{(summary.end_ns - summary.start_ns) * 1e-9:.2f}",
        "strain": f"{summary.max_strain:.3f}",
        "force": written(summary.max_force, 3),
        "status": status_words(summary, on_path=on_path, alone=alone)
        + ("; G and Gn not" if alone else ""),
        "has_result": summary.converged or alone,
        "label": label_words(summary),
    }


def _contact(session: Session, contact: Contact) -> dict[str, Any]:
    summary = contact.summary
    assert summary is not None
    alone = summary.contact_id in session.replay.with_stiffness_alone
    states = contact.states.items
    drawings = []
    if any(state.signals is not None for state in states):
        drawings += [
            plots.signals(session, contact),
            plots.characteristic(session, contact, summary),
        ]
    if any(state.estimate is not None for state in states):
        drawings.append(plots.convergence(contact, session.truth.get(summary.site_id)))
    place = ""
    if summary.position is not None:
        place = (
            ", ".join(f"{round(1e3 * value, 1) + 0.0:.1f}" for value in summary.position) + " mm"
        )
        if summary.position_frame:
            place += f" in {summary.position_frame}"
    return {
        "row": _row(summary, on_path=False, alone=alone),
        "start": f"{(summary.start_ns - session.start_ns) * 1e-9:.2f}",
        "place": place,
        "remarks": list(remarks(summary, session.config)),
        "drawings": drawings,
        "law": law(summary.estimate),
        "test": contact.innovations.test,
        "classes": (
            list(zip(summary.classes.names, summary.classes.probabilities, strict=True))
            if summary.classes is not None
            else []
        ),
        "truth": session.truth.get(summary.site_id),
    }
