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

"""What the benchmark of classification has found, in tables and in its picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fden_ros.benchmarks.lesions import (
    CONTRASTS,
    DIAMETERS,
    RATIO,
    SIDE,
    SPACING,
    Lesions,
)
from fden_ros.benchmarks.populations import (
    Pressed,
    calibration_error,
    log_loss,
)
from fden_ros.benchmarks.real_classes import Told
from fden_ros.benchmarks.tissue_classes import (
    FAR,
    MIXTURE,
    OWN,
    PER_SPECIMEN,
    QDA,
    SPECIMENS,
    Foreign,
    Places,
    Through,
    Trial,
)
from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import (
    TissueLibrary,
)
from fden_ros.core.classification.decision import DecisionConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table


@dataclass(frozen=True, eq=False)
class Found:
    """Everything that was measured."""

    pressed: list[Pressed]
    through: Through
    bound: tuple[float, float]
    trials: list[Trial]
    curve: dict[int, Trial]
    foreign: Foreign
    places: Places
    lesions: Lesions
    told: dict[str, Told]

    def mean(self, method: str, what: str) -> float:
        """Return a score, averaged over the libraries."""
        return float(np.mean([getattr(t.scores[method], what) for t in self.trials]))


def quantiles(values: Array) -> dict[str, float]:
    """Return median and 5 and 95 % quantiles by their percents; empty where there are none."""
    if not values.size:
        return {}
    return {f"{q}": float(np.percentile(values, q)) for q in (5, 50, 95)}


# Tables


def tables_of(found: Found, truth: TissueLibrary) -> list[Table]:
    """Return the tables."""
    tables = [_peer_table(found), _confusion_table(found, truth), _pipeline_table(found)]
    tables.append(_lesion_table(found.lesions))
    if found.told:
        tables.append(_real_table(found.told))
    return tables


def _table(title: str, columns: Sequence[str]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


def _peer_table(found: Found) -> Table:
    bound, own = found.bound
    table = _table(
        f"Known tissues, {len(found.trials)} libraries of {SPECIMENS} specimens a class; Bayes' "
        f"error {100 * bound:.2f} ± {100 * own:.2f} %",
        ("", "error", "over Bayes'", "calibration error", "log loss"),
    )
    for name in (OWN, QDA, MIXTURE):
        error = found.mean(name, "error")
        table.add_row(
            name,
            f"{100 * error:.2f} %",
            f"{error / bound:.3f}",
            f"{found.mean(name, 'calibration'):.4f}",
            f"{found.mean(name, 'log_loss'):.4f}",
        )
    return table


def _confusion_table(found: Found, truth: TissueLibrary) -> Table:
    table = _table("Truth (row) and label, in %", ("", *truth.class_names))
    shares = np.mean([trial.confusion for trial in found.trials], axis=0)
    for tissue, row in zip(truth.tissues, shares, strict=True):
        table.add_row(tissue.name, *(f"{100 * share:.1f}" for share in row))
    return table


def _pipeline_table(found: Found) -> Table:
    one = found.through
    table = _table("Through the pipeline", ("", ""))
    time, strain = quantiles(one.times), quantiles(one.strains)
    rows = [
        ("contacts, of them converged", f"{len(found.pressed)}, {one.converged}"),
        ("error", f"{100 * one.error:.1f} %"),
        (
            "expected from their probabilities",
            f"{100 * one.expected_error:.1f} ± {100 * one.error_sd:.1f} %",
        ),
        ("squared error over covariance (1)", f"{one.nees:.2f}"),
        ("converged contacts with a label", f"{100 * one.decided:.0f} %"),
        ("labels replaced, a contact", f"{one.changes:.3f}"),
    ]
    if time:
        rows += [
            ("label after, median (95 %)", f"{time['50']:.2f} ({time['95']:.2f}) s"),
            ("at a strain of", f"{strain['50']:.3f} ({strain['95']:.3f})"),
        ]
    for row in rows:
        table.add_row(*row)
    return table


def _lesion_table(lesions: Lesions) -> Table:
    columns = ("", "area under ROC", *(f"{d:g} mm" for d in DIAMETERS), f"P(> {RATIO:g}) > ½")
    if lesions.pipeline_areas:
        columns = (*columns, "pipeline")
    table = _table(
        f"Lesions: sites against their surroundings; false alarms {100 * lesions.false_alarms:.1f}"
        f" %; 95 % intervals hold the truth of {100 * lesions.coverage:.0f} %, among lesions "
        f"{100 * lesions.coverage_among:.0f} %",
        columns,
    )
    for contrast in CONTRASTS:
        cells = [f"{lesions.curves[contrast][2]:.3f}"]
        cells += [f"{lesions.by_size[contrast, d]:.3f}" for d in DIAMETERS]
        cells.append(f"{100 * lesions.found[contrast]:.0f} %")
        if lesions.pipeline_areas:
            cells.append(f"{lesions.pipeline_areas[contrast]:.3f}")
        table.add_row(f"{contrast:g} times", *cells)
    return table


def _real_table(told: Mapping[str, Told]) -> Table:
    table = _table(
        "Measured: one specimen left out (silicone is one piece: one test left out)",
        ("parameters", "beef | silicone", "95 %", "unknown", "log loss", "cuts of beef", "95 %"),
    )
    for name, one in told.items():
        low, high = one.kinds.interval()
        cells = [
            f"{int(one.kinds.errors.sum())} of {len(one.kinds.truth)}",
            f"{100 * low:.0f} to {100 * high:.0f} %",
            str(int(one.kinds.unknown.sum())),
            f"{log_loss(one.kinds.probabilities, one.kinds.truth):.3f}",
        ]
        if one.cuts is not None:
            low, high = one.cuts.interval()
            cells += [
                f"{100 * float(np.mean(one.cuts.errors)):.0f} % wrong",
                f"{100 * low:.0f} to {100 * high:.0f} %",
            ]
        table.add_row(name, *cells)
    return table


# The picture

_COLORS = {OWN: "#1f77b4", QDA: "#d95f02", MIXTURE: "#7570b3"}
_CONTRAST_COLORS = ("#74add1", "#f46d43", "#a50026")


def draw_picture(figure: Figure, found: Found, truth: TissueLibrary) -> None:
    """Draw the picture."""
    figure.set_size_inches(16, 9)
    axes = figure.subplots(2, 4)
    _draw_reliability(axes[0, 0], found)
    _draw_confusion(axes[0, 1], found, truth)
    _draw_curve(axes[0, 2], found)
    _draw_unknown(axes[0, 3], found)
    _draw_settling(axes[1, 0], found, truth)
    _draw_places(axes[1, 1], found.places)
    _draw_roc(axes[1, 2], found.lesions)
    _draw_map(figure, axes[1, 3], found.lesions)


def _draw_reliability(axes: Axes, found: Found) -> None:
    probabilities = np.concatenate([t.open_probabilities for t in found.trials])
    truth = np.concatenate([t.open_truth for t in found.trials])
    error, said, right, count = calibration_error(probabilities, truth)
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1.0)
    spread = 2.0 * np.sqrt(np.maximum(right * (1.0 - right), 1e-9) / np.maximum(count, 1))
    axes.errorbar(said, right, spread, fmt="o-", color=_COLORS[OWN], markersize=4, capsize=2)
    twin = axes.twinx()
    width = 1.0 / len(count)
    twin.bar((np.arange(len(count)) + 0.5) * width, count / count.sum(), width, color="0.85")
    twin.set_ylim(0.0, 1.5)
    twin.set_yticks([])
    axes.set_zorder(twin.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("probability of the most probable class")
    axes.set_ylabel("share that is right")
    axes.set_title(
        f"Reliability, {len(truth):,} contacts: calibration error {error:.4f}", fontsize=10
    )
    axes.text(
        0.03, 0.9, "unknown is one of them;\nbars: share of the contacts", color="0.5", fontsize=8
    )


def _draw_confusion(axes: Axes, found: Found, truth: TissueLibrary) -> None:
    shares = 100.0 * np.mean([trial.confusion for trial in found.trials], axis=0)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        axes.text(
            column,
            row,
            f"{share:.1f}",
            ha="center",
            va="center",
            color="white" if share > 55.0 else "0.15",
            fontsize=9,
        )
    names = [name.replace(" ", "\n") for name in truth.class_names]
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_yticks(range(len(names) - 1), names[:-1], fontsize=8)
    axes.set_ylabel("truth")
    axes.set_title("Label given, % of the truth", fontsize=10)


def _draw_curve(axes: Axes, found: Found) -> None:
    counts = list(found.curve)
    for name, color in _COLORS.items():
        ratios = [found.curve[n].scores[name].error / found.bound[0] for n in counts]
        axes.plot(counts, ratios, "o-", color=color, markersize=4, label=name)
    axes.axhline(1.0, color="0.7", linewidth=1.0)
    axes.axhline(1.1, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_xscale("log")
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.minorticks_off()
    top = max(found.curve[counts[0]].scores[n].error for n in _COLORS) / found.bound[0]
    axes.set_ylim(0.95, min(1.05 * top, 2.5))
    axes.set_xlabel(f"specimens per class, {PER_SPECIMEN} contacts each")
    axes.set_ylabel("error over Bayes' error")
    axes.set_title("Learning from few specimens", fontsize=10)
    axes.legend(fontsize=8)


def _draw_unknown(axes: Axes, found: Found) -> None:
    false, true, area = found.foreign.roc
    keep = np.unique(np.linspace(0, len(false) - 1, 2000).astype(int))
    axes.plot(100.0 * false[keep], 100.0 * true[keep], color=_COLORS[OWN])
    at = float(np.mean([trial.false_unknown for trial in found.trials]))
    axes.plot(100.0 * at, 100.0 * found.foreign.called, "o", color="#d95f02", label="as labelled")
    axes.axvline(5.0, color="0.7", linewidth=1.0, linestyle="--")
    axes.axhline(95.0, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_xlim(0.0, 10.0)
    axes.set_ylim(80.0, 100.2)
    axes.set_xlabel("known tissues called unknown, %")
    axes.set_ylabel(f"classes {FAR:g} sd away called unknown, %")
    axes.set_title(f"The unknown: area under ROC {area:.4f}", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _draw_settling(axes: Axes, found: Found, truth: TissueLibrary) -> None:
    shown = 0
    for one in found.pressed:
        if not one.track or shown >= 60:
            continue
        shown += 1
        times = [time for time, _, _ in one.track]
        own = [p[one.truth] for _, _, p in one.track]
        end = (one.summary.end_ns - one.summary.start_ns) * 1e-9 if one.summary else times[-1]
        axes.step(
            [*times, end],
            [*own, own[-1]],
            where="post",
            color=_COLORS[OWN] if own[-1] > 0.5 else "#d95f02",
            alpha=0.35,
            linewidth=1.0,
        )
    axes.axhline(DecisionConfig().probability, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_ylim(0.0, 1.02)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("time since the touch [s]")
    axes.set_ylabel("probability of the true tissue")
    axes.text(
        0.98,
        0.03,
        "orange: another tissue in the end",
        transform=axes.transAxes,
        ha="right",
        color="#d95f02",
        fontsize=8,
    )
    median = np.median(found.through.times) if found.through.times.size else math.nan
    axes.set_title(f"As the contact goes on; label after {median:.2f} s (median)", fontsize=10)


def _draw_places(axes: Axes, places: Places) -> None:
    axes.plot(places.counts, places.added, "o-", color=_COLORS[OWN], label="evidence added")
    axes.plot(
        places.counts,
        places.multiplied,
        "s-",
        color="#d95f02",
        label="probabilities multiplied",
    )
    axes.axhline(0.02, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("contacts with one place")
    axes.set_ylabel("calibration error")
    axes.set_title("Several contacts", fontsize=10)
    axes.legend(fontsize=8)


def _draw_roc(axes: Axes, lesions: Lesions) -> None:
    for (contrast, (false, true, area)), color in zip(
        lesions.curves.items(), _CONTRAST_COLORS, strict=True
    ):
        axes.plot(false, true, color=color, label=f"{contrast:g} times stiffer: {area:.3f}")
    axes.plot([0, 1], [0, 1], color="0.8", linewidth=1.0)
    axes.set_xlim(-0.01, 1.0)
    axes.set_ylim(0.0, 1.01)
    axes.set_xlabel("false positive rate")
    axes.set_ylabel("true positive rate")
    axes.set_title("Lesions: ROC and its area", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _draw_map(figure: Figure, axes: Axes, lesions: Lesions) -> None:
    from matplotlib.patches import Circle

    ratio = np.array([math.nan if c is None else c.ratio for c in lesions.compared])
    image = axes.imshow(
        np.log2(ratio).reshape(SIDE, SIDE).T,
        origin="lower",
        cmap="RdBu_r",
        vmin=-2.0,
        vmax=2.0,
        extent=(-0.5 * SPACING, (SIDE - 0.5) * SPACING) * 2,
    )
    for one in lesions.grid.inclusions:
        axes.add_patch(
            Circle((one.x, one.y), 0.5 * one.diameter, fill=False, color="0.1", linewidth=1.2)
        )
        axes.text(
            one.x, one.y + 0.5 * one.diameter + 1.0, f"{one.contrast:g}×", ha="center", fontsize=7
        )
    alarms = [
        i
        for i, c in enumerate(lesions.compared)
        if c is not None and c.probability_stiffer(RATIO) > 0.5
    ]
    axes.plot(*lesions.grid.positions[alarms].T, ".", color="k", markersize=2.5)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, ticks=(-2, -1, 0, 1, 2))
    bar.ax.set_yticklabels(["¼", "½", "1", "2", "4"])
    bar.set_label("times stiffer than around")
    axes.set_xlabel("mm")
    how = "through the pipeline" if lesions.through_pipeline else "drawn"
    axes.set_title(f"400 sites {how};\ndot: P(> {RATIO:g} times) > ½", fontsize=10)
