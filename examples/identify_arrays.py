# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Identify tissue from arrays of time [s], force [N] and displacement [m]; no ROS is needed."""

import numpy as np

import fden_ros

time, force, depth = np.loadtxt("examples/press.csv", delimiter=",", skiprows=1).T
probe = {"kind": "flat_punch", "area": 3.14e-4, "thickness": 0.02}
for contact in fden_ros.fit(time, force, 1e-3 * depth, geometry=probe).contacts:
    print(contact.G.value, contact.Gn.value)
