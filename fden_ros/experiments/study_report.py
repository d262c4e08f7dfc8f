# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report of ``fden reproduce``: Tables I and II, and the figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fden_ros.experiments.bode import fit_bode
from fden_ros.experiments.plot import save_panels
from fden_ros.experiments.result import Curve, Panel
from fden_ros.experiments.study import (
    OMEGAS,
    PAPER,
    TABLE_1,
    TABLE_2,
    Noise,
    Statistics,
    Study,
)
from fden_ros.simulation.closed_form import FdenModel


@dataclass(frozen=True)
class Report:
    """What ``fden reproduce`` writes.

    Parameters
    ----------
    exact, noisy : Study
        The study without and with noise.
    seed : int
    noise : Noise
    """

    exact: Study
    noisy: Study
    seed: int
    noise: Noise

    def save(self, folder: Path) -> None:
        """Write report.md, report.json and the figures to `folder`."""
        storage, loss = (self.noisy.dynamic[0].panels[0].curves[i].y for i in (0, 2))
        modulus = storage + 1j * loss
        figures = {
            "figure_3_complex_modulus.png": self.noisy.dynamic[0].panels,
            "figure_4_bode.png": fit_bode(
                OMEGAS, 1.0 / np.abs(modulus), -np.angle(modulus)
            ).panels,
            "figure_5_creep.png": self.noisy.creep[0][1].panels,
            "figure_6_nonlinearity.png": self.noisy.series[0].panels,
            "figure_characteristic.png": _characteristic_panels(),
        }
        for name, panels in figures.items():
            save_panels([_simulated(panel) for panel in panels], folder / name)
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
        }

    def text(self, figures: Iterable[str]) -> str:
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
            "| procedure | G exact | Gn exact | G noisy | Gn noisy |",
            "| --- | --- | --- | --- | --- |",
            *(
                f"| {title} | " + " | ".join(self._ratio_cells(procedure)) + " |"
                for procedure, title in (
                    ("appendix_d", "the paper's: coefficients, no Gamma, Appendix D"),
                    ("series", "all curves at once, exact creep"),
                )
            ),
            "",
            "## Figures",
            "",
            *(f"![{name}]({name})\n" for name in figures),
        ]
        return "\n".join(lines)

    def _ratio_cells(self, procedure: str) -> list[str]:
        cells = []
        for study in (self.exact, self.noisy):
            for name in ("g", "g_n"):
                ratios = study.ratios(name, procedure)
                cells.append(f"{ratios.mean():.4f} ({ratios.std(ddof=1):.4f})")
        return cells


def _characteristic_panels() -> list[Panel]:
    """Return the symmetric characteristic, and the bond of Gn and xb (both for G = 1000 Pa)."""
    both = np.linspace(-0.3, 0.3, 301)
    model = FdenModel(1000.0, 10.0, 0.125)
    exponential = 1000.0 / (10.0 * math.e) * np.exp(10.0 * both)
    ends = np.array([-0.1, 0.1])
    symmetric = (
        Curve(both, model.phi(both), "φ(x)"),
        Curve(both, exponential, "first-order equation alone", color=2, dashed=True),
        Curve(ends, model.phi(ends), "±1/Gn", line=False, color=1),
    )
    bond = []
    strain = np.linspace(0.0, 0.3, 200)
    for color, g_n in enumerate((5.0, 8.5, 13.0)):
        tissue = FdenModel(1000.0, g_n, 0.125)
        values, at = tissue.phi(strain), np.array([tissue.boundary_strain])
        shown = values <= 1000.0
        bond += [
            Curve(strain[shown], values[shown], f"Gn = {g_n:g}", color=color),
            Curve(at, tissue.phi(at), "", line=False, color=color),
        ]
    labels = ("strain", "φ [Pa s^α]")
    return [
        Panel("Symmetry: G = 1000, Gn = 10", *labels, symmetric),
        Panel("xb = 1/Gn (circles), G = 1000", *labels, bond),
    ]


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


def _simulated(panel: Panel) -> Panel:
    curves = [replace(c, label=c.label.replace("measured", "simulated")) for c in panel.curves]
    return replace(panel, curves=curves)
