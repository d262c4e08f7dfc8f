"""The table of parameters: checks, files, and what the pipeline makes of them."""

from __future__ import annotations

import math
import re

import pytest

from fden_ros.core.config import PipelineConfig
from fden_ros.core.law.geometry import FlatPunch, PassThrough, Sphere, TorsionalRheometer
from fden_ros.errors import InputError
from fden_ros.parameters import (
    PARAMETERS,
    check,
    defaults,
    pipeline_config,
    read_parameter_file,
    unit_vector,
)
from fden_ros.tissues.library import load_library


def refused(values):
    with pytest.raises(InputError) as caught:
        check(values)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_default_passes_its_own_check_and_keeps_its_type(parameter):
    value = parameter.check(parameter.default)
    assert value == parameter.default
    assert type(value) is type(parameter.default)
    assert parameter.unit
    assert parameter.description.endswith(".")


def test_names_are_unique_and_lower_case_with_dots():
    names = [parameter.name for parameter in PARAMETERS]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z_]+(\.[a-z_]+)*", name) for name in names)


def test_what_is_not_given_takes_its_default():
    assert check({}) == defaults()
    assert check({"geometry.area": 2e-4}) == defaults() | {"geometry.area": 2e-4}


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("geometry.aera", "geometry.area"),
        ("force.treshold", "force.threshold"),
        ("aplha.value", "alpha.value"),
    ],
)
def test_unknown_name_suggests_the_nearest(name, nearest):
    assert f"there is no parameter {name}; did you mean {nearest}" in refused({name: 1.0})


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [
        ("geometry.area", "large", "must be a number"),
        ("geometry.area", True, "must be a number"),
        ("geometry.area", None, "must be a number"),
        ("geometry.area", [1.0, 2.0, 3.0], "must be a number"),
        ("geometry.area", 0.0, "1e-09 to 1"),
        ("geometry.area", 2.0, "1e-09 to 1"),
        ("geometry.area", math.nan, "1e-09 to 1"),
        ("geometry.area", math.inf, "1e-09 to 1"),
        ("geometry.hayes", 1, "must be true or false"),
        ("geometry.kind", "cube", "must be one of flat_punch, sphere"),
        ("geometry.kind", 3, "must be a text"),
        ("force.axis", [0.0, 0.0, 0.0], "three numbers, not all 0"),
        ("dither.frequencies", [], "must be a list of 1 to 8 numbers"),
        ("dither.frequencies", [1.0, -1.0], "each 0 to 1000"),
        ("dither.frequencies", ["fast"], "must be a list of 1 to 8 numbers"),
        ("force.axis", [0.0, 1.0], "must be a list of three numbers"),
        ("force.axis", "001", "must be a list of three numbers"),
        ("force.axis", [0.0, math.nan, 1.0], "three numbers, not all 0"),
        ("force.axis", [0.0, "x", 1.0], "three numbers, not all 0"),
        ("alpha.value", 0.7, "0.02 to 0.6"),
    ],
)
def test_value_that_is_not_allowed_says_what_is(name, value, right):
    message = refused({name: value})
    assert message.startswith(f"parameter {name} is ")
    assert right in message


def test_whole_number_will_do_for_a_number():
    value = check({"converged.log_sd": 1})["converged.log_sd"]
    assert value == 1.0
    assert isinstance(value, float)


def test_bounds_themselves_are_allowed():
    for parameter in PARAMETERS:
        for bound in (parameter.minimum, parameter.maximum):
            if math.isfinite(bound):
                value = [bound] if parameter.most else bound
                assert parameter.check(value) == value


def read(tmp_path, text, **options):
    path = tmp_path / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    return read_parameter_file(path, **options)


