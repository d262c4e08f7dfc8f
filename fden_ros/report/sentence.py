# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A recording in one sentence: how stiff it is, which tissue that is like, the next step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from fden_ros.core.classification import UNKNOWN
from fden_ros.core.config import PipelineConfig
from fden_ros.core.outputs import ContactSummary, Flag, is_path
from fden_ros.offline.advice import next_step
from fden_ros.offline.session import Session
from fden_ros.report.numbers import DASH, slope_words, stiffness
from fden_ros.written import written

#: This many places have a line each.
_EACH = 3


def sentence(session: Session) -> str:
    """Return the result of a recording, in one sentence for each place, or one for many."""
    said = [f"{before}{number}{after}" for before, number, after in lines(session)]
    return " ".join(one if one.endswith(".") else f"{one}." for one in said)


def lines(session: Session) -> list[tuple[str, str, str]]:
    """Return the place, its stiffness, and the rest, of each place or of many together."""
    summaries, config = session.replay.summaries, session.config
    if is_path(summaries):
        known = [summary for summary in summaries if summary.is_of_path]
        return [("", _range(known), f" at {len(known)} places on the path")]
    if config.is_continuous:
        words = ": the probe must palpate while it slides"
        return [("", "No stiffness is known on the path", words)]
    # The last contact of a place has the best estimate.
    places = list({summary.site_id: summary for summary in summaries}.values())
    if not places:
        return [("", "No contact was found", "")]
    if len(places) <= _EACH:
        names = [f"Site {place.site_id}: " * (len(places) > 1) for place in places]
        return [(n, *_of_one(one, config)) for n, one in zip(names, places, strict=True)]
    tissues = Counter(_tissue(place) or "of undetermined tissue" for place in places)
    words = ", ".join(f"{count} {tissue}" for tissue, count in tissues.most_common())
    steps = Counter(filter(None, (next_step(place, config) for place in places)))
    for step, count in steps.most_common(1):
        words += f"; at {count} of them {step}"
    return [("", _range(places), f" at {len(places)} places, {words}")]


def _of_one(place: ContactSummary, config: PipelineConfig) -> tuple[str, str]:
    geometry, found, measured = config.geometry, place.apparent_stiffness, place.measured.loading
    depth = 1e3 * geometry.length * geometry.compression(max(place.max_strain, 0.0))
    number, rest = "Stiffness not known", ""
    if Flag.IMPLAUSIBLE not in place.flags and stiffness(found) != DASH:
        number, rest = f"{stiffness(found, 4)} N/m", f" at {written(depth, 2)} mm"
    elif Flag.IMPLAUSIBLE not in place.flags and measured is not None:
        number, rest = f"Slope {slope_words(measured)}", ", as measured"
    tissue, remedy = _tissue(place), next_step(place, config)
    return number, rest + f", {tissue}" * bool(tissue) + f"; {remedy}" * bool(remedy)


def _tissue(place: ContactSummary) -> str:
    label = place.classes.label if place.classes is not None else ""
    if label == UNKNOWN:
        return "like no tissue of the library"
    return f"{label}-like" if label else ""


def _range(places: Sequence[ContactSummary]) -> str:
    found = [place.apparent_stiffness for place in places]
    values = [one.value for one in found if one is not None and one.sd < one.value]
    if not values:
        return "Stiffness not known"
    low, high = (written(value, 3) for value in (min(values), max(values)))
    return f"{low} N/m" if low == high else f"{low} to {high} N/m"
