# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A plan as a picture: deviations of G and Gn against depth and time, and the motion chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from fden_ros.core.estimation import ended
from fden_ros.planning.motion import Motion
from fden_ros.planning.plan import NAMES, Plan, Search
from fden_ros.report import style

#: Depths over the largest [1] and holds [s] that are drawn, and colours of the deviations [1].
_DEPTHS, _HOLDS = np.linspace(0.3, 1.0, 8), (0.0, 0.25, 0.5, 1.0, 2.0, 3.0)
_LEVELS = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)


def draw_plan(figure: Figure, search: Search, plan: Plan) -> None:
    """Draw the expected deviations of motions without oscillation as the chosen one is fast."""
    own = replace(plan.motion, cycles=0)
    motions = [
        [replace(own, depth=part * search.depth, hold=hold) for hold in _HOLDS]
        for part in _DEPTHS.tolist()
    ]
    seconds = np.array([[motion.seconds for motion in row] for row in motions])
    depths = np.array([[1e3 * motion.depth for motion in row] for row in motions])
    found = np.array([[_deviations(search, motion) for motion in row] for row in motions])
    panels = figure.subplots(1, 2, sharey=True)
    for k, axes in enumerate(panels):
        values = np.clip(found[:, :, k], _LEVELS[0], _LEVELS[-1])
        shown = axes.contourf(seconds, depths, values, _LEVELS, cmap="Blues_r", norm="log")
        wanted = plan.target.deviations[k]
        if values.min() < wanted < values.max():
            line = axes.contour(seconds, depths, values, [wanted], colors=style.TRUTH)
            axes.clabel(line, fmt=lambda value: f"wanted {100.0 * value:.3g} %")
        axes.plot(
            plan.motion.seconds,
            1e3 * plan.motion.depth,
            "o",
            color=style.TRUTH,
            markeredgecolor="white",
            markersize=9,
            label=f"chosen: {100.0 * plan.deviations[k]:.2g} %",
        )
        axes.set_title(f"expected deviation of {NAMES[k]}, {1e3 * own.speed:.3g} mm/s")
        axes.set_xlabel("time in contact [s]")
        style.legend_above(axes)
        bar = figure.colorbar(shown, ax=axes, ticks=_LEVELS)
        bar.ax.set_yticklabels([f"{100.0 * level:.3g} %" for level in _LEVELS])
    panels[0].set_ylabel("depth [mm]")


def _deviations(search: Search, motion: Motion) -> np.ndarray:
    found = ended(search.counted(motion))
    if not found:
        return np.full(3, np.inf)
    return np.median([one.deviations()[0] for one in found], axis=0)
