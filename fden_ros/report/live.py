# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The live table of a running identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.text import Text

from fden_ros.core.outputs import ContactSummary, Status, TissueState
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
        estimate = state.estimate
        for name, value, deviation in (
            ("G", estimate.linear_stiffness, estimate.linear_stiffness_sd),
            ("Gn", estimate.nonlinear_stiffness, estimate.nonlinear_stiffness_sd),
        ):
            parts.append(f"{name} {value:.4g} ± {deviation:.2g}")
    if state.apparent_stiffness is not None:
        stiffness = state.apparent_stiffness
        parts.append(f"{stiffness.value:.3g} N/m at {stiffness.time_scale:g} s")
    return Text("   ".join(parts), style=_COLOURS.get(state.status, ""))
