# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The live table of a running identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.text import Text

from fden_ros.core.outputs import ContactSummary, Status, TissueState
from fden_ros.report.numbers import parameter, stiffness
from fden_ros.report.table import contact_table

_COLOURS = {
    Status.NO_CONTACT: "dim",
    Status.CONVERGING: "yellow",
    Status.CONVERGED: "green",
    Status.STALE: "red",
}


def live_view(
    states: Sequence[TissueState],
    summaries: Sequence[ContactSummary],
    truth: Mapping[int, Mapping[str, Any]] | None = None,
) -> Group:
    """Return the table of finished contacts, and a line on the present state below it."""
    return Group(contact_table(summaries, truth), _present(states[-1] if states else None))


def _present(state: TissueState | None) -> Text:
    if state is None:
        return Text("waiting for the first estimate ...", style="dim")
    status = state.status.name.lower().replace("_", " ")
    parts = [f"now: {status}"]
    if state.signals is not None:
        parts.append(f"{state.phase.name.lower()}, strain {state.signals.strain:.3f}")
    in_contact = state.status in (Status.CONVERGING, Status.CONVERGED)
    if in_contact and state.estimate is not None:
        for index, name in enumerate(("G", "Gn")):
            parts.append(f"{name} {parameter(state.estimate, index, 4)}")
    found = state.apparent_stiffness
    if found is not None:
        parts.append(f"{stiffness(found, 3)} N/m at {found.time_scale:g} s")
    return Text("   ".join(parts), style=_COLOURS.get(state.status, ""))
