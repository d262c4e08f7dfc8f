# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tissue that the last press has softened: its stress is another multiple of the law's since.

Soft tissue is softer at the second press than at the first, and then about the same at each
(preconditioning; Fung 1993, section 7.3). G is multiplied by a factor, Gn and alpha stay.
"""

from __future__ import annotations

from fden_ros.core.estimation.unknowns import Lifetime, Unknown


def unknowns() -> tuple[Unknown, ...]:
    """Return what a press into tissue that was pressed before may differ by; or not, as likely."""
    return (
        Unknown(
            "softened",
            0.0,
            1.0,
            Lifetime.CONTACT,
            log_odds_of_zero=0.0,
            # By a fifth, as in preconditioning.
            of_law=(0.2, 0.0, 0.0),
        ),
    )
