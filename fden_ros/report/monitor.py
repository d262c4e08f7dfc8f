# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A running identifier as a view for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich import box
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fden_ros.control.live_tissue import Refusal
from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource, Status, TissueState
from fden_ros.report.chart import Chart
from fden_ros.report.limits import interval_limits
from fden_ros.report.numbers import DASH, law, stiffness
from fden_ros.report.table import contact_table

_COLOURS = {
    Status.NO_CONTACT: "cyan",
    Status.CONVERGING: "yellow",
    Status.CONVERGED: "green",
    Status.STALE: "red",
}
_LAST_CONTACTS = 6
#: Half width of the intervals, in standard deviations.
_DEVIATIONS = 2.0
#: Curves show at least this [s].
_LEAST_SPAN = 5.0
#: Logarithms of an interval's width beyond this are drawn as this.
_LARGEST_LOG = 600.0
#: An interval whose ends are within this factor [1] says where the axis of G lies.
_NARROW = 4.0


@dataclass(frozen=True)
class MonitorView:
    """What is shown; `None` and empty where nothing has been heard yet."""

    identifier: str
    state: TissueState | None = None
    age: float | None = None  #: of the state [s]
    rate: float = 0.0  #: of the estimates [Hz]
    refusal: Refusal | None = Refusal.NEVER_HEARD
    label: str = ""
    probabilities: Mapping[str, float] = field(default_factory=dict)
    summaries: tuple[ContactSummary, ...] = ()
    diagnostics: Mapping[str, str] = field(default_factory=dict)  #: words under ``message``
    gains: str = ""  #: of a force controller beside it
    trace: Trace | None = None


@dataclass(frozen=True)
class Trace:
    """The newest seconds, oldest first; arrays of shape (n,), NaN where there is nothing."""

    ages: Array  #: time before now [s]
    stress: Array  #: [Pa]
    linear_stiffness: Array  #: G [Pa s^alpha]
    low: Array  #: lower end of its interval
    high: Array
    stress_per_force: float | None = None  #: [Pa/N]; None: not known
    span: float = 20.0  #: shown at most [s]


def trace_row(state: TissueState) -> tuple[float, float, float, float]:
    """Return stress [Pa], G and the ends of its interval in a contact; NaN where not known."""
    stress = state.signals.stress if state.signals is not None else math.nan
    if state.estimate is None or state.status not in (Status.CONVERGING, Status.CONVERGED):
        return stress, math.nan, math.nan, math.nan
    value = state.estimate.linear_stiffness
    spread = math.exp(min(_DEVIATIONS * float(state.estimate.deviations[0]), _LARGEST_LOG))
    return stress, value, value / spread, value * spread


def monitor_view(view: MonitorView, truth: Mapping[int, Mapping[str, Any]] | None = None) -> Group:
    """Return the view as something that rich prints; `truth` as for :func:`contact_table`."""
    parts: list[Panel | Table | Text] = [
        Panel(_present(view), title=view.identifier, box=box.ROUNDED, expand=False),
        *_warnings(view),
    ]
    if view.trace is not None and view.trace.ages.size:
        parts.append(_charts(view.trace))
    if view.summaries:
        parts.append(contact_table(view.summaries[-_LAST_CONTACTS:], truth))
    return Group(*parts)


def _charts(trace: Trace) -> Table:
    quantity, values = "stress [Pa]", trace.stress
    if trace.stress_per_force is not None:
        quantity, values = "force [N]", trace.stress / trace.stress_per_force
    finite = values[np.isfinite(values)]
    top = 1.1 * float(finite.max(initial=0.0)) or 1.0
    bottom = 1.1 * float(finite.min(initial=0.0))
    stiffness = trace.linear_stiffness
    # The prior, at the touch, would flatten the rest.
    is_known = trace.high < _NARROW * trace.low
    counts = is_known if is_known.any() else np.isfinite(stiffness)
    low, high = interval_limits(stiffness[counts], trace.low[counts], trace.high[counts])
    limits = max(low, 0.0), high
    span = min(trace.span, max(_LEAST_SPAN, math.ceil(trace.ages[0])))
    table = Table.grid(padding=(0, 1, 0, 0), expand=True)
    table.add_column(ratio=1)
    table.add_column(ratio=1)
    table.add_row(
        Chart(quantity, trace.ages, values, (bottom, top), span=span),
        Chart(
            "G [Pa s^α], ±2 sd",
            trace.ages,
            stiffness,
            limits,
            trace.low,
            trace.high,
            span=span,
        ),
    )
    return table


