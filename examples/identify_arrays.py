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

"""Identify tissue from arrays of time [s], force [N] and depth [mm]; no ROS is needed."""

import numpy as np

from fden_ros.core import ContactSummary, Pipeline
from fden_ros.parameters import pipeline_config, read_parameter_file

outputs = []
pipeline = Pipeline(pipeline_config(read_parameter_file("examples/probe.yaml")), outputs.append)
for time, force, depth in np.loadtxt("examples/press.csv", delimiter=",", skiprows=1):
    pipeline.add_displacement(round(1e9 * (1 + time)), 1e-3 * depth)  # [m], stamps above 0 [ns]
    pipeline.add_force(round(1e9 * (1 + time)), force)
pipeline.finish()
print(*(np.exp(o.estimate[:2]) for o in outputs if isinstance(o, ContactSummary)), sep="\n")
