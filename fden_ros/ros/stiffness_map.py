# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The touched sites as a stiffness map: pure building of messages."""

from __future__ import annotations

import array
import math
from collections import OrderedDict

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from fden_ros.core.outputs import WITHHELD, ContactSummary
from fden_ros.ros.messages import to_stamp

#: The map holds the 1,000 newest sites: a cloud of 80 kB.
_MOST_SITES = 1000
#: x, y, z in RViz's format; the rest from the next multiple of 8 bytes on.
_COORDINATES = ("x", "y", "z")
_VALUES = ("G", "Gn", "alpha", "G_sd", "Gn_sd", "alpha_sd", "stiffness", "stiffness_sd")
_POINT = np.dtype(
    {
        "names": [*_COORDINATES, *_VALUES],
        "formats": ["<f4"] * len(_COORDINATES) + ["<f8"] * len(_VALUES),
        "offsets": [*range(0, 12, 4), *range(16, 16 + 8 * len(_VALUES), 8)],
    }
)
_DATATYPES = {"<f4": PointField.FLOAT32, "<f8": PointField.FLOAT64}


class StiffnessMap:
    """The newest summary of every site whose position is known."""

    def __init__(self) -> None:
        self._sites: OrderedDict[int, ContactSummary] = OrderedDict()
        self._newest: ContactSummary | None = None

    def __contains__(self, summary: ContactSummary) -> bool:
        """Return whether this summary was the map's last change."""
        return self._newest is summary

    def add(self, summary: ContactSummary) -> bool:
        """Add a summary; return whether the map has changed: not by an uncertain one."""
        site_id = summary.site_id
        if summary.position is None or summary.flags & WITHHELD:
            return False
        if summary.estimate is None:
            # A contact that was invalidated removes its site from the map.
            known = self._sites.get(site_id)
            if known is None or known.contact_id != summary.contact_id:
                return False
            del self._sites[site_id]
        else:
            self._sites[site_id] = summary
        self._newest = summary
        while len(self._sites) > _MOST_SITES:
            self._sites.popitem(last=False)
        return True

    def cloud(self) -> PointCloud2:
        """Return the sites as points: float32 ``x, y, z``, float64 values and deviations.

        Points share one frame: sites in another frame than the newest summary's are left out.
        """
        newest = self._newest
        frame_id = newest.position_frame if newest is not None else ""
        sites = [s for s in self._sites.values() if s.position_frame == frame_id]
        stamp = to_stamp(newest.stamp_ns if newest is not None else 0)
        points = np.array([_values_of(summary) for summary in sites], _POINT)
        return cloud_of_points(points, Header(stamp=stamp, frame_id=frame_id))


def cloud_of_points(points: np.ndarray, header: Header) -> PointCloud2:
    """Return a structured array as a cloud with one field per name."""
    kind = points.dtype
    return PointCloud2(
        header=header,
        height=1,
        width=points.size,
        fields=[
            PointField(name=name, offset=offset, datatype=_DATATYPES[own.str], count=1)
            for name, (own, offset, *_) in (kind.fields or {}).items()
        ],
        point_step=kind.itemsize,
        row_step=points.nbytes,
        data=array.array("B", points.tobytes()),
        is_dense=True,
    )


def _values_of(summary: ContactSummary) -> tuple[float, ...]:
    estimate, stiffness = summary.estimate, summary.apparent_stiffness
    assert estimate is not None and summary.position is not None
    return (
        *summary.position,
        estimate.linear_stiffness,
        estimate.nonlinear_stiffness,
        estimate.fractional_order,
        estimate.linear_stiffness_sd,
        estimate.nonlinear_stiffness_sd,
        estimate.fractional_order_sd,
        stiffness.value if stiffness is not None else math.nan,
        stiffness.sd if stiffness is not None else math.nan,
    )
