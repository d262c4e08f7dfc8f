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

"""What the node decides, in words, for its log at the level of debug."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.outputs import (
    Classification,
    ContactSummary,
    Flag,
    Output,
    Status,
    TissueState,
)


class Decisions:
    """Compare each output with the one before; say what is new.

    Parameters
    ----------
    rejected : collections.Counter
        The pipeline's counts of rejected samples, which go on.
    """

    def __init__(self, rejected: Counter[str]) -> None:
        self._rejected = rejected
        self._rejected_before: Counter[str] = Counter()
        self._status = Status.UNKNOWN
        self._contact_id = 0
        self._flags = Flag.NONE
        self._known = ParameterSet.NONE

    def of(self, output: Output) -> Iterator[str]:
        """Yield the decisions that an output brings, a line each."""
        if isinstance(output, TissueState):
            yield from self._of_state(output)
        elif isinstance(output, ContactSummary):
            yield _of_summary(output)
        elif isinstance(output, Classification):
            label = output.classes.words if output.classes is not None else "undetermined"
            yield f"contact {output.contact_id}: {output.decision.name.lower()}, {label}"

    def _of_state(self, state: TissueState) -> Iterator[str]:
        if state.flags & Flag.INPUT_REJECTED:
            new = self._rejected - self._rejected_before
            self._rejected_before = self._rejected.copy()
            yield "rejected: " + ", ".join(f"{name} {n}" for name, n in sorted(new.items()))
        if state.status not in (Status.CONVERGING, Status.CONVERGED):
            if state.status is not self._status:
                yield f"{_words(self._status)} -> {_words(state.status)}"
            self._status = state.status
            return
        if state.contact_id != self._contact_id:
            self._contact_id = state.contact_id
            self._flags, self._known = Flag.NONE, ParameterSet.NONE
            yield f"contact {state.contact_id} begins, at site {state.site_id}"
        where = f"contact {state.contact_id}"
        raised = state.flags & ~self._flags & ~Flag.INPUT_REJECTED
        self._flags |= state.flags
        if raised:
            yield f"{where}: flags raised: {_names(raised)}"
        known = state.estimate.known if state.estimate is not None else ParameterSet.NONE
        if state.status is not self._status or known != self._known:
            yield (
                f"{where}: {_words(self._status)} -> {_words(state.status)}; {_estimate(state)}; "
                f"known: {', '.join(known.names) or 'nothing'}"
            )
        self._status, self._known = state.status, known


def _of_summary(summary: ContactSummary) -> str:
    status = "converged" if summary.converged else "not converged"
    end = "released" if summary.complete else "cut short"
    flags = _names(summary.flags)
    return (
        f"contact {summary.contact_id} ends: {status}, {end}, {summary.sample_count} samples, "
        f"strain up to {summary.max_strain:.3f}, force up to {summary.max_force:.3g} N"
        + (f"; flags: {flags}" if flags else "")
    )


def _estimate(state: TissueState) -> str:
    estimate = state.estimate
    if estimate is None:
        return "no estimate"
    return (
        f"G {estimate.linear_stiffness:.4g} ± {estimate.linear_stiffness_sd:.2g}, "
        f"Gn {estimate.nonlinear_stiffness:.4g} ± {estimate.nonlinear_stiffness_sd:.2g}, "
        f"alpha {estimate.fractional_order:.3f} ± {estimate.fractional_order_sd:.3f}"
    )


def _words(status: Status) -> str:
    return status.name.lower().replace("_", " ")


def _names(flags: Flag) -> str:
    return ", ".join(
        one.name.lower() for one in type(flags) if one and one.name is not None and one & flags
    )
