# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Types of the arrays that the core computes with, and copies of what holds them."""

from __future__ import annotations

import copy
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Holder = TypeVar("Holder")
#: What an operation changes in place.
_CHANGED_IN_PLACE = (np.ndarray, list)


def own_copy(holder: Holder) -> Holder:
    """Return a copy with arrays and lists of its own; all else it shares with the original."""
    own = copy.copy(holder)
    for name, value in vars(holder).items():
        if isinstance(value, _CHANGED_IN_PLACE):
            setattr(own, name, value.copy())
    return own
