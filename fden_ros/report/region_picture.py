# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A region as a picture: stiffness, what is stiffer and its boundary, presses and the next one."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.planning.region import Presses, Proposal, Region
from fden_ros.report import style


def draw_region(
    figure: Figure,
    region: Region,
    presses: Presses,
    found: Proposal,
    truth: Array | None = None,
) -> None:
    """Draw N/m and the probability of being stiffer, each with the boundary.

    `truth`, where it is known, is 1 at the cells that are stiffer; it is dashed.
    """
    assert found.known is not None
    shape = tuple(axis.size for axis in region.axes)
    x, y = (1e3 * axis for axis in region.axes)
    chance = found.known.probability.reshape(shape).T
    stiffness = np.exp(found.known.mean).reshape(shape).T
    panels = figure.subplots(1, 2, sharey=True)
    shown = (stiffness, "stiffness [N/m]"), (chance, "probability of being stiffer")
    for axes, (values, title) in zip(panels, shown, strict=True):
        mesh = axes.pcolormesh(x, y, values, cmap="viridis", shading="nearest")
        figure.colorbar(mesh, ax=axes)
        if chance.min() < found.known.level < chance.max():
            axes.contour(x, y, chance, [found.known.level], colors=style.TRUTH)
        if truth is not None:
            axes.contour(x, y, truth.reshape(shape).T, [0.5], colors="white", linestyles="dashed")
        axes.plot(*(1e3 * presses.places.T), "o", color="white", markersize=3)
        if not found.is_done:
            axes.plot(*(1e3 * found.places.T), "x", color=style.TRUTH, markersize=9)
        axes.set_aspect("equal")
        axes.set_title(title)
        axes.set_xlabel("x [mm]")
    panels[0].set_ylabel("y [mm]")
