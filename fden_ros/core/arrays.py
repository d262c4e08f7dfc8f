# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
