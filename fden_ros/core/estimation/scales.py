# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How large the law's errors and the surface's motion may be: hyperparameters on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from fden_ros.core.estimation.estimator_config import Uncertainty


class Scales(NamedTuple):
    """Standard deviations of the errors whose size the evidence decides."""

    kernel: float  #: of delta [1]
    characteristic: float  #: of epsilon [1]
    roughness: float  #: rho [1]
    motion: float  #: of the surface, over what is stated [1]


class WeighedScales(NamedTuple):
    """One place of the grid, and the logarithm of its prior probability."""

    scales: Scales
    log_prior: float = 0.0


#: Scales of the kernel's error and of the characteristic's, over the stated one of the latter [1]:
#: from a law that is exact to one that is hardly a law. A kernel that is nearly the law's is less
#: likely by the logarithm beside it, as is one that is hardly a law: 2 s of a hold look like a
#: power law, and the rest of it is none. Chosen on measured beef of one day, held on another's.
_KERNEL_FACTORS = ((0.001, -2.0), (0.1, -2.0), (1.0, 0.0), (2.0, 0.0), (4.0, -1.0))
_CHARACTERISTIC_FACTORS = (0.001, 0.1, 0.5, 1.65, 5.0)
#: Scales of the roughness, likewise; a law with no roughness has no other error either.
ROUGHNESS_FACTORS = (0.0, 0.05, 0.15, 0.5)
#: Scales of the surface's motion: as stated, and more. Evidence may widen it, never shrink.
MOTION_FACTORS = (1.0, 2.5)


def scales_of(uncertainty: Uncertainty) -> tuple[WeighedScales, ...]:
    """Return the grid of scales for what is stated of law and rig."""
    unit = uncertainty.characteristic_sd
    if not unit:
        return carried_scales(uncertainty)
    found = []
    for (i, (kernel, log_prior)), (j, characteristic), (r, roughness), motion in itertools.product(
        enumerate(_KERNEL_FACTORS),
        enumerate(_CHARACTERISTIC_FACTORS),
        enumerate(ROUGHNESS_FACTORS),
        _motions(uncertainty),
    ):
        # Errors of kernel and characteristic go together: places of the grid more than two apart
        # do not count, and by one apart a scale is less likely by e^-0.5.
        if abs(i - j) > 2 or (r == 0 and j > 0) or (r > 1 and j == 0):
            continue
        scales = Scales(kernel * unit, characteristic * unit, roughness * unit, motion)
        found.append(WeighedScales(scales, log_prior - 0.5 * (i - j) ** 2))
    return tuple(found)


def beside(grid: Sequence[WeighedScales], best: Scales) -> tuple[WeighedScales, ...]:
    """Return the places of a grid that are next to one, in each scale."""
    near = []
    for k, value in enumerate(best):
        values = sorted({weighed.scales[k] for weighed in grid})
        at = values.index(value)
        near.append(values[max(at - 1, 0) : at + 2])
    return tuple(w for w in grid if all(x in n for x, n in zip(w.scales, near, strict=True)))


def carried_scales(uncertainty: Uncertainty) -> tuple[WeighedScales, ...]:
    """Return the grid where there are no smooth errors, or earlier presses have told them."""
    unit = uncertainty.characteristic_sd
    roughness = ROUGHNESS_FACTORS if unit else (0.0,)
    return tuple(
        WeighedScales(Scales(0.0, 0.0, rough * unit, motion))
        for rough, motion in itertools.product(roughness, _motions(uncertainty))
    )


def _motions(uncertainty: Uncertainty) -> tuple[float, ...]:
    return MOTION_FACTORS if uncertainty.surface_motion_sd else (1.0,)
