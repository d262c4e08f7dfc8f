# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether a contact has a result: its stiffness in N/m, where its law is not known."""

from __future__ import annotations

from fden_ros.core.outputs import ContactSummary, Flag


def knows_stiffness(summary: ContactSummary) -> bool:
    """Whether N/m is known of a contact: as measured, or by a law that nothing stands against.

    As measured it is stated from four of its deviations on; by the law it has to be larger than
    one, from where on it is shown as a number. Without a geometry it is as measured alone. Where a
    unit is wrong nothing is known, nor where no touch was seen: there the signs may be wrong, and
    the air the contact.
    """
    if summary.flags & (Flag.IMPLAUSIBLE | Flag.TOUCH_NOT_OBSERVED):
        return False
    if summary.flags & Flag.GEOMETRY_UNSTATED:
        return summary.measured.loading is not None
    by_law = summary.apparent_stiffness
    is_law = by_law is not None and by_law.sd < by_law.value
    is_doubted = bool(summary.flags & Flag.AT_PRIOR_LIMIT)
    return summary.measured.loading is not None or (is_law and not is_doubted)


def knows_stiffness_alone(summary: ContactSummary) -> bool:
    """Whether N/m is known of a press, and not G."""
    estimate = summary.estimate
    if summary.converged or summary.is_of_path or (estimate is not None and estimate.knows(0)):
        return False
    return knows_stiffness(summary)
