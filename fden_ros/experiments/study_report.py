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

"""The report of ``fden reproduce``: Tables I and II, the figures, and the claims."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.experiments.dynamic import fit_bode
from fden_ros.experiments.plot import draw_panel, save_figure
from fden_ros.experiments.result import Curve, Panel
from fden_ros.experiments.study import (
    OMEGAS,
    PAPER,
    TABLE_1,
    TABLE_2,
    Claim,
    Noise,
    Statistics,
    Study,
)
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.ladder import Ladder

_LADDER_TIME_CONSTANT = 1e-12


@dataclass(frozen=True)
class Report:
    """What ``fden reproduce`` writes.

    Parameters
    ----------
    exact, noisy : Study
        The study without and with noise.
    claims, numbers : sequence of Claim
        The paper's claims, and where its numbers or equations cannot be.
    seed : int
    noise : Noise
    """

    exact: Study
    noisy: Study
    claims: Sequence[Claim]
    numbers: Sequence[Claim]
    seed: int
    noise: Noise

    def save(self, folder: Path) -> None:
        """Write report.md, report.json and the figures to `folder`."""
        figures = {
            "figure_3_complex_modulus.png": self._dynamic_panels(),
            "figure_4_bode.png": self._bode_panels(),
            "figure_5_creep.png": self._creep_panels(),
            "figure_6_nonlinearity.png": self._nonlinearity_panels(),
            "figure_characteristic.png": _characteristic_panels(),
            "ladder.png": ladder_panels(),
        }
        for name, panels in figures.items():
            save_panels(panels, folder / name)
        (folder / "report.md").write_text(self.text(figures), encoding="utf-8")
        (folder / "report.json").write_text(
            json.dumps(self.as_object(), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )

    def as_object(self) -> dict[str, object]:
        """Return everything but the figures as plain values."""
        tables = {"paper": PAPER, "exact": self.exact.tables(), "noisy": self.noisy.tables()}
        return {
            "seed": self.seed,
            "noise": vars(self.noise),
            "tables": {
                name: {which: table[name]._asdict() for which, table in tables.items()}
                for name in PAPER
            },
            "claims": [claim._asdict() for claim in self.claims],
            "impossible": [claim._asdict() for claim in self.numbers],
        }

    def text(self, figures: Sequence[str] | dict[str, list[Panel]]) -> str:
        """Return the report in Markdown."""
        exact, noisy = self.exact.tables(), self.noisy.tables()
        lines = [
            "# The paper's study, simulated",
            "",
            f"{len(self.exact.tissues)} samples drawn from Table II (normal, independent, within "
            "the printed extremes) creep at 25 to 750 Pa for 180 s; "
            f"{len(self.exact.dynamic)} more are oscillated from 0.1 to 10 rad/s. All by the "
            f"model's closed forms, seed {self.seed}. *Exact* is without noise, *noisy* with "
            f"{100 * self.noise.modulus:g} % on each modulus, {100 * self.noise.strain:g} % on "
            f"each strain and {100 * self.noise.test:g} % on each creep test as a whole, chosen "
            "so that R² comes out near Table I. Tissue is not simulated but the model: whether "
            "tissue obeys it, only the paper's measurements can tell.",
            "",
            "## Table I: R²",
            "",
            *_table(TABLE_1, exact, noisy, "{:.4f}"),
            "",
            "## Table II: parameters by the paper's procedures",
            "",
            *_table(TABLE_2, exact, noisy, "{:.4g}"),
            "",
            "Fitted over true parameter, average (standard deviation) over the samples:",
            "",
            "| way | G exact | Gn exact | G noisy | Gn noisy |",
            "| --- | --- | --- | --- | --- |",
            *(
                f"| {title} | " + " | ".join(self._ratio_cells(way)) + " |"
                for way, title in (
                    ("appendix_d", "the paper's: coefficients, no Gamma, Appendix D"),
                    ("series", "all curves at once, exact creep"),
                )
            ),
            "",
            "## The paper's claims, on data of its own model",
            "",
            *_claims(self.claims, "holds"),
            "",
            "## Numbers and equations that cannot be",
            "",
            *_claims(self.numbers, "can be"),
            "",
            "## Figures",
            "",
            *(f"![{name}]({name})\n" for name in figures),
        ]
        return "\n".join(lines)

    def _ratio_cells(self, way: str) -> list[str]:
        cells = []
        for study in (self.exact, self.noisy):
            for name in ("g", "g_n"):
                ratios = study.ratios(name, way)
                cells.append(f"{ratios.mean():.4f} ({ratios.std(ddof=1):.4f})")
        return cells

    def _dynamic_panels(self) -> list[Panel]:
        return list(self.noisy.dynamic[0].panels)

    def _bode_panels(self) -> list[Panel]:
        storage, loss = (self.noisy.dynamic[0].panels[0].curves[i].y for i in (0, 2))
        modulus = storage + 1j * loss
        return list(fit_bode(OMEGAS, 1.0 / np.abs(modulus), -np.angle(modulus)).panels)

    def _creep_panels(self) -> list[Panel]:
        return list(self.noisy.creep[0][1].panels)

    def _nonlinearity_panels(self) -> list[Panel]:
        return list(self.noisy.series[0].panels)


def ladder_panels() -> list[Panel]:
    """Return how ladders of the orders 1/2, 1/4, 1/8 approach the springpot."""
    omegas, times = np.geomspace(1e-2, 1e6, 60), np.geomspace(1e-4, 100.0, 40)
    moduli, creeps, errors = [], [], []
    for color, levels in enumerate((1, 2, 3)):
        ladder = Ladder.like_springpot(levels, 1.0, _LADDER_TIME_CONSTANT)
        alpha = ladder.fractional_order
        label = f"order 1/{2**levels}"
        springpot = omegas**alpha
        modulus = np.abs(ladder.modulus(1j * omegas))
        moduli += [
            Curve(omegas, springpot, label, color=color),
            Curve(omegas[::4], modulus[::4], "", line=False, color=color),
        ]
        exact = times**alpha / math.gamma(1.0 + alpha)
        creep = ladder.creep(times)
        creeps += [
            Curve(times, exact, label, color=color),
            Curve(times[::2], creep[::2], "", line=False, color=color),
        ]
        errors.append(Curve(omegas, 100.0 * np.abs(modulus / springpot - 1.0), label, color=color))
    return [
        Panel("Modulus: springpot (lines), ladder (circles)", "ω [rad/s]", "|G*| / G", moduli,
              x_log=True, y_log=True),
        Panel("Creep: springpot (lines), ladder (circles)", "time [s]", "strain G / stress",
              creeps, x_log=True, y_log=True),
        Panel(f"Deviation, τ = {_LADDER_TIME_CONSTANT:g} s", "ω [rad/s]", "deviation of |G*| [%]",
              errors, x_log=True, y_log=True),
    ]  # fmt: skip


def save_panels(panels: Sequence[Panel], path: Path) -> None:
    """Draw panels side by side."""
    figure = Figure(figsize=(5.2 * len(panels), 4.2), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        curves = [replace(c, label=c.label.replace("measured", "simulated")) for c in panel.curves]
        draw_panel(axes, replace(panel, curves=curves))
    save_figure(figure, path)


def _characteristic_panels() -> list[Panel]:
    """Return the symmetric characteristic, and the bond of Gn and xb (both for G = 1000 Pa)."""
    both = np.linspace(-0.3, 0.3, 301)
    model = FdenModel(1000.0, 10.0, 0.125)
    exponential = 1000.0 / (10.0 * math.e) * np.exp(10.0 * both)
    symmetric = Panel("Symmetry: G = 1000, Gn = 10", "strain", "φ [Pa s^α]", (
        Curve(both, np.asarray(model.phi(both)), "φ(x)"),
        Curve(both, exponential, "first-order equation alone", color=2, dashed=True),
        Curve(np.array([-0.1, 0.1]), np.asarray(model.phi([-0.1, 0.1])), "±1/Gn", line=False,
              color=1),
    ))  # fmt: skip
    curves = []
    strain = np.linspace(0.0, 0.3, 200)
    for color, g_n in enumerate((5.0, 8.5, 13.0)):
        tissue = FdenModel(1000.0, g_n, 0.125)
        xb = tissue.boundary_strain
        values: Array = np.asarray(tissue.phi(strain))
        shown = values <= 1000.0
        curves += [
            Curve(strain[shown], values[shown], f"Gn = {g_n:g}", color=color),
            Curve(np.array([xb]), np.asarray(tissue.phi([xb])), "", line=False, color=color),
        ]
    constraint = Panel("xb = 1/Gn (circles), G = 1000", "strain", "φ [Pa s^α]", curves)
    return [symmetric, constraint]


def _table(
    names: Sequence[str],
    exact: dict[str, Statistics],
    noisy: dict[str, Statistics],
    number: str,
) -> list[str]:
    lines = [
        "| | | average | maximum | minimum | S.D. |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in names:
        for which, table in (("paper", PAPER), ("exact", exact), ("noisy", noisy)):
            cells = " | ".join(number.format(value) for value in table[name])
            lines.append(f"| {name if which == 'paper' else ''} | {which} | {cells} |")
    return lines


def _claims(claims: Sequence[Claim], head: str) -> list[str]:
    lines = [f"| what the paper says | {head} | by how much |", "| --- | --- | --- |"]
    for claim in claims:
        cells = (cell.replace("|", "\\|") for cell in (claim.claim, claim.holds, claim.finding))
        lines.append("| " + " | ".join(cells) + " |")
    return lines
