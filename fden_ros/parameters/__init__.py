# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the identifier: declared, checked, read from files, handed to the core.

The fields of the core's configuration, and of :mod:`~fden_ros.parameters.table` what is of
messages and frames, drive the node's declarations, the checks and the parameter files.
:func:`check` turns names and values into a frozen :class:`Parameters`; :func:`pipeline_config`
completes the core's configuration in it.

>>> check({"geometry.area": 2e-4}).geometry.area
0.0002
"""

from fden_ros.parameters.files import read_parameter_file, read_parameter_files
from fden_ros.parameters.parameter import Parameter, Value
from fden_ros.parameters.pipeline import (
    frames_config,
    moves_probe,
    pipeline_config,
    surface_axis,
    takes_surface,
    tool_weight,
    uncertainty_of,
    unit_vector,
)
from fden_ros.parameters.table import (
    DEFAULT_HARDWARE_ID,
    NODE_PARAMETERS,
    PARAMETERS,
    Parameters,
    check,
)

__all__ = [
    "DEFAULT_HARDWARE_ID",
    "NODE_PARAMETERS",
    "PARAMETERS",
    "Parameter",
    "Parameters",
    "Value",
    "check",
    "frames_config",
    "moves_probe",
    "pipeline_config",
    "read_parameter_file",
    "read_parameter_files",
    "surface_axis",
    "takes_surface",
    "tool_weight",
    "uncertainty_of",
    "unit_vector",
]
