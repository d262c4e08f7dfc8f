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


def parameter(
    name: str,
    default: Any,
    description: str,
    unit: str = "1",
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    choices: tuple[str, ...] = (),
    may_be_zero: bool = False,
    most: int = 0,
) -> Any:
    """Return the field of a dataclass that is a parameter; as `dataclasses.field`, of any type.

    Parameters
    ----------
    name : str
        In parameter files, with its group: ``force.noise``.
    default : bool, int, float, tuple of float, str or enum.Enum
        Also fixes the type; of an enumeration, the choices.
    description : str
        Seen by users.
    unit : str
        SI unit.
    minimum, maximum : float
        Inclusive range of a number.
    choices : tuple of str
        What a text may be; empty: anything.
    may_be_zero : bool
        A number may be 0 outside its range, a vector all 0.
    most : int
        Largest length of a list; 0: it is a vector of three.
    """
    if isinstance(default, enum.Enum):
        choices = tuple(member.value for member in type(default))
    metadata = {
        "name": name,
        "description": description,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "may_be_zero": may_be_zero,
        "most": most,
    }
    return dataclasses.field(default=default, metadata=metadata)