@pytest.mark.parametrize(
    "text",
    [
        "geometry.area: 2.0e-4\nalpha.source: given\n",
        "geometry: {area: 2.0e-4}\nalpha: {source: given}\n",
        "/**:\n  ros__parameters:\n    geometry.area: 2.0e-4\n    alpha: {source: given}\n",
        "identifier:\n  ros__parameters:\n    geometry: {area: 2.0e-4}\n    alpha.source: given\n",
        "/arm/identifier:\n  ros__parameters: {geometry.area: 2.0e-4, alpha.source: given}\n",
        "other:\n  ros__parameters: {geometry.area: 3.0e-4, none.of.ours: 1}\n"
        "/**:\n  ros__parameters: {geometry.area: 2.0e-4, alpha.source: given}\n",
    ],
    ids=["dotted", "nested", "any node", "by name", "with namespace", "among others"],
)
def test_file_is_read_in_every_form(tmp_path, text):
    expected = defaults() | {"geometry.area": 2e-4, "alpha.source": "given"}
    assert read(tmp_path, text) == expected


def test_section_of_the_node_outdoes_that_of_any_node(tmp_path):
    text = (
        "identifier:\n  ros__parameters: {geometry.area: 3.0e-4}\n"
        "/**:\n  ros__parameters: {geometry.area: 2.0e-4, geometry.thickness: 0.03}\n"
    )
    values = read(tmp_path, text)
    assert values["geometry.area"] == 3e-4
    assert values["geometry.thickness"] == 0.03


def test_parameters_of_every_node_are_passed_over(tmp_path):
    text = "/**:\n  ros__parameters: {use_sim_time: true, autostart: true}\n"
    assert read(tmp_path, text) == defaults()


@pytest.mark.parametrize("text", ["", "# nothing yet\n", "/**:\n  ros__parameters:\n"])
def test_empty_file_is_all_defaults(tmp_path, text):
    assert read(tmp_path, text) == defaults()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("geometry: [", "not valid YAML"),
        ("- 1\n- 2\n", "no mapping"),
        ("just text", "no mapping"),
        ("geometry.area: large\n", "must be a number"),
        ("geometry.aera: 1.0\n", "did you mean geometry.area"),
        ("geometry.area: .nan\n", "parameter geometry.area is nan"),
        ("/**:\n  ros__parameters: 3\n", "must be a mapping"),
    ],
)
def test_mistake_in_a_file_is_told_in_one_line(tmp_path, text, said):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_parameter_file(tmp_path / "none.yaml")


def test_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_parameter_file(path)


def test_axis_is_normalised():
    assert unit_vector([0.0, 0.0, -4.0]) == (0.0, 0.0, -1.0)
    assert pipeline_config(
        check({"displacement.axis": [3.0, 4.0, 0.0]})
    ).contact.approach_axis == (pytest.approx((0.6, 0.8, 0.0)))


@pytest.mark.parametrize(
    ("values", "geometry"),
    [
        ({"geometry.area": 2e-4, "geometry.thickness": 0.03}, FlatPunch(2e-4, 0.03)),
        (
            {"geometry.hayes": True, "geometry.poisson_ratio": 0.45},
            FlatPunch(1e-4, 0.02, 0.45),
        ),
        ({"geometry.kind": "sphere", "geometry.radius": 0.01}, Sphere(0.01)),
        (
            {"geometry.kind": "torsional_rheometer", "geometry.radius": 0.01},
            TorsionalRheometer(0.01, 0.02),
        ),
        ({"geometry.kind": "pass_through"}, PassThrough()),
    ],
    ids=["flat", "hayes", "sphere", "rheometer", "pass through"],
)
def test_geometry_is_made_of_its_parameters(values, geometry):
    assert pipeline_config(check(values)).geometry == geometry


def test_defaults_of_the_table_are_those_of_the_core():
    config = pipeline_config(defaults())
    core = PipelineConfig(library=load_library())
    for part in ("geometry", "synchronize", "contact", "estimator"):
        assert getattr(config, part) == getattr(core, part)
    assert config.strain_origin is None
    assert config.block_duration == core.block_duration


def test_given_order_and_origin_reach_the_estimator():
    config = pipeline_config(
        check(
            {
                "alpha.source": "given",
                "alpha.value": 0.3,
                "alpha.sd": 0.02,
                "origin.source": "given",
                "origin.displacement": -0.1,
            }
        )
    )
    assert config.estimator.fractional_order_given
    assert config.estimator.prior.fractional_order == 0.3
    assert config.estimator.prior.fractional_order_sd == 0.02
    assert config.strain_origin == -0.1


def test_library_that_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match="tissue library"):
        pipeline_config(check({"classifier.library": str(tmp_path / "none.yaml")}))
