# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the identifier: declared, checked, read from files, handed to the core.

The fields of the core's configuration, and of :mod:`~fden_ros.parameters.table` what is of
messages and frames, drive the node's declarations, the checks and the parameter files. A name or a
value that is not allowed raises :class:`~fden_ros.errors.InputError`, in one line.

>>> check({"geometry.area": 2e-4}).geometry.area
0.0002
"""

from fden_ros.parameters.files import (
    ATTENTION_LINE,
    LIVE_LINE,
    OPEN_AXIS,
    Section,
    check_types,
    live_topics,
    open_axes,
    parse_yaml,
    read_parameter_file,
    read_parameter_files,
    read_sections,
    values_for,
)
from fden_ros.parameters.parameter import Parameter, Value
from fden_ros.parameters.pipeline import (
    direction,
    frames_config,
    pipeline_config,
    tool_weight,
    uncertainty_of,
)
from fden_ros.parameters.table import (
    NODE_PARAMETERS,
    PARAMETERS,
    Parameters,
    check,
    identifier_values,
)

__all__ = [
    "ATTENTION_LINE",
    "LIVE_LINE",
    "NODE_PARAMETERS",
    "OPEN_AXIS",
    "PARAMETERS",
    "Parameter",
    "Parameters",
    "Section",
    "Value",
    "check",
    "check_types",
    "direction",
    "frames_config",
    "identifier_values",
    "live_topics",
    "open_axes",
    "parse_yaml",
    "pipeline_config",
    "read_parameter_file",
    "read_parameter_files",
    "read_sections",
    "tool_weight",
    "uncertainty_of",
    "values_for",
]
