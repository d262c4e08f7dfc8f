# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A new user's first hour: from a recording of an arm to numbers: configure, replay."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_helpers import answer
from property_helpers import counts
from unknown_rig_bags import RigBag

from fden_ros.cli import main
from fden_ros.configure.streams import Streams
from fden_ros.parameters import read_parameter_file
from simulation.disturbance import Disturbances
from simulation.scenario import DisplacementSensor, ForceSensor, Geometry, Scenario, Site, Tissue
from simulation.simulate import simulate
from simulation.trajectory import Approach, RampHold

PAGE = Path(__file__).parent.parent / "docs" / "quickstart.md"
NOISE, DOWN = 0.02, np.array([0.0, 0.0, -1.0])
UR = "/force_torque_sensor_broadcaster/wrench", "/tcp_pose_broadcaster/pose"


def recorded(folder: Path, seed: int) -> tuple[float, float, float]:
    """Write two presses of one place by an arm; return the tissue's ln G, ln Gn and alpha.

    Tissue, noise and the rig's errors are drawn; the errors as the parameters' defaults say.
    """
    draw = np.random.default_rng([seed, 12])
    g = float(np.exp(draw.uniform(math.log(400.0), math.log(4000.0))))
    gn, alpha = float(draw.uniform(6.0, 12.0)), float(draw.uniform(0.08, 0.25))
    press = RampHold(strain_rate=0.2, max_strain=0.35, hold_s=0.7, retract_rate=0.4)
    thickness = 0.02 * (1 + draw.normal(0.0, 0.02))
    scenario = Scenario(
        seed=seed,
        geometry=Geometry(area_m2=math.pi * 0.02**2, thickness_m=thickness),
        sites=(Site(Tissue(g, gn, alpha), (press,) * 2),),
        approach=Approach(slow_distance_m=0.002),
        force=ForceSensor(
            rate_hz=500.0,
            noise_n=NOISE,
            bias_n=float(draw.normal(0.0, 2.0)),
            drift_n_per_s=float(draw.normal(0.0, 0.001)),
        ),
        displacement=DisplacementSensor(
            rate_hz=500.0, noise_m=1e-5, delay_s=float(draw.normal(0.0, 0.0025))
        ),
        disturbances=Disturbances(
            compliance_m_per_n=abs(float(draw.normal(0.0, 1e-4))),
            friction_n=abs(float(draw.normal(0.0, 0.007))),
        ),
    )
    recording = simulate(scenario)
    streams = recording.force, recording.displacement
    times = [1e-9 * (one.stamp_ns - streams[0].stamp_ns[0]) + 1.0 for one in streams]
    force = np.outer(recording.force.value, DOWN)
    force[:, :2] += draw.normal(0.0, NOISE, (len(force), 2))
    position = np.outer(recording.displacement.value, DOWN) + np.array([0.3, -0.2, 0.1])
    RigBag(Streams("arm", times[0], force, times[1], position), *UR).write(folder)
    return math.log(g), math.log(gn), alpha


def errors(contact: dict[str, Any], truth: tuple[float, float, float]) -> dict[str, float]:
    """Return the errors of what a contact claims, in its deviations."""
    values = {
        "linear_stiffness": (np.log(contact["g"]), contact["g_sd"] / contact["g"]),
        "nonlinear_stiffness": (np.log(contact["g_n"]), contact["g_n_sd"] / contact["g_n"]),
        "fractional_order": (contact["alpha"], contact["alpha_sd"]),
    }
    return {
        name: float((values[name][0] - true) / values[name][1])
        for name, true in zip(values, truth, strict=True)
        if name in contact["converged_parameters"]
    }


@pytest.mark.parametrize("seeds", counts(1, 20))
def test_the_commands_of_the_quick_start_lead_from_a_bag_to_right_numbers(
    seeds, tmp_path, capsys, monkeypatch
):
    page, found = PAGE.read_text(encoding="utf-8"), []
    (configure,) = re.findall(r"(?m)^ {4}fden (configure press .*--robot ur .*)$", page)
    for seed in range(seeds):
        (tmp_path / str(seed)).mkdir()
        monkeypatch.chdir(tmp_path / str(seed))
        truth = recorded(Path("press"), seed)
        assert main(shlex.split(configure, comments=True)) == 0
        assert "ATTENTION" not in capsys.readouterr().out
        parameters = read_parameter_file(Path("probe.yaml"))
        assert parameters.force.axis @ DOWN > 0.99 < parameters.displacement.axis @ DOWN
        first, second = answer(capsys, "replay", "press", "--config", "probe.yaml")["contacts"]
        assert first["site"] == second["site"] == 1
        assert seed or not (first["flags"] or second["flags"])
        for contact in (first, second):
            assert all(abs(error) < 5.0 for error in errors(contact, truth).values()), seed
        found.append(errors(second, truth))
    assert len(found[0]) == 3
    for name in found[0] if seeds > 1 else ():
        off = [one[name] for one in found if name in one]
        assert np.sqrt(np.mean(np.square(off))) <= 1.3, name
