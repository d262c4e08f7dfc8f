# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the node decides, in words, for its log at the level of debug."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.outputs import Classification, ContactSummary, Flag, Output, Status, TissueState
from fden_ros.report.numbers import order, parameter


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
        self._contact_id = 0
        self._flags = Flag.NONE
        self._before = Status.UNKNOWN, ParameterSet.NONE

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
        if state.contact_id != self._contact_id:
            self._contact_id, self._flags = state.contact_id, Flag.NONE
            yield f"contact {state.contact_id} begins, at site {state.site_id}"
        raised = state.flags & ~self._flags & ~Flag.INPUT_REJECTED
        self._flags |= raised
        if raised:
            yield f"contact {state.contact_id}: flags raised: {_names(raised)}"
        known = state.estimate.known if state.estimate is not None else ParameterSet.NONE
        if (state.status, known) != self._before:
            statuses = (self._before[0], state.status)
            before, now = (status.name.lower().replace("_", " ") for status in statuses)
            found = f"{_estimate(state)}; known: {', '.join(known.names) or 'nothing'}"
            yield f"{before} -> {now}; {found}"
        self._before = state.status, known


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
    return f"G {parameter(estimate, 0)}, Gn {parameter(estimate, 1)}, alpha {order(estimate)}"


def _names(flags: Flag) -> str:
    return ", ".join(
        one.name.lower() for one in type(flags) if one and one.name is not None and one & flags
    )
