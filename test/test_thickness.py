# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Spheres on layers, against a solver of their own; layers that are assumed; their retract."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_helpers import answer, with_values
from pipeline_helpers import of_columns, summaries_of

from benchmark.laws import Law, springpot, stress_of_law
from fden_ros.core.law import Sphere
from fden_ros.simulation import FdenModel
from simulation.bag import write_recording
from simulation.elastic_layer import stiffening
from simulation.scenario import (
    Approach,
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import KNOWN_RIG, simulate
from simulation.trajectory import RampHold

RADIUS = 0.005


@pytest.mark.parametrize("thickness", [0.003, 0.005, 0.02])
@pytest.mark.parametrize(
    ("poisson_ratio", "is_bonded"), [(0.5, True), (0.45, True), (0.3, True), (0.5, False)]
)
def test_a_sphere_on_a_layer_is_what_boundary_elements_find(poisson_ratio, is_bonded, thickness):
    sphere = Sphere(RADIUS, thickness, poisson_ratio, is_bonded)
    depths = np.linspace(0.05, 0.9, 12) * min(thickness, RADIUS)
    truth = stiffening(poisson_ratio, is_bonded=is_bonded)(np.sqrt(RADIUS * depths) / thickness)
    # By what factor a layer raises the force of Hertz.
    found = [sphere.strain(u) / u**1.5 for u in depths / sphere.length]
    assert found == pytest.approx(truth, rel=0.01)


STIFFNESS, NONLINEARITY = 20_000.0, 6.0


def pressed(folder: Path) -> Path:
    """Write a bag of a sphere that presses up to 1.5 mm into a layer that slips on its base."""
    geometry = Geometry("sphere", radius_m=RADIUS, thickness_m=0.004, bonded=False)
    strain = geometry.strain_of_depth(0.0015)
    scenario = Scenario(
        geometry=geometry,
        sites=(
            Site(Tissue(STIFFNESS, NONLINEARITY, 0.13), (RampHold(strain, strain, 2.0, 1.0),)),
        ),
        approach=Approach(distance_m=0.003, speed_m_per_s=0.005, slow_distance_m=0.001),
        force=ForceSensor(rate_hz=500.0, noise_n=2e-3),
        displacement=DisplacementSensor(rate_hz=500.0, noise_m=1e-6),
    )
    write_recording(simulate(scenario), folder)
    return folder


def replayed(capsys: Any, bag: Path, **changes: object) -> dict[str, Any]:
    """Return the contact that `fden replay` finds, with the warnings."""
    changed = {f"geometry.{name}": value for name, value in changes.items()}
    config = with_values(bag / "identifier.yaml", changed)
    result = answer(capsys, "replay", bag, "--config", config)
    (contact,) = result["contacts"]
    return contact | {"warnings": result["warnings"]}


def test_replay_finds_g_under_a_sphere_whose_layer_is_stated_and_else_says_what_it_takes(
    capsys, tmp_path
):
    bag = pressed(tmp_path / "press")
    stated = replayed(capsys, bag)
    assert stated["converged"] and not stated["warnings"]
    assert abs(stated["g"] - STIFFNESS) < 2.0 * stated["g_sd"] < 0.3 * STIFFNESS
    assert abs(stated["g_n"] - NONLINEARITY) < 2.0 * stated["g_n_sd"]
    unstated = replayed(capsys, bag, thickness=0.0)
    # Or the tissue seems to have changed, and nothing is known.
    assert unstated["g"] is None or unstated["g"] > 1.3 * STIFFNESS
    (words,) = unstated["warnings"]
    assert words.startswith("geometry.thickness is not stated, so the tissue counts as thick")
    reached = re.search(r"the (\S+) mm that was reached", words)
    assert reached and float(reached[1]) == pytest.approx(1.5, rel=0.25)


def test_the_retract_of_a_round_probe_tells_nothing_where_its_contact_shrinks():
    """Tissue comes off at its rim."""
    step, cuts = 0.002, 10
    knots, depths = [0.0, 2.0, 4.2, 6.2, 7.2, 9.0], [-0.1, -0.1, 0.35, 0.35, -0.1, -0.1]
    times = step * np.arange(1.0, knots[-1] / step)
    compressions = np.interp(times, knots, depths)
    model = FdenModel(2000.0, 7.0, 0.15)

    def found(more: float) -> float:
        geometry = Sphere(0.01)
        strains = np.sign(compressions) * [geometry.strain(abs(u)) for u in compressions]
        law = Law(model, springpot(model.fractional_order))
        forces = stress_of_law(law, strains, step) / geometry.stress_per_force
        forces *= np.where((times > 6.2) & (compressions < 0.94 * 0.35), 1.0 + more, 1.0)
        noise = 1e-3 * forces.max() * np.random.default_rng(1).standard_normal(times.size)
        samples = (times, forces + noise, geometry.length * compressions)
        values = {"geometry.kind": "sphere", "geometry.radius": 0.01, **KNOWN_RIG}
        outputs = of_columns(values, *(one[cuts - 1 :: cuts] for one in samples))[1]
        summary = summaries_of(outputs)[-1]
        # Without an estimate the tissue has changed.
        return summary.estimate.linear_stiffness if summary.estimate is not None else math.inf

    stiffness = found(0.2)
    assert stiffness == pytest.approx(found(0.0), rel=1e-3)
    assert stiffness == pytest.approx(2000.0, rel=0.05)
