# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Scenario files: those that come along, and what is said about wrong ones."""

from __future__ import annotations

import copy
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml

from fden_ros.errors import InputError
from fden_ros.simulation.disturbance import Disturbances
from fden_ros.simulation.scenario import (
    Geometry,
    Tissue,
    load_scenario,
    scenario_names,
    scenario_of_mapping,
)
from fden_ros.simulation.trajectory import Palpation

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


def test_stiffening_does_not_go_with_a_disturbed_motion():
    given = changed(("sites", 0, "stiffening"), {"strain": 0.1, "ratio": 3.0})
    scenario_of_mapping(given | {"disturbances": {"friction_n": 0.01}})
    with pytest.raises(InputError, match="a stiffening does not go with"):
        scenario_of_mapping(given | {"disturbances": {"backlash_m": 1e-4}})


def test_scenario_is_found_in_a_sourced_workspace(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "fden_ros" / "bags"
    folder.mkdir(parents=True)
    (folder / "my_own.yaml").write_text(yaml.safe_dump(GOOD))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert "my_own" in scenario_names()
    assert load_scenario("my_own").name == "trial"


def test_numbers_without_a_dot_and_defaults_are_understood(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "geometry: {area_m2: 1e-4, thickness_m: 0.02}\n"
        "sites:\n"
        "  - tissue: {draw: liver}\n"
        "    presses: [{kind: palpation, strain_rate: 1, max_strain: 0.2}]\n"
    )
    scenario = load_scenario(path)
    assert scenario.name == "mine"
    assert scenario.geometry == Geometry("flat_punch", area_m2=1e-4, thickness_m=0.02)
    assert scenario.sites[0].presses == (Palpation(strain_rate=1.0, max_strain=0.2),)
    assert scenario.sites[0].presses[0].presses == 10


@pytest.mark.parametrize(
    "path, value, complaint",
    [
        (("sead",), 3, "key 'sead' is unknown; did you mean 'seed'"),
        (("geometry", "thikness_m"), 0.1, "did you mean 'thickness_m'"),
        (("sites", 0, "presses", 0, "strain_rat"), 1.0, "did you mean 'strain_rate'"),
        (("sites", 0, "presses", 0, "kind"), "rmp", "did you mean 'ramp'"),
        (("sites", 0, "presses", 0, "kind"), None, "kind is missing; it is one of palpation"),
        (("sites", 0, "presses", 0, "max_strain"), None, "max_strain is missing"),
        (("sites", 0, "presses", 0, "strain_rate"), -0.1, "must be positive"),
        (("sites", 0, "stiffening"), {"strain": 0.1, "ratio": 0.5}, "at least 1"),
        (("sites", 0, "stiffening"), {"strain": 0.1}, "ratio is missing"),
        (("sites", 0, "presses", 0, "strain_rate"), "fast", "must be a finite number"),
        (("sites", 0, "presses", 0, "strain_rate"), float("nan"), "must be a finite number"),
        (("sites", 0, "presses"), [], "presses is empty"),
        (("sites", 0, "presses"), {"kind": "ramp"}, "must be a list"),
        (("sites", 0, "position_m"), [1.0], "must have 2"),
        (("sites", 0, "tissue", "linear_stiffness"), None, "linear_stiffness is missing"),
        (("sites", 0, "tissue", "draw"), "livre", "did you mean 'liver'"),
        (("sites", 0, "tissue"), 5, "must be a mapping"),
        (("sites",), None, "sites is missing"),
        (("geometry", "kind"), "sphere", "sphere needs radius_m"),
        (("geometry", "area_m2"), None, "needs area_m2 and thickness_m or radius_m"),
        (("seed",), 1.5, "whole number"),
        (("seed",), -1, "0 or positive"),
        (("name",), 7, "must be text"),
        (("force",), {"axis": [0.0, 0.0, 2.0]}, "unit vector"),
        (("force",), {"noise_n": 1.0, "noise_stress_pa": 1.0}, "give one of them"),
        (("displacement",), {"message": "poses"}, "did you mean 'pose'"),
        (("displacement",), {"rate_hz": 0.0}, "rate_hz is 0.0; it must be positive"),
        (("approach",), {"slow_distance_m": 1.0}, "slow_distance_m"),
        (("dropouts",), [{"stream": "force", "start_s": 1.0}], "duration_s is missing"),
        (("disturbances",), {"hum": 1.0}, "did you mean 'hum_n'"),
        (("disturbances",), {"hum_n": -1.0}, "hum_n is -1.0; it must be 0 or positive"),
        (("disturbances",), {"creep_s": 0.0}, "creep_s is 0.0; it must be positive"),
        (("disturbances",), {"vibration_at_rest": 1}, "must be true or false"),
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
        ("", "must be a mapping"),
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


def test_unknown_name_is_answered_with_the_nearest_one():
    with pytest.raises(InputError, match="did you mean 'palpation'"):
        load_scenario("palpaton")
    with pytest.raises(InputError, match="no such file"):
        load_scenario("somewhere/else.yaml")


def test_drawn_liver_has_the_statistics_of_the_paper_within_its_ranges():
    generator = np.random.default_rng(0)
    models = [Tissue(draw="liver").model(generator) for _ in range(4000)]
    g, gn, alpha = np.array(
        [(m.linear_stiffness, m.nonlinear_stiffness, m.fractional_order) for m in models]
    ).T
    assert g.min() >= 341.8 and g.max() <= 1294.0
    assert gn.min() >= 5.26 and gn.max() <= 13.18
    assert alpha.min() >= 0.118 and alpha.max() <= 0.146
    assert np.mean(g) == pytest.approx(544.8, rel=0.05)
    assert np.std(g) == pytest.approx(155.3, rel=0.15)
    assert np.mean(gn) == pytest.approx(8.547, rel=0.02)
    assert np.std(gn) == pytest.approx(1.604, rel=0.1)
    assert np.mean(alpha) == pytest.approx(0.131, rel=0.01)