def _present(view: MonitorView) -> Table:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    state = view.state
    table.add_row("status", _status(view))
    table.add_row("rates", _rates(view))
    if state is None:
        return table
    table.add_row("contact", _contact(state))
    for name, interval in _parameters(state):
        table.add_row(name, interval)
    table.add_row("law", law(state.estimate) or DASH)
    table.add_row("tissue", _tissue(view))
    usable = view.refusal is None
    words = "may be relied on" if usable or view.refusal is None else view.refusal.value
    table.add_row("controllers", Text(words, style="green" if usable else "yellow"))
    if view.gains:
        table.add_row("gains", view.gains)
    return table


def _status(view: MonitorView) -> Text:
    if view.state is None or view.age is None:
        return Text("nothing heard yet", style="red")
    if view.refusal is Refusal.LOST:
        return Text(f"lost: no estimate for {view.age:.1f} s", style="bold red")
    status = view.state.status
    words = status.name.lower().replace("_", " ")
    flags = [flag.name.lower() for flag in Flag if flag and flag & view.state.flags and flag.name]
    if flags:
        words += "   flags: " + ", ".join(flags)
    return Text(words, style=_COLOURS.get(status, "red"))


def _rates(view: MonitorView) -> str:
    parts = [f"estimates {view.rate:.0f} Hz"]
    parts += [
        f"{name} {view.diagnostics[name]}"
        for name in ("pairs per second", "rejected", "contacts", "sites")
        if name in view.diagnostics
    ]
    return ", ".join(parts)


def _contact(state: TissueState) -> str:
    parts = [f"{state.contact_id} at site {state.site_id}", state.phase.name.lower()]
    if state.signals is not None:
        parts += [f"strain {state.signals.strain:.3f}", f"stress {state.signals.stress:.0f} Pa"]
    found = state.apparent_stiffness
    if found is not None:
        parts.append(f"{stiffness(found, 3)} N/m at {found.time_scale:g} s")
    return ", ".join(parts)


def _parameters(state: TissueState) -> list[tuple[str, str]]:
    estimate = state.estimate
    if estimate is None:
        return [("G", DASH), ("Gn", DASH), ("α", DASH)]
    deviations = estimate.deviations
    rows = []
    for name, index, unit in (("G", 0, "Pa s^α"), ("Gn", 1, "")):
        value, spread = math.exp(estimate.mean[index]), math.exp(_DEVIATIONS * deviations[index])
        interval = f"{value:.4g}   [{value / spread:.4g}, {value * spread:.4g}] {unit}".rstrip()
        rows.append((name, f"{interval}   {_how_known(estimate, index)}"))
    order, half = estimate.fractional_order, _DEVIATIONS * deviations[2]
    words = [_how_known(estimate, 2)]
    if state.order_source in (OrderSource.GIVEN, OrderSource.LEARNED):
        words.append(state.order_source.name.lower())
    interval = f"{order:.3f}   [{order - half:.3f}, {order + half:.3f}]"
    rows.append(("α", f"{interval}   {', '.join(words)}"))
    return rows


def _how_known(estimate: Estimate, index: int) -> str:
    """Return how far a parameter is known, in words."""
    if estimate.is_at_edge(index):
        return "at the edge of what can be represented"
    if estimate.knows(index):
        return "converged"
    return "converging" if estimate.determines(index) else "not determined"


def _tissue(view: MonitorView) -> str:
    if not view.label:
        return "undetermined"
    shares = ", ".join(f"{name} {share:.0%}" for name, share in view.probabilities.items())
    return f"{view.label}   ({shares})"


def _warnings(view: MonitorView) -> list[Text]:
    words = view.diagnostics.get("message", "")
    if not words or words == "identifying":
        return []
    return [Text(f"warning: {words}", style="yellow")]
