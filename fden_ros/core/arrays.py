# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Types of the arrays that the core computes with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

#: Standard deviations [1] within which a value lies with 95 %, beyond which it is clearly another,
#: and beyond which it does not differ by chance, however many values are compared.
LIKELY, CLEAR, NOT_BY_CHANCE = 2.0, 3.0, 5.0
