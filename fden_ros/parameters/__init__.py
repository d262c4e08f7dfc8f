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
