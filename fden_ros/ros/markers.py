# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The touched sites as markers and as a stiffness map: pure building of messages."""

from __future__ import annotations

import array
import math
from collections import OrderedDict

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.outputs import WITHHELD, ContactSummary
from fden_ros.ros.messages import to_stamp

#: Linear stiffness [Pa s^alpha] at the ends of the colours.
_SOFTEST, _STIFFEST = 200.0, 5000.0
#: Viridis, from soft to stiff: to be told apart in grey and by the colour-blind too.
_COLOURS = np.array(
    [
        (0.267, 0.005, 0.329),
        (0.230, 0.322, 0.546),
        (0.128, 0.567, 0.551),
        (0.369, 0.789, 0.383),
        (0.993, 0.906, 0.144),
    ]
)
#: A relative deviation of G of 10 % is drawn half transparent.
_HALF_TRANSPARENT = 0.1
_LEAST_OPACITY = 0.1
#: Of the markers [m].
_DIAMETER = 0.005
#: The map holds the 1,000 newest sites: a cloud of 80 kB.
_MOST_SITES = 1000
#: x, y, z as RViz wants them; the rest from the next multiple of 8 bytes on.
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
        """Return whether the map has last changed by this very summary."""
        return self._newest is summary

    def add(self, summary: ContactSummary) -> bool:
        """Take a summary; return whether the map has changed: not by one that is in doubt."""
        site_id = summary.site_id
        if summary.position is None or summary.flags & WITHHELD:
            return False
        if summary.estimate is None:
            # A contact that was withdrawn takes its site off the map.
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

    def markers(self) -> MarkerArray:
        """Return a sphere and a word per site: colour by G, transparency by its deviation.

        First all that was drawn is taken away: what is not on the map is shown no longer, whether
        it was withdrawn or forgotten, or is of another run.
        """
        newest = self._newest
        frame_id = newest.position_frame if newest is not None else ""
        markers = [Marker(header=Header(frame_id=frame_id), action=Marker.DELETEALL)]
        for site_id, summary in self._sites.items():
            # A path has too many places for a word each; its points are in the cloud.
            if summary.is_of_path:
                continue
            markers += self._site_markers(site_id, summary)
        return MarkerArray(markers=markers)

    def cloud(self) -> PointCloud2:
        """Return the sites as points: float32 ``x, y, z``, float64 values and deviations.

        Points share one frame: sites in another than the newest summary's are left out.
        """
        newest = self._newest
        frame_id = newest.position_frame if newest is not None else ""
        sites = [s for s in self._sites.values() if s.position_frame == frame_id]
        stamp = to_stamp(newest.stamp_ns if newest is not None else 0)
        points = np.array([_values_of(summary) for summary in sites], _POINT)
        return cloud_of_points(points, Header(stamp=stamp, frame_id=frame_id))

    def _site_markers(self, site_id: int, summary: ContactSummary) -> tuple[Marker, Marker]:
        assert summary.position is not None and summary.estimate is not None
        x, y, z = (float(value) for value in summary.position)
        stiffness = summary.estimate.linear_stiffness
        deviation = float(summary.estimate.deviations[StateIndex.LOG_LINEAR_STIFFNESS])
        header = Header(stamp=Time(), frame_id=summary.position_frame)
        ball = Marker(header=header, ns="sites", id=site_id, type=Marker.SPHERE, action=Marker.ADD)
        ball.pose.position = Point(x=x, y=y, z=z)
        ball.pose.orientation.w = 1.0
        ball.scale = Vector3(x=_DIAMETER, y=_DIAMETER, z=_DIAMETER)
        ball.color = colour_of(stiffness, deviation)
        word = Marker(
            header=header,
            ns="values",
            id=site_id,
            type=Marker.TEXT_VIEW_FACING,
            action=Marker.ADD,
            text=f"{stiffness:.0f} ± {stiffness * deviation:.0f}",
        )
        word.pose.position = Point(x=x, y=y, z=z - _DIAMETER)
        word.pose.orientation.w = 1.0
        word.scale = Vector3(x=0.0, y=0.0, z=0.5 * _DIAMETER)
        word.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
        return ball, word


def cloud_of_points(points: np.ndarray, header: Header) -> PointCloud2:
    """Return a structured array as a cloud, a field a name."""
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


def colour_of(linear_stiffness: float, log_sd: float) -> ColorRGBA:
    """Return the colour of G [Pa s^alpha] whose logarithm has a deviation."""
    place = math.log(linear_stiffness / _SOFTEST) / math.log(_STIFFEST / _SOFTEST)
    places = np.linspace(0.0, 1.0, len(_COLOURS))
    red, green, blue = (
        float(np.interp(place, places, _COLOURS[:, channel])) for channel in range(3)
    )
    opacity = max(1.0 / (1.0 + (log_sd / _HALF_TRANSPARENT) ** 2), _LEAST_OPACITY)
    return ColorRGBA(r=red, g=green, b=blue, a=float(opacity))


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
        stiffness.value if stiffness is not None else 0.0,
        stiffness.sd if stiffness is not None else 0.0,
    )
