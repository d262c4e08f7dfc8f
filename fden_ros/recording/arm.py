# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an arm's table needs, which holds vectors: along which axes its tool presses.

Without a configuration the tool presses along its own z, as on every flange: that axis is taken
from the orientations, or downwards where there are none.
"""

from __future__ import annotations

import math
from itertools import islice

import numpy as np

from fden_ros.core.streams import Vector, rotate
from fden_ros.errors import InputError
from fden_ros.parameters import Parameters, Value
from fden_ros.recording.table import TableReader

#: A tool that turns by more than this has no axis that is fixed in the base [rad]: at 5 degrees
#: the way along an axis is 0.4 % longer than the depth.
_STILL = math.radians(5.0)
#: The orientations of the first rows are looked at: 40 s at 500 Hz.
_MOST_ROWS = 20_000
_TOOL = (0.0, 0.0, 1.0)
_DOWN = (0.0, 0.0, -1.0)


def arm_values(
    table: TableReader, parameters: Parameters, from_touch: bool | None
) -> tuple[dict[str, Value], tuple[str, ...]]:
    """Return values of parameters that an arm's table needs, and a line on them.

    Parameters
    ----------
    table : TableReader
    parameters : Parameters
        A displacement.axis that is stated in it stays.
    from_touch : bool, optional
        As of a testing machine, which an arm is not.

    Raises
    ------
    InputError
        If it is to begin at the touch, or the tool's orientation is asked for and not there.
    """
    if from_touch:
        raise InputError(
            f"{table.path} holds vectors, --from-touch is for a machine's one direction: name its "
            "columns with --columns"
        )
    if parameters.displacement.along_tool and not table.has_turns:
        raise InputError(
            f"displacement.along_tool asks for the tool's orientation, which {table.path} does "
            "not hold"
        )
    default = Parameters()
    is_stated = parameters.displacement.axis != default.displacement.axis
    if is_stated or parameters.displacement.along_tool:
        return {}, ()
    axis, why = _axis_of(table)
    values: dict[str, Value] = {"displacement.along_tool": True}
    if axis is not None:
        values = {"displacement.axis": list(axis)}
    if parameters.force.axis == default.force.axis or (axis is None and not table.is_in_tool):
        is_turning = axis is None or table.is_in_tool
        values["force.axis"] = [0.0 - part for part in (_TOOL if is_turning else axis or _DOWN)]
    shown = ", ".join(f"{name} {str(value).lower()}" for name, value in values.items())
    return values, (f"{shown}, {why} (or state them)",)


def _axis_of(table: TableReader) -> tuple[Vector | None, str]:
    """Return the direction of the tool's z in the base; None where it turns; and why."""
    if not table.has_turns:
        return _DOWN, "because the tool is taken to press downwards"
    turns = (row.turn for row in islice(table.rows(), _MOST_ROWS))
    axes = np.array([rotate(turn, _TOOL) for turn in turns if turn is not None])
    if not axes.size:
        return _DOWN, "because the tool is taken to press downwards"
    mean = axes.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-300)
    if float((axes @ mean).min()) < math.cos(_STILL):
        return None, "because the tool turns, and is taken to press along its own z"
    x, y, z = (round(float(part), 4) + 0.0 for part in mean)
    return (x, y, z), "because the tool is taken to press along its own z"
