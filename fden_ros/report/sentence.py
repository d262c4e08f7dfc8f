# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A recording in one sentence: what was pressed, how stiff it is, and what to do next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from fden_ros.core.classification import UNKNOWN
from fden_ros.core.config import PipelineConfig
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import ContactSummary, Flag, is_path
from fden_ros.offline.advice import next_step
from fden_ros.offline.session import Session
from fden_ros.report.numbers import DASH, stiffness
from fden_ros.written import written

#: So many places are named one by one.
_EACH = 3


def sentence(session: Session) -> str:
    """Return what a recording says, in one sentence."""
    summaries = session.replay.summaries
    if is_path(summaries):
        return _of_path([summary for summary in summaries if summary.is_of_path])
    if session.config.is_continuous:
        return "No stiffness is known on the path: it takes a probe that palpates as it slides."
    if not summaries:
        return "No contact was found."
    # A place is known best at the end of its last contact.
    places = list({summary.site_id: summary for summary in summaries}.values())
    if len(places) > _EACH:
        return _of_many(places, session.config)
    parts = []
    for place in places:
        remedy = next_step(place, session.config)
        words = _what(place, session.geometry) + (f"; {remedy}" if remedy else "")
        parts.append(words if len(places) == 1 else f"site {place.site_id}: {words}")
    return _sentence(". ".join(part[0].upper() + part[1:] for part in parts))


def _what(place: ContactSummary, geometry: Geometry) -> str:
    """Return which tissue it is like, and how stiff at which depth."""
    found = DASH if place.flags & Flag.IMPLAUSIBLE else stiffness(place.apparent_stiffness, 3)
    depth = 1e3 * geometry.length * geometry.compression(max(place.max_strain, 0.0))
    words = f"{found} N/m at {written(depth, 2)} mm" if found != DASH else "stiffness not known"
    tissue = _tissue(place)
    return f"{tissue}, {words}" if tissue else words


def _tissue(place: ContactSummary) -> str:
    label = place.classes.label if place.classes is not None else ""
    if label == UNKNOWN:
        return "like no tissue of the library"
    return f"{label}-like" if label else ""


def _of_many(places: Sequence[ContactSummary], config: PipelineConfig) -> str:
    tissues = Counter(_tissue(place) or "of undetermined tissue" for place in places)
    listed = ", ".join(f"{count} {tissue}" for tissue, count in tissues.most_common())
    words = f"{len(places)} places, {listed}"
    values = [
        found.value
        for place in places
        if (found := place.apparent_stiffness) is not None and found.sd < found.value
    ]
    if values:
        words += f"; {written(min(values), 3)} to {written(max(values), 3)} N/m"
    steps = Counter(filter(None, (next_step(place, config) for place in places)))
    for step, count in steps.most_common(1):
        words += f"; at {count} of them {step}"
    return _sentence(words)


def _of_path(places: Sequence[ContactSummary]) -> str:
    values = [place.apparent_stiffness.value for place in places if place.apparent_stiffness]
    count = f"{len(places)} place{'s' if len(places) > 1 else ''}"
    low, high = (written(value, 3) for value in (min(values), max(values)))
    span = low if low == high else f"{low} to {high}"
    return f"{count} on the path whose stiffness is known: {span} N/m."


def _sentence(words: str) -> str:
    return words if words.endswith(".") else f"{words}."
