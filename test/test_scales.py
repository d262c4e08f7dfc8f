# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From pN to kN: the same press in other sizes gives the same tissue."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from command_helpers import fden
from pipeline_helpers import of_columns, summaries_of

from fden_ros.core.estimation import Prior
from fden_ros.core.outputs import ContactSummary
from fden_ros.core.pipeline import Pipeline
from simulation.simulate import KNOWN_RIG

ROOT = Path(__file__).parent.parent
#: The first press of the example, 97 mN on 3.14 cm^2: time [s], force [N], depth [mm].
PRESS = np.loadtxt(ROOT / "examples" / "press.csv", delimiter=",", skiprows=1)[:1300]


def scaled(
    size: float, stress: float = 1.0, **more: float
) -> tuple[Pipeline, list[ContactSummary]]:
    """The press with lengths and stresses times factors, through a pipeline."""
    parameters = {
        "geometry.area": 3.14e-4 * size**2,
        "geometry.thickness": 0.02 * size,
        "prior.linear_stiffness": Prior().linear_stiffness * stress,
        "plausibility.max_force": 1e4,
        **KNOWN_RIG,
        **{name.replace("__", "."): value for name, value in more.items()},
    }
    times, forces, depths = PRESS.T
    columns = times, forces * size**2 * stress, 1e-3 * depths * size
    pipeline, outputs = of_columns(parameters, *columns)
    return pipeline, summaries_of(outputs)


@pytest.mark.parametrize(
    ("peak", "size", "stress"),
    [("10 pN", 1e-5, 1.0), ("2 kN", 5.0, 1e3)],
)
def test_a_press_is_the_same_tissue_in_any_size(peak: str, size: float, stress: float) -> None:
    _, (summary,) = scaled(size, stress, force__noise_floor=1e-16)
    estimate, slope = summary.estimate, summary.measured.loading
    assert estimate is not None and slope is not None
    assert summary.converged and not summary.flags
    # The example's truth is 450 and 9; the slope is that of the press itself, in its units.
    assert estimate.linear_stiffness / stress == pytest.approx(448.0, rel=0.02)
    assert estimate.nonlinear_stiffness == pytest.approx(9.0, rel=0.02)
    assert slope.value / (size * stress) == pytest.approx(43.0, rel=0.04)


def test_a_micro_indenter_s_table_in_nanonewtons_and_nanometres_works_end_to_end(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # A sphere of 2.5 um on an elastic gel of 1 kPa, by Hertz; noise of 20 pN and 1 nm.
    radius, modulus = 2.5e-6, 1e3
    corners = [0, 2, 3, 5, 6, 8, 9, 11, 12, 14]
    time = np.arange(0.0, corners[-1], 2e-3)
    way = np.interp(time, corners, np.array([-2, -2, 0.6, 0.6, -2] * 2) * 1e-6)
    force = 16.0 / 9.0 * modulus * np.sqrt(radius) * np.maximum(way, 0.0) ** 1.5
    rng = np.random.default_rng(1)
    force += 0.3e-9 + 20e-12 * rng.standard_normal(time.size)
    way += 1e-9 * rng.standard_normal(time.size)
    table, config = tmp_path / "gel.csv", tmp_path / "probe.yaml"
    np.savetxt(table, np.stack([time, 1e9 * force, 1e9 * way]).T, delimiter=",",
               header="time_s,force_nN,displacement_nm", comments="")  # fmt: skip
    assert fden("configure", table, "--sphere", radius, "--thickness", "1e-3", "-o", config) == 0
    assert "noise_floor: 2.0e-12" in config.read_text()
    capsys.readouterr()
    bench = ROOT / "config" / "bench.yaml"
    assert fden("replay", table, "--config", bench, "--config", config) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert shown.count("contact 1: ") == 1 and "warning" not in shown
    # At the deepest point the slope is 1.5 F/d = 3.27e-3 N/m.
    found = re.findall(r" (\S+) ± (\S+) \S+(?: at \S+)? G known", shown)
    values, deviations = np.array(found, dtype=float).T
    assert values.size == 2 and np.all(deviations < 0.07 * values)
    assert np.all(np.abs(values - 3.27e-3) < 2.0 * deviations)
