# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A new user's first hour: from a recording of an arm to numbers: configure, replay, report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from first_hour import FACE, LAYOUTS, THICKNESS, Truth, recorded

from fden_ros.cli import main
from fden_ros.parameters import read_parameter_file

#: Of white noise a sample [N].
NOISES = (0.005, 0.02, 0.05)
SEEDS = 20


def identified(
    folder: Path, layout: str, seed: int, noise: float, capsys: pytest.CaptureFixture[str]
) -> tuple[list[dict[str, Any]], Truth]:
    """Return the contacts that the commands find, the signs checked, and the truth."""
    rig = LAYOUTS[layout]
    folder.mkdir(parents=True)
    recording, truth = recorded(folder, layout, seed, noise)
    indenter = ("--flat-punch", f"{FACE:.4g}", "--thickness", f"{THICKNESS}")
    file, page = folder / "probe.yaml", folder / "press.html"
    assert run("configure", recording, *rig.options, *indenter, "-o", file) == 0
    assert "ATTENTION" not in capsys.readouterr().out
    assert_signs(file, layout)
    assert run("replay", recording, "--config", file, "--json") in (0, 3)
    contacts = json.loads(capsys.readouterr().out)["contacts"]
    assert run("report", recording, "--config", file, "-o", page) == 0
    assert page.stat().st_size > 0
    assert [one["site"] for one in contacts] == [1, 1, 1]
    return contacts, truth


def run(*arguments: Any) -> int:
    return main([str(argument) for argument in arguments])


def assert_signs(file: Path, layout: str) -> None:
    """Check that the file's axes are those of the layout; a table's signs stand in its columns."""
    parameters, rig = read_parameter_file(file), LAYOUTS[layout]
    if layout == "UR table":
        assert not parameters.force.inverted
        assert not parameters.displacement.inverted
        return
    assert parameters.force.axis @ rig.force > 0.99
    assert parameters.displacement.axis @ rig.displacement > 0.99


def deviations(contact: dict[str, Any], truth: Truth) -> dict[str, float]:
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


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_commands_lead_from_a_recording_to_numbers(
    layout: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contacts, truth = identified(tmp_path / "one", layout, 0, NOISES[1], capsys)
    assert all(contact["converged"] for contact in contacts)
    assert not any(contact["flags"] for contact in contacts)
    for contact in contacts:
        assert all(abs(error) < 5.0 for error in deviations(contact, truth).values())


@pytest.mark.statistics
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_errors_are_as_large_as_is_said(
    layout: str, noise: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last = []
    for seed in range(SEEDS):
        contacts, truth = identified(tmp_path / str(seed), layout, seed, noise, capsys)
        for contact in contacts:
            found = deviations(contact, truth)
            assert all(abs(error) < 5.0 for error in found.values()), (seed, found)
        last.append(found)
    for name in ("linear_stiffness", "nonlinear_stiffness", "fractional_order"):
        errors = [found[name] for found in last if name in found]
        assert np.sqrt(np.mean(np.square(errors))) <= 1.3, (name, errors)
