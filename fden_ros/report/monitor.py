# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A running identifier as a view for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rich import box
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fden_ros.advice import FLAGS
from fden_ros.control import Cause, Refusal
from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource, Status, TissueState
from fden_ros.offline.advice import against_the_law
from fden_ros.offline.known import known_alone
from fden_ros.report.numbers import DASH, law, slope_words, stiffness
from fden_ros.report.table import contact_table
from fden_ros.written import written

_COLOURS = {
    Status.NO_CONTACT: "cyan", Status.CONVERGING: "yellow", Status.CONVERGED: "green",
}  # fmt: skip
_LAST_CONTACTS = 6
#: Half width of the intervals, in standard deviations.
_DEVIATIONS = 2.0


@dataclass(frozen=True)
class MonitorView:
    """The content of the view; `None` and empty before the first message."""

    identifier: str
    state: TissueState | None = None
    age: float | None = None  #: of the state [s]
    rate: float = 0.0  #: of the estimates [Hz]
    refusal: Refusal | None = field(default_factory=lambda: Refusal(Cause.NEVER_HEARD))
    label: str = ""
    probabilities: Mapping[str, float] = field(default_factory=dict)
    summaries: tuple[ContactSummary, ...] = ()
    diagnostics: Mapping[str, str] = field(default_factory=dict)  #: words under ``message``
    gains: str = ""  #: of a force controller in the same namespace


def monitor_view(view: MonitorView) -> Group:
    """Return the view as something that rich prints."""
    parts: list[Panel | Table | Text] = [
        Panel(_present(view), title=view.identifier, box=box.ROUNDED, expand=False)
    ]
    if view.diagnostics.get("message", "identifying") not in ("", "identifying"):
        parts.append(Text(f"warning: {view.diagnostics['message']}", style="yellow"))
    if view.summaries:
        shown = view.summaries[-_LAST_CONTACTS:]
        known = {s.contact_id: words for s in shown if (words := known_alone(s))}
        parts.append(contact_table(shown, known))
        last = shown[-1].contact_id
        if last in known:
            words = f"contact {last}: {known[last]} is known; G and Gn are not known"
            parts.append(Text(f"{words}: {against_the_law(shown[-1])}"))
    return Group(*parts)


def monitor_line(view: MonitorView) -> str:
    """Return the view in one line, for a pipe or a file."""
    parts = [_status(view).plain]
    if view.state is not None:
        parts.append(f"contact {_contact(view.state)}")
        parts += [" ".join(f"{name} {words}".split()) for name, words in _parameters(view.state)]
    return "; ".join([*parts, f"next: {next_step(view)}"])


def next_step(view: MonitorView) -> str:
    """Return the one next step, by the node's diagnostics and the flags of the present contact."""
    said, state = view.diagnostics, view.state
    if not said:
        return (
            f"start {view.identifier} with autostart:=true, or "
            f"ros2 lifecycle set {view.identifier} configure, then activate"
        )
    problem = said.get("problem 1", "")
    if problem or "contacts" not in said:
        # Without values it is the reason why the node is not configured or activated.
        return problem or said["message"]
    if said["contacts"] == "0" and not (state and state.contact_id):
        return "hold the probe in the air for 2 s, then press"
    flags = state.flags if state else Flag.NONE
    if state and state.apparent_stiffness:
        # On a path no touch is expected.
        flags &= ~Flag.TOUCH_NOT_OBSERVED
    flagged = next((str(FLAGS[name]) for name in FLAGS if flags & Flag[name]), "")
    return flagged or said.get("last contact") or "nothing: it identifies"


def _present(view: MonitorView) -> Table:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    state, said = view.state, view.diagnostics
    table.add_row("status", _status(view))
    names = ("pairs per second", "lag", "rejected", "contacts", "sites")
    rates = [f"{name} {said[name]}" for name in names if name in said]
    table.add_row("rates", ", ".join([f"estimates {view.rate:.0f} Hz", *rates]))
    if state is not None:
        table.add_row("contact", _contact(state))
        for name, interval in _parameters(state):
            table.add_row(name, interval)
        table.add_row("law", law(state.estimate) or DASH)
        listed = ", ".join(f"{name} {value:.0%}" for name, value in view.probabilities.items())
        table.add_row("tissue", f"{view.label}   ({listed})" if view.label else "undetermined")
        words = "may be relied on" if view.refusal is None else str(view.refusal)
        table.add_row("controllers", Text(words, style="yellow" if view.refusal else "green"))
        if view.gains:
            table.add_row("gains", view.gains)
    table.add_row("next", next_step(view))
    return table


def _status(view: MonitorView) -> Text:
    if view.state is None or view.age is None:
        return Text("nothing received yet", style="red")
    if view.refusal is not None and view.refusal.cause is Cause.LOST:
        return Text(f"lost: no estimate for {view.age:.1f} s", style="bold red")
    status = view.state.status
    words = status.name.lower().replace("_", " ")
    flags = [flag.name.lower() for flag in Flag if flag and flag & view.state.flags and flag.name]
    if flags:
        words += "   flags: " + ", ".join(flags)
    return Text(words, style=_COLOURS.get(status, "red"))


def _contact(state: TissueState) -> str:
    parts = [f"{state.contact_id} at site {state.site_id}", state.phase.name.lower()]
    if state.signals is not None:
        parts += [f"strain {state.signals.strain:.3f}", f"stress {state.signals.stress:,.0f} Pa"]
    found = state.apparent_stiffness
    if found is not None:
        parts.append(f"{stiffness(found, 3)} N/m at {found.time_scale:g} s")
    if state.measured.loading is not None:
        parts.append(f"slope {slope_words(state.measured.loading)}")
    return ", ".join(parts)


def _parameters(state: TissueState) -> list[tuple[str, str]]:
    """Return the names of G, Gn and alpha, and each with its interval and certainty."""
    estimate = state.estimate
    if estimate is None:
        return [("G", DASH), ("Gn", DASH), ("α", DASH)]
    deviations, rows = estimate.deviations, []
    for name, index, unit in (("G", 0, " Pa s^α"), ("Gn", 1, "")):
        value, spread = math.exp(estimate.mean[index]), math.exp(_DEVIATIONS * deviations[index])
        shown, low, high = (written(x, 4) for x in (value, value / spread, value * spread))
        rows.append((name, f"{shown}   [{low}, {high}]{unit}   {_how_known(estimate, index)}"))
    order, half = estimate.fractional_order, _DEVIATIONS * deviations[2]
    words = _how_known(estimate, 2)
    if state.order_source in (OrderSource.GIVEN, OrderSource.LEARNED):
        words += f", {state.order_source.name.lower()}"
    rows.append(("α", f"{order:.3f}   [{order - half:.3f}, {order + half:.3f}]   {words}"))
    return rows


def _how_known(estimate: Estimate, index: int) -> str:
    """Return how well a parameter is known, in words."""
    if estimate.is_at_edge(index):
        return "at a limit of the prior"
    if estimate.knows(index):
        return "converged"
    return "converging" if estimate.determines(index) else "not determined"
