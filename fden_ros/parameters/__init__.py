# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the identifier: declared, checked, read from files, handed to the core.

One table (:mod:`~fden_ros.parameters.table`) drives the node's declarations, the checks, the
parameter files and the documentation. :func:`check` turns names and values into a frozen
:class:`Parameters`; :func:`pipeline_config` turns that into the core's configuration.

>>> check({"geometry.area": 2e-4}).geometry.area
0.0002
"""

from fden_ros.parameters.files import read_parameter_file, read_parameter_files
from fden_ros.parameters.parameter import Parameter, Value
from fden_ros.parameters.pipeline import (
    frames_config,
    geometry_of,
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
    "geometry_of",
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
