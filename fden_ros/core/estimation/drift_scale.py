# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How far the force's zero drifts in contact, by the air after contacts: a scale that is learned.

What is stated is a deviation for any sensor. That of this one is the same for all contacts: each
gives the evidence of the change d of the air's force over it, for several scales s of the stated
drift,

.. math::
    d \sim N(0, s^2 \sigma_d^2 T + \sigma^2)

with :math:`\sigma` what the noise leaves of d; the logarithms add up. A contact that contradicts
what the ones before have told outweighs them.

References
----------
MacKay, Neural Computation 4 (1992) 415: the evidence for a scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from fden_ros.core.estimation.motion_scale import Evidence, largest_likely

#: Scales [1] of the stated drift that are compared.
DRIFT_SCALES = (4.0, 2.0, 1.0, 0.5, 0.25)
#: Before any contact: more than is stated takes evidence.
NO_DRIFT_EVIDENCE: Evidence = (-6.0, -3.0, 0.0, 0.0, 0.0)


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


def drift_share(evidence: Sequence[float]) -> float:
    """Return the share of the stated drift that counts [1]: the largest that is likely."""
    return largest_likely(DRIFT_SCALES, evidence)
