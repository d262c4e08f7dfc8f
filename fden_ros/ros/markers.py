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
#: A relative deviation of G of so much is drawn half transparent.
_HALF_TRANSPARENT = 0.1
_LEAST_OPACITY = 0.1
#: Older sites are forgotten beyond so many.
_MOST_SITES = 1000
_FIELDS = ("x", "y", "z", "G", "Gn", "alpha", "G_sd", "Gn_sd", "alpha_sd")


class StiffnessMap:
    """The newest summary of every site whose position is known.

    Parameters
    ----------
    diameter : float
        Of the markers [m].
    """

    def __init__(self, diameter: float = 0.005) -> None:
        self._diameter = diameter
        self._sites: OrderedDict[int, ContactSummary] = OrderedDict()

    def __contains__(self, summary: ContactSummary) -> bool:
        """Return whether this very summary is its site's on the map."""
        return self._sites.get(summary.site_id) is summary

    def add(self, summary: ContactSummary) -> bool:
        """Take a summary; return whether the map has changed: not by one that is in doubt."""
        if summary.position is None or summary.estimate is None or summary.flags & WITHHELD:
            return False
        self._sites[summary.site_id] = summary
        while len(self._sites) > _MOST_SITES:
            self._sites.popitem(last=False)
        return True

    def markers(self, frame_id: str) -> MarkerArray:
        """Return a sphere and a word per site: colour by G, transparency by its deviation."""
        markers: list[Marker] = []
        for site_id, summary in self._sites.items():
            markers += self._site_markers(site_id, summary, frame_id)
        return MarkerArray(markers=markers)

    def cloud(self, frame_id: str) -> PointCloud2:
        """Return the sites as points: float64 ``x, y, z, G, Gn, alpha`` and deviations."""
        rows = np.array([_row(summary) for summary in self._sites.values()])
        newest = max((s.stamp_ns for s in self._sites.values()), default=0)
        step = 8 * len(_FIELDS)
        return PointCloud2(
            header=Header(stamp=to_stamp(newest), frame_id=frame_id),
            height=1,
            width=len(self._sites),
            fields=[
                PointField(name=name, offset=8 * index, datatype=PointField.FLOAT64, count=1)
                for index, name in enumerate(_FIELDS)
            ],
            is_bigendian=False,
            point_step=step,
            row_step=step * len(self._sites),
            data=array.array("B", rows.astype("<f8").tobytes()),
            is_dense=True,
        )

    def _site_markers(
        self, site_id: int, summary: ContactSummary, frame_id: str
    ) -> tuple[Marker, Marker]:
        assert summary.position is not None and summary.estimate is not None
        x, y, z = (float(value) for value in summary.position)
        stiffness = summary.estimate.linear_stiffness
        deviation = float(summary.estimate.deviations[StateIndex.LOG_LINEAR_STIFFNESS])
        header = Header(stamp=Time(), frame_id=frame_id)
        ball = Marker(header=header, ns="sites", id=site_id, type=Marker.SPHERE, action=Marker.ADD)
        ball.pose.position = Point(x=x, y=y, z=z)
        ball.pose.orientation.w = 1.0
        ball.scale = Vector3(x=self._diameter, y=self._diameter, z=self._diameter)
        ball.color = colour_of(stiffness, deviation)
        word = Marker(
            header=header,
            ns="values",
            id=site_id,
            type=Marker.TEXT_VIEW_FACING,
            action=Marker.ADD,
            text=f"{stiffness:.0f} ± {stiffness * deviation:.0f}",
        )
        word.pose.position = Point(x=x, y=y, z=z - self._diameter)
        word.pose.orientation.w = 1.0
        word.scale = Vector3(x=0.0, y=0.0, z=0.5 * self._diameter)
        word.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
        return ball, word


def colour_of(linear_stiffness: float, log_sd: float) -> ColorRGBA:
    """Return the colour of G [Pa s^alpha] whose logarithm has a deviation."""
    share = math.log(linear_stiffness / _SOFTEST) / math.log(_STIFFEST / _SOFTEST)
    places = np.linspace(0.0, 1.0, len(_COLOURS))
    red, green, blue = (
        float(np.interp(share, places, _COLOURS[:, channel])) for channel in range(3)
    )
    opacity = max(1.0 / (1.0 + (log_sd / _HALF_TRANSPARENT) ** 2), _LEAST_OPACITY)
    return ColorRGBA(r=red, g=green, b=blue, a=float(opacity))


def _row(summary: ContactSummary) -> list[float]:
    estimate = summary.estimate
    assert estimate is not None and summary.position is not None
    return [
        *summary.position,
        estimate.linear_stiffness,
        estimate.nonlinear_stiffness,
        estimate.fractional_order,
        estimate.linear_stiffness_sd,
        estimate.nonlinear_stiffness_sd,
        estimate.fractional_order_sd,
    ]
