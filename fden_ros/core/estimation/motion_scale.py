# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How far the tissue's surface moves, by the evidence of contacts: a scale that is learned.

The way of the surface in a second is stated for any patient. What it is on this one is the same
for all contacts: where contact after contact is the law's to the noise, the surface rests. Each
contact gives the evidence of its record for several scales of the stated motion, with the law
taken for exact, so that all it leaves out counts as motion; the logarithms add up.

A random walk stands for smooth motion here, and smooth motion is mostly absorbed by G, Gn and
alpha: the scale that is likely is :data:`SMOOTH` times too small for their errors. (Breathing of
0.3 and of 1 mm wants 0.06 and 0.2 mm in a second by the evidence, and 0.2 and 0.6 mm for errors
of one deviation.)

References
----------
MacKay, Neural Computation 4 (1992) 415: the evidence for a scale.
"""

from __future__ import annotations

from collections.abc import Sequence

#: Scales [1] of the stated motion that are compared.
SCALES = (1.0, 0.5, 0.25, 0.125, 0.0625)
#: The motion that counts, in that of the likely walk [1].
SMOOTH = 3.0
#: Least share of the stated motion that is believed [1]: below it creep of 20 mN in 2 s, which no
#: contact shows, would be the larger error.
LEAST_SHARE = 0.25
#: A scale is likely within this much of the largest logarithm of the evidence [1].
_LIKELY = 2.0
#: What speaks against a scale counts at most as much as this [1], so that one or two contacts
#: under which the surface moves outweigh any number before.
_MOST = 12.0

Evidence = tuple[float, ...]
#: Nothing is known.
NO_EVIDENCE: Evidence = (0.0,) * len(SCALES)


def pooled(before: Evidence, contact: Sequence[float]) -> Evidence:
    """Return the logarithms of the evidence of all contacts, relative to the largest."""
    total = [a + b for a, b in zip(before, contact, strict=True)]
    highest = max(total)
    return tuple(max(value - highest, -_MOST) for value in total)


def share_of(evidence: Sequence[float]) -> float:
    """Return the share of the stated motion that counts [1]: the largest that is likely."""
    return min(max(SMOOTH * largest_likely(SCALES, evidence), LEAST_SHARE), 1.0)


def largest_likely(scales: Sequence[float], evidence: Sequence[float]) -> float:
    """Return the first of the scales, which fall, that is likely by the evidence [1]."""
    least = max(evidence) - _LIKELY
    return next(s for s, value in zip(scales, evidence, strict=True) if value >= least)
