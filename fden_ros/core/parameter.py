# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A parameter is declared once: as the field of the configuration that uses it.

The field's metadata holds what a user sees of it. Parameter files, their checks, the node's
declarations and the configuration itself are derived from it by
:mod:`fden_ros.parameters`.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from typing import Any

#: Least value of a parameter that must be above 0: the face of a tip of 1 nm has 3e-18 m^2.
TINY = 1e-18
#: Key of the metadata.
DESCRIBED = "described"


@dataclasses.dataclass(frozen=True)
class Described:
    """What a user sees of a parameter, but for its default."""

    name: str  #: in parameter files, with its group: ``force.noise``
    description: str
    unit: str = "1"  #: of SI
    #: Inclusive range of a number.
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()  #: what a text may be; empty: anything
    may_be_zero: bool = False  #: a number may be 0 outside its range, a vector all 0
    most: int = 0  #: largest length of a list; 0: it is a vector of three


def parameter(name: str, default: Any, *described: Any, **more: Any) -> Any:
    """Return the field of a dataclass that is a parameter; as `dataclasses.field`, of any type.

    The default (bool, int, float, tuple of float, str or enum.Enum) also fixes the type; of an
    enumeration, the choices. The others are fields of :class:`Described`, in their order.
    """
    if isinstance(default, enum.Enum):
        more["choices"] = tuple(member.value for member in type(default))
    own = Described(name, *described, **more)
    return dataclasses.field(default=default, metadata={DESCRIBED: own})
