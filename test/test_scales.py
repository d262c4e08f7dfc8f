# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From pN to kN: the same press in other sizes gives the same tissue."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
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


@pytest.mark.parametrize(("peak", "size", "stress"), [("10 pN", 1e-5, 1.0), ("2 kN", 5.0, 1e3)])
def test_a_press_is_the_same_tissue_in_any_size(peak: str, size: float, stress: float) -> None:
    _, (summary,) = scaled(size, stress, force__noise_floor=1e-16)
    estimate, slope = summary.estimate, summary.measured.loading
    assert estimate is not None and slope is not None
    assert summary.converged and not summary.flags
    # The example's truth is 450 and 9; the slope is that of the press itself, in its units.
    assert estimate.linear_stiffness / stress == pytest.approx(448.0, rel=0.02)
    assert estimate.nonlinear_stiffness == pytest.approx(9.0, rel=0.02)
    assert slope.value / (size * stress) == pytest.approx(43.0, rel=0.04)
