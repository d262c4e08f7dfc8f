# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A new user's first hour: from a recording of an arm to numbers: configure, replay, report."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from command_helpers import answer, fden
from numpy.typing import NDArray
from unknown_rig_bags import RigBag

from fden_ros.cli import main
from fden_ros.configure.streams import Streams
from fden_ros.parameters import read_parameter_file
from simulation.disturbance import Disturbances
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import Recording, simulate
from simulation.trajectory import Approach, RampHold

# Tissue, noise and the rig's errors are drawn; the errors as the parameters' defaults say.


Array = NDArray[np.float64]
FACE, THICKNESS = math.pi * 0.02**2, 0.02
DOWN = np.array([0.0, 0.0, -1.0])


class Truth(NamedTuple):
    """What is true of a press: ln G, ln Gn, alpha."""

    log_g: float
    log_gn: float
    alpha: float


@dataclass(frozen=True)
class Rig:
    """A layout: how often it samples, what a press makes of its axes, and how it is recorded.

    Attributes
    ----------
    rates
        Of force and displacement [Hz].
    force, displacement
        Direction of a growing force, and of a press, where they are recorded.
    options
        What a user adds to ``fden configure``.
    """

    rates: tuple[float, float]
    force: Array
    displacement: Array
    options: tuple[str, ...]
    record: Callable[[Path, Streams], Path]


def pressed(
    seed: int, noise: float, rates: tuple[float, float], hold: float, count: int
) -> tuple[Recording, Truth]:
    """Return presses of one place, to 7 mm, and the tissue that was drawn."""
    draw = np.random.default_rng([seed, 12])
    g = float(np.exp(draw.uniform(math.log(400.0), math.log(4000.0))))
    gn, alpha = float(draw.uniform(6.0, 12.0)), float(draw.uniform(0.08, 0.25))
    press = RampHold(strain_rate=0.2, max_strain=0.35, hold_s=hold, retract_rate=0.4)
    scenario = Scenario(
        seed=seed,
        geometry=Geometry(area_m2=FACE, thickness_m=THICKNESS * (1 + draw.normal(0.0, 0.02))),
        sites=(Site(Tissue(g, gn, alpha), (press,) * count),),
        approach=Approach(slow_distance_m=0.002),
        force=ForceSensor(
            rate_hz=rates[0],
            noise_n=noise,
            bias_n=float(draw.normal(0.0, 2.0)),
            drift_n_per_s=float(draw.normal(0.0, 0.001)),
        ),
        displacement=DisplacementSensor(
            rate_hz=rates[1], noise_m=1e-5, delay_s=float(draw.normal(0.0, 0.0025))
        ),
        disturbances=Disturbances(
            compliance_m_per_n=abs(float(draw.normal(0.0, 1e-4))),
            friction_n=abs(float(draw.normal(0.0, 0.007))),
        ),
    )
    return simulate(scenario), Truth(math.log(g), math.log(gn), alpha)


def recorded(
    folder: Path, layout: str, seed: int, noise: float, hold: float = 0.7, count: int = 2
) -> tuple[Path, Truth]:
    """Write a recording in a layout, of presses that are held [s]; return it with its truth."""
    rig = LAYOUTS[layout]
    recording, truth = pressed(seed, noise, rig.rates, hold, count)
    draw = np.random.default_rng([seed, 13])
    seconds = [
        1e-9 * (stream.stamp_ns - recording.force.stamp_ns[0]) + 1.0
        for stream in (recording.force, recording.displacement)
    ]
    force = np.outer(recording.force.value, rig.force)
    # What the other axes read.
    across = np.eye(3) - np.outer(rig.force, rig.force)
    force += draw.normal(0.0, noise, force.shape) @ across
    position = np.outer(recording.displacement.value, rig.displacement)
    position += np.array([0.3, -0.2, 0.1])
    streams = Streams(layout, seconds[0], force, seconds[1], position)
    return rig.record(folder, streams), truth


