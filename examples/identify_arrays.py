# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

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
estimates = [o.estimate for o in outputs if isinstance(o, ContactSummary)]
print(*((e.linear_stiffness, e.nonlinear_stiffness) for e in estimates), sep="\n")
