# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How far surface and zero of the force move: scales of what is stated, which are learned.

What is stated holds for any patient and any sensor. What both are on these is the same for all
contacts: each gives the evidence for several scales of what is stated (MacKay, Neural Computation
4 (1992) 415); the logarithms add up.

- The motion by a contact's record, with the law taken for exact, so that all it leaves out counts
  as motion. A random walk stands for smooth motion here, and smooth motion is mostly absorbed by
  G, Gn and alpha: the scale that is likely is 3 times too small for their errors.
  (Breathing of 0.3 and of 1 mm wants 0.06 and 0.2 mm in a second by the evidence, and 0.2 and
  0.6 mm for errors of one deviation.)
- The drift by the change d of the air's force over a contact,
  :math:`d \sim N(0, s^2 \sigma_d^2 T + \sigma^2)`, with s the scale and :math:`\sigma` what the
  noise leaves of d. A contact that contradicts what the ones before have told outweighs them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

#: Scales [1] of the stated motion and drift that are compared.
MOTION_SCALES = (1.0, 0.5, 0.25, 0.125, 0.0625)
DRIFT_SCALES = (4.0, 2.0, 1.0, 0.5, 0.25)
#: Least share of the stated motion that is believed [1]: below it creep of 20 mN in 2 s, which no
#: contact shows, would be the larger error.
LEAST_SHARE = 0.25

Evidence = tuple[float, ...]
#: Before any contact nothing is known of the motion, and more drift than is stated takes evidence.
NO_MOTION_EVIDENCE: Evidence = (0.0,) * len(MOTION_SCALES)
NO_DRIFT_EVIDENCE: Evidence = (-6.0, -3.0, 0.0, 0.0, 0.0)


def pooled(before: Evidence, contact: Sequence[float]) -> Evidence:
    """Return the logarithms of the evidence of all contacts, relative to the largest."""
    total = [a + b for a, b in zip(before, contact, strict=True)]
    highest = max(total)
    # No more than this speaks against a scale, so that one or two contacts under which the surface
    # moves outweigh any number before.
    return tuple(max(value - highest, -12.0) for value in total)


def motion_share(evidence: Sequence[float]) -> float:
    """Return the share of the stated motion that counts [1]: the largest that is likely."""
    return min(max(3.0 * largest_likely(MOTION_SCALES, evidence), LEAST_SHARE), 1.0)


def drift_evidence(change: float, noise_variance: float, stated_variance: float) -> Evidence:
    """Return the logarithms of the evidence of a change of the air's force for each scale.

    Parameters
    ----------
    change : float
        Of the air after a contact from that before it [N].
    noise_variance : float
        Of the change, without any drift in contact [N^2].
    stated_variance : float
        Of the stated drift over the time between [N^2].
    """
    variances = [noise_variance + scale**2 * stated_variance for scale in DRIFT_SCALES]
    return tuple(-0.5 * (change**2 / v + math.log(v)) for v in variances)


def largest_likely(scales: Sequence[float], evidence: Sequence[float]) -> float:
    """Return the first of the scales, which fall, whose log evidence is near the largest."""
    least = max(evidence) - 2.0
    return next(s for s, value in zip(scales, evidence, strict=True) if value >= least)
