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

"""Scheduled beside fixed gains: a table for the terminal and a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.table import Table

from fden_ros.benchmarks.closed_loop import Program, Run

_FIXED, _LIVE, _TARGET, _LIMIT = "#c44e52", "#2a78b5", "#555555", "#222222"


def control_table(pairs: Sequence[tuple[Run, Run]], program: Program) -> Table:
    """Return one row a tissue; each pair is the fixed and the scheduled run."""
    table = Table(
        title=f"Fixed | scheduled gains, limit {program.limit:g} N",
        caption="settling to 5 % and overshoot of the plain step; overshoot at the inclusion",
        padding=(0, 1, 0, 0),
        box=box.SIMPLE_HEAD,
    )
    for name in ("G", "Gn", "settles [s]", "ratio", "over [%]", "incl. [%]", "max [N]", "passed"):
        table.add_column(name, justify="right", no_wrap=True)
    for fixed, live in pairs:
        model = fixed.model
        table.add_row(
            f"{model.linear_stiffness:.0f}",
            f"{model.nonlinear_stiffness:.1f}",
            f"{fixed.working.settling:.2f}|{live.working.settling:.2f}",
            f"{live.working.settling / fixed.working.settling:.2f}",
            f"{100 * fixed.working.overshoot:.1f}|{100 * live.working.overshoot:.1f}",
            f"{100 * fixed.high.overshoot:.1f}|{100 * live.high.overshoot:.1f}",
            f"{fixed.largest_force:.3f}|{live.largest_force:.3f}",
            "|".join("yes" if run.violated else "no" for run in (fixed, live)),
        )
    return table


def save_control_figure(
    pairs: Sequence[tuple[Run, Run]], program: Program, path: str | Path
) -> None:
    """Draw forces over the two steps on soft, middle and stiff tissue, and the figures of all."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = [pairs[0], pairs[len(pairs) // 2], pairs[-1]] if len(pairs) > 2 else list(pairs)
    figure, axes = plt.subplots(
        len(shown) + 1,
        2,
        figsize=(11, 1.9 * len(shown) + 2.6),
        squeeze=False,
        layout="constrained",
    )
    for row, pair in zip(axes, shown, strict=False):
        _draw_steps(row, pair, program)
    axes[0][0].set_title("Step on plain tissue", fontsize=10)
    axes[0][1].set_title(
        f"Step that meets an inclusion, {program.stiffening:g} times stiffer", fontsize=10
    )
    axes[len(shown) - 1][0].set_xlabel("time since the step [s]", fontsize=9)
    axes[len(shown) - 1][1].set_xlabel("time since the step [s]", fontsize=9)
    axes[0][1].legend(loc="lower right", fontsize=8, frameon=False)
    _draw_figures(axes[-1], pairs, program)
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_steps(row: np.ndarray, pair: tuple[Run, Run], program: Program) -> None:
    starts = [start for start, _ in program.steps]
    for axis, start in zip(row, (starts[2], starts[4]), strict=True):
        for run, colour, name in zip(
            pair, (_FIXED, _LIVE), ("fixed gains", "scheduled gains"), strict=True
        ):
            during = (run.times > start - 0.15) & (run.times < start + 1.8)
            axis.plot(
                run.times[during] - start,
                run.force[during],
                color=colour,
                lw=1.5 if run.scheduled else 1.0,
                label=name,
            )
            if run is pair[1]:
                axis.plot(
                    run.times[during] - start,
                    run.target[during],
                    color=_TARGET,
                    lw=0.8,
                    ls=":",
                    label="target",
                )
        axis.margins(x=0.0)
    row[1].axhline(program.limit, color=_LIMIT, lw=0.8, ls="--", label="limit")
    model = pair[0].model
    row[0].set_ylabel("force [N]", fontsize=9)
    row[0].text(
        0.98,
        0.08,
        f"G {model.linear_stiffness:.0f} Pa s$^\\alpha$, Gn {model.nonlinear_stiffness:.1f}",
        transform=row[0].transAxes,
        ha="right",
        fontsize=9,
    )


def _draw_figures(row: np.ndarray, pairs: Sequence[tuple[Run, Run]], program: Program) -> None:
    numbers = np.arange(1, len(pairs) + 1)
    for offset, index, colour in ((-0.2, 0, _FIXED), (0.2, 1, _LIVE)):
        runs = [pair[index] for pair in pairs]
        # What never settles has no bar.
        settling = [r.working.settling if math.isfinite(r.working.settling) else 0 for r in runs]
        row[0].bar(numbers + offset, settling, 0.38, color=colour)
        row[1].plot(numbers, [r.largest_force for r in runs], "o-", color=colour, lw=0.8)
    row[0].set_title("Settling to 5 % on plain tissue [s]", fontsize=10)
    row[1].set_title("Largest force, inclusion included [N]", fontsize=10)
    row[1].axhline(program.limit, color=_LIMIT, lw=0.8, ls="--")
    for axis in row:
        axis.set_xlabel("tissue, from the softest to the stiffest", fontsize=9)
        axis.set_xticks(numbers)