def _as_bag(force: str, displacement: str) -> Callable[[Path, Streams], Path]:
    def record(folder: Path, streams: Streams) -> Path:
        return RigBag(streams, force, displacement).write(folder / "bag")

    return record


_SLANTED = np.array([0.36, 0.48, -0.8])
LAYOUTS = {
    "UR bag": Rig(
        (500.0, 500.0),
        DOWN,
        DOWN,
        ("--robot", "ur"),
        _as_bag("/force_torque_sensor_broadcaster/wrench", "/tcp_pose_broadcaster/pose"),
    ),
    "dVRK bag": Rig(
        (200.0, 200.0),
        -DOWN,
        _SLANTED,
        ("--robot", "crtk"),
        _as_bag("/PSM1/body/measured_cf", "/PSM1/measured_cp"),
    ),
}


#: Of white noise a sample [N].
NOISES = (0.005, 0.02, 0.05)
SEEDS = 20
PAGE = Path(__file__).parent.parent / "docs" / "quickstart.md"


def identified(
    folder: Path,
    layout: str,
    seed: int,
    noise: float,
    capsys: pytest.CaptureFixture[str],
    **options: Any,
) -> tuple[list[dict[str, Any]], Truth]:
    """Return the contacts that the commands find, the signs checked, and the truth."""
    rig = LAYOUTS[layout]
    folder.mkdir(parents=True)
    recording, truth = recorded(folder, layout, seed, noise, **options)
    indenter = ("--flat-punch", f"{FACE:.4g}", "--thickness", f"{THICKNESS}")
    file = folder / "probe.yaml"
    assert fden("configure", recording, *rig.options, *indenter, "-o", file) == 0
    assert "ATTENTION" not in capsys.readouterr().out
    assert_signs(file, layout)
    contacts = answer(capsys, "replay", recording, "--config", file)["contacts"]
    assert {one["site"] for one in contacts} == {1}
    return contacts, truth


def assert_signs(file: Path, layout: str) -> None:
    """Check that the file's axes are those of the layout."""
    parameters, rig = read_parameter_file(file), LAYOUTS[layout]
    assert parameters.force.axis @ rig.force > 0.99
    assert parameters.displacement.axis @ rig.displacement > 0.99


def deviations(contact: dict[str, Any], truth: Truth) -> dict[str, float]:
    """Return the errors of what a contact claims, in its deviations."""
    if not contact["converged_parameters"]:
        return {}
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


def test_the_commands_of_the_quick_start_lead_from_a_bag_to_numbers(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bag, truth = recorded(tmp_path, "UR bag", 0, NOISES[1])
    bag.rename("press")
    page = PAGE.read_text(encoding="utf-8")
    (configure,) = re.findall(r"(?m)^ {4}fden (configure press .*--robot ur .*)$", page)
    for line in (configure, "replay press --config probe.yaml"):
        assert main(shlex.split(line, comments=True)) == 0, line
    assert_signs(tmp_path / "probe.yaml", "UR bag")
    assert capsys.readouterr().out.count(" converged ") == 2
    for contact in answer(capsys, "replay", "press", "--config", "probe.yaml")["contacts"]:
        assert not contact["flags"]
        assert all(abs(error) < 5.0 for error in deviations(contact, truth).values())


@pytest.mark.statistics
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_errors_are_as_large_as_is_said(layout, noise, tmp_path, capsys):
    last = []
    for seed in range(SEEDS):
        contacts, truth = identified(
            tmp_path / str(seed), layout, seed, noise, capsys, hold=2.0, count=3
        )
        for contact in contacts:
            found = deviations(contact, truth)
            assert all(abs(error) < 5.0 for error in found.values()), (seed, found)
        last.append(found)
    for name in ("linear_stiffness", "nonlinear_stiffness", "fractional_order"):
        errors = [found[name] for found in last if name in found]
        assert np.sqrt(np.mean(np.square(errors))) <= 1.3, (name, errors)
