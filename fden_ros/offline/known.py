# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether a contact has a result: N/m or the measured slope, where its law is not known."""

from __future__ import annotations

from fden_ros.core.outputs import ContactSummary, Flag


def known_stiffness(summary: ContactSummary) -> str:
    """Return which stiffness is known: ``N/m`` by an unflagged law, or ``slope``.

    Empty where neither is. N/m has to exceed one of its deviations, the limit for a number in
    the tables. With a wrong unit nothing is known. If no touch was seen, the law is not known,
    and the slope is.
    """
    if summary.flags & Flag.IMPLAUSIBLE:
        return ""
    by_law = summary.apparent_stiffness
    is_doubted = summary.flags & (
        Flag.AT_PRIOR_LIMIT | Flag.GEOMETRY_UNSTATED | Flag.TOUCH_NOT_OBSERVED
    )
    if by_law is not None and by_law.sd < by_law.value and not is_doubted:
        return "N/m"
    return "" if summary.measured.loading is None else "slope"


def known_alone(summary: ContactSummary) -> str:
    """Return which stiffness of a press is known without G; empty where none is, or G too."""
    estimate = summary.estimate
    if summary.converged or summary.is_of_path or (estimate is not None and estimate.knows(0)):
        return ""
    return known_stiffness(summary)
