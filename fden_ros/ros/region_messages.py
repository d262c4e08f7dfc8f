# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of a region as messages: a cloud of its cells, a boundary of what is stiffer."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from fden_ros.core.arrays import Array
from fden_ros.planning.region import Region, RegionMap
from fden_ros.ros.stiffness_map import cloud_of_points

FIELDS = ("x", "y", "z", "log_stiffness", "log_stiffness_sd", "probability")
_LINE = 5e-4  #: width of the boundary [m]


def cloud_of(region: Region, found: RegionMap, height: float, header: Header) -> PointCloud2:
    """Return the cells as points: x, y, z [m], ln of N/m, its deviation, P(stiffer); float32."""
    z = np.full(len(region.cells), height)
    rows = np.column_stack([region.cells, z, found.mean, found.sd, found.probability])
    points = np.array(list(map(tuple, rows.tolist())), [(name, "<f4") for name in FIELDS])
    return cloud_of_points(points, header)


def boundary_of(sides: Array, height: float, header: Header) -> Marker:
    """Return sides (n, 2, 2) around what is stiffer as one marker, which may be empty."""
    marker = Marker(header=header, ns="boundary", type=Marker.LINE_LIST)
    marker.points = [Point(x=x, y=y, z=height) for x, y in sides.reshape(-1, 2).tolist()]
    marker.action = Marker.ADD if marker.points else Marker.DELETE
    marker.scale = Vector3(x=_LINE, y=0.0, z=0.0)
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(r=1.0, g=0.3, b=0.1, a=1.0)
    return marker
