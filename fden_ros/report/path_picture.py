# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The path of a probe in continuous contact: stiffness and alpha along it, and where it was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.outputs import ContactSummary
from fden_ros.core.streams import NANOSECONDS
from fden_ros.report import style


def draw_path(figure: Figure, summaries: Sequence[ContactSummary]) -> None:
    """Draw dF/dd and alpha of the places that have them, with ±2 standard deviations.

    Over the distance along the path where positions are known, else over time.
    """
    places = [one for one in summaries if one.is_of_path]
    is_located = all(one.position is not None for one in places)
    distance, label = _distance(places) if is_located else _time(places)
    stiffness, order = figure.subplots(2, 1, sharex=True)
    found = [one.apparent_stiffness for one in places]
    _draw(stiffness, distance, [(one.value, one.sd) if one is not None else None for one in found])
    scale = next((f"{one.time_scale:g}" for one in found if one is not None), "")
    stiffness.set_title(f"dF/dd for a motion of {scale} s [N/m], ±2 sd")
    orders = [
        (one.estimate.fractional_order, one.estimate.fractional_order_sd)
        if one.estimate is not None
        else None
        for one in places
    ]
    _draw(order, distance, orders)
    order.set_title("α, ±2 sd")
    order.set_xlabel(label)


def _distance(places: Sequence[ContactSummary]) -> tuple[Sequence[float], str]:
    positions = np.array([one.position for one in places], dtype=float)
    steps = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
    distance: list[float] = (1e3 * np.cumsum(steps)).tolist()
    return distance, "along the path [mm]"


def _time(places: Sequence[ContactSummary]) -> tuple[Sequence[float], str]:
    first = places[0].start_ns
    return [(one.end_ns - first) / NANOSECONDS for one in places], "time [s]"


def _draw(
    axes: Axes, distance: Sequence[float], found: Sequence[tuple[float, float] | None]
) -> None:
    """Draw value and deviation of each place that has them."""
    known = [(at, *one) for at, one in zip(distance, found, strict=True) if one is not None]
    at, value, sd = np.array(known, dtype=float).reshape(-1, 3).T
    style.intervals(axes, at, value, value - 2.0 * sd, value + 2.0 * sd, joined=True)
