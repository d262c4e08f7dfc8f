# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Scenario files: those that come along, and what is said about wrong ones."""

from __future__ import annotations

import copy
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from fden_ros.errors import InputError
from simulation.disturbance import Disturbances
from simulation.scenario import (
    load_scenario,
    scenario_names,
    scenario_of_mapping,
)

GOOD = {
    "name": "trial",
    "geometry": {"kind": "flat_punch", "area_m2": 1e-4, "thickness_m": 0.02},
    "sites": [
        {
            "tissue": {
                "linear_stiffness": 520,
                "nonlinear_stiffness": 8.5,
                "fractional_order": 0.131,
            },
            "position_m": [0.0, 0.01],
            "presses": [{"kind": "ramp", "strain_rate": 0.1, "max_strain": 0.3}],
        }
    ],
}


def changed(path, value):
    """GOOD with one value changed, or removed where it is None."""
    data = copy.deepcopy(GOOD)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return data


def test_every_disturbance_is_a_key_of_a_scenario_file_that_comes_along():
    text = (Path(__file__).parents[1] / "bags" / "robot_arm.yaml").read_text()
    for field in fields(Disturbances):
        assert f"  {field.name}:" in text
    assert load_scenario("robot_arm").disturbances.moves_tissue


def test_scenario_is_found_in_a_sourced_workspace(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "fden_ros" / "bags"
    folder.mkdir(parents=True)
    (folder / "my_own.yaml").write_text(yaml.safe_dump(GOOD))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert "my_own" in scenario_names()
    assert load_scenario("my_own").name == "trial"


@pytest.mark.parametrize(
    "path, value, complaint",
    [
        (("sead",), 3, "key 'sead' is unknown; did you mean 'seed'"),
        (("sites", 0, "presses", 0, "kind"), "rmp", "did you mean 'ramp'"),
        (("sites", 0, "presses", 0, "kind"), None, "kind is missing; it is one of palpation"),
        (("sites", 0, "presses", 0, "strain_rate"), -0.1, "must be positive"),
        (("sites", 0, "stiffening"), {"strain": 0.1, "ratio": 0.5}, "at least 1"),
        (("sites", 0, "presses", 0, "strain_rate"), "fast", "must be a finite number"),
        (("sites", 0, "position_m"), [1.0], "must have 2"),
        (("sites", 0, "tissue", "linear_stiffness"), None, "linear_stiffness is missing"),
        (("sites", 0, "tissue", "draw"), "livre", "did you mean 'liver'"),
        (("sites",), None, "sites is missing"),
        (("geometry", "kind"), "sphere", "sphere needs radius_m"),
        (("seed",), 1.5, "whole number"),
        (("force",), {"axis": [0.0, 0.0, 2.0]}, "unit vector"),
        (("force",), {"noise_n": 1.0, "noise_stress_pa": 1.0}, "give one of them"),
        (("approach",), {"slow_distance_m": 1.0}, "slow_distance_m"),
        (("dropouts",), [{"stream": "force", "start_s": 1.0}], "duration_s is missing"),
        (("disturbances",), {"hum_n": -1.0}, "hum_n is -1.0; it must be 0 or positive"),
        (("disturbances",), {"breathing": {"rate_variation": 1.0}}, "must be below 1"),
    ],
)
def test_wrong_value_is_refused_in_one_line_that_says_what_is_right(path, value, complaint):
    with pytest.raises(InputError) as refusal:
        scenario_of_mapping(changed(path, value))
    message = str(refusal.value)
    assert complaint in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("name: [1\n", "line 2: is not valid YAML"),
        ("- 1\n", "must be a mapping"),
    ],
)
def test_file_that_is_no_scenario_is_named_with_its_fault(tmp_path, text, complaint):
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        load_scenario(path)
    assert complaint in str(refusal.value)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)
