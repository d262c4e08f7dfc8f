# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The table of parameters: checks, files, and what the pipeline makes of them."""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from pathlib import Path

import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped
from sensor_msgs.msg import JointState
from test_parameter_effects import EFFECTS

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.law.geometry import FlatPunch, PassThrough, Sphere, TorsionalRheometer
from fden_ros.errors import InputError
from fden_ros.parameters import (
    PARAMETERS,
    Parameters,
    check,
    pipeline_config,
    read_parameter_file,
    tool_weight,
)
from fden_ros.ros.inputs import Inputs
from fden_ros.tissues.library import load_library
from simulation.simulate import EXACT


def refused(values):
    with pytest.raises(InputError) as caught:
        check(values)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_not_given_takes_its_default():
    assert check({}) == Parameters()
    assert check({}).as_dict() == {p.name: p.default for p in PARAMETERS}
    changed = check({"geometry.area": 2e-4})
    assert changed.geometry.area == 2e-4
    assert changed.changed({"geometry.area": 0.0}) == Parameters()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("geometry.aera", "; did you mean geometry.area"),
        ("stale_timout", "; did you mean stale_timeout"),
        ("alpha.source", " any more: use alpha.learn: true for prior, false for given"),
    ],
)
def test_unknown_name_suggests_the_nearest_and_an_old_one_the_new(name, said):
    assert refused({name: 1.0}).startswith(f"there is no parameter {name}{said}")


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [
        ("geometry.area", "large", "must be a number"),
        ("geometry.thickness", 20.0, "[m]: 20 mm are 0.02 m"),
        ("geometry.area", 2.0, "1e-09 to 1"),
        ("geometry.area", math.nan, "1e-09 to 1"),
        ("geometry.hayes", 1, "must be true or false"),
        ("geometry.kind", "cube", "must be one of flat_punch, sphere"),
        ("force.axis", [0.0, 0.0, 0.0], "three numbers, not all 0"),
        ("dither.frequencies", [1.0, -1.0], "each 0 to 1000"),
        ("prior.alpha", 0.7, "0.02 to 0.6"),
    ],
)
def test_value_that_is_not_allowed_says_what_is(name, value, right):
    message = refused({name: value})
    assert message.startswith(f"parameter {name} is ")
    assert right in message


PUNCH = {"geometry.area": 1e-4, "geometry.thickness": 0.02}


@pytest.mark.parametrize(
    ("values", "geometry"),
    [
        ({"geometry.area": 2e-4, "geometry.thickness": 0.03}, FlatPunch(2e-4, 0.03)),
        (
            {**PUNCH, "geometry.hayes": True, "geometry.poisson_ratio": 0.45},
            FlatPunch(1e-4, 0.02, 0.45),
        ),
        ({"geometry.kind": "sphere", "geometry.radius": 0.01}, Sphere(0.01)),
        (
            {
                "geometry.kind": "torsional_rheometer",
                "geometry.radius": 0.01,
                "geometry.thickness": 0.02,
            },
            TorsionalRheometer(0.01, 0.02),
        ),
        ({"geometry.kind": "pass_through"}, PassThrough()),
        ({"geometry.area": 2e-4}, FlatPunch(2e-4, 0.02, is_stated=False)),
    ],
    ids=["flat", "hayes", "sphere", "rheometer", "pass through", "half stated"],
)
def test_geometry_is_made_of_its_parameters(values, geometry):
    assert pipeline_config(check(values)).geometry == geometry


def test_defaults_of_the_table_are_those_of_the_core_but_for_what_an_arm_leaves_open():
    config = pipeline_config(Parameters())
    core = PipelineConfig(library=load_library())
    for part in ("geometry", "synchronize", "contact", "plausibility", "strain_origin"):
        assert getattr(config, part) == getattr(core, part)
    assert config.block_duration == core.block_duration
    arm, exact = config.estimator, core.estimator
    own = {name: getattr(exact, name) for name in ("uncertainty", "converged_log_sd")}
    assert replace(arm, **own) == exact == pipeline_config(check(EXACT)).estimator
    assert exact.uncertainty == Uncertainty()
    assert set(astuple(exact.uncertainty)) == {0.0} and min(astuple(arm.uncertainty)) > 0.0
    # With the core's limit an arm would seldom converge.
    assert (arm.converged_log_sd, exact.converged_log_sd) == (0.1, 0.05)


def test_the_parameters_of_a_bench_leave_out_the_model_s_error_only():
    path = Path(__file__).parent.parent / "config" / "bench.yaml"
    bench = pipeline_config(read_parameter_file(path)).estimator
    arm = pipeline_config(Parameters()).estimator.uncertainty
    assert bench.uncertainty == Uncertainty(
        kernel_sd=arm.kernel_sd, characteristic_sd=arm.characteristic_sd
    )
    assert bench.converged_log_sd == 0.05


@pytest.mark.parametrize("learn", [True, False])
def test_alpha_is_learned_from_the_prior_or_given_by_it(learn):
    stated = {"alpha.learn": learn, "prior.alpha": 0.3, "prior.alpha_sd": 0.02}
    estimator = pipeline_config(check(stated)).estimator
    assert estimator.fractional_order_given is not learn
    prior = estimator.prior
    assert (prior.fractional_order, prior.fractional_order_sd) == (0.3, 0.02)


# What each parameter does to what comes out is in test_parameter_effects.py; here, where those
# arrive whose effect is shown of the part that takes them (test_core_decision.py).

ARRIVES = {
    "force.friction": (0.01, lambda c: c.estimator.friction),
    "rig.learn": (True, lambda c: c.learns_rig),
    "surface.learn_motion": (False, lambda c: c.learns_motion),
    "force.learn_drift": (False, lambda c: c.learns_drift),
    "plausible.force": (50.0, lambda c: c.plausibility.most_force),
    "plausible.strain_rate": (0.0, lambda c: c.plausibility.least_strain_rate),
    "converged.linear_log_sd": (0.2, lambda c: c.estimator.converged_linear_log_sd),
    "converged.alpha_sd": (0.02, lambda c: c.estimator.converged_order_sd),
    "classification.probability": (0.9, lambda c: c.decision.probability),
    "classification.release": (0.6, lambda c: c.decision.release),
    "classification.dwell": (1.0, lambda c: c.decision.dwell),
    "classification.significance": (0.01, lambda c: c.decision.significance),
}


@pytest.mark.parametrize("name", ARRIVES)
def test_parameter_arrives_where_the_core_takes_it(name):
    value, look = ARRIVES[name]
    assert look(pipeline_config(check({name: value}))) == value
    assert look(pipeline_config(check({}))) != value


@pytest.mark.parametrize(
    ("geometry", "distance"),
    [
        ({"geometry.area": math.pi * 0.007**2}, 0.0014),
        ({"geometry.kind": "sphere", "geometry.radius": 0.001}, 0.0005),
        ({"geometry.kind": "pass_through"}, 0.0005),
    ],
)
def test_distance_between_sites_follows_the_probe_s_radius(geometry, distance):
    config = pipeline_config(check(geometry))
    assert config.contact.site_distance == pytest.approx(distance)
    given = pipeline_config(check(geometry | {"site.distance": 0.004}))
    assert given.contact.site_distance == 0.004


QUARTER = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # about x: z of the sensor is -y of the world


@pytest.mark.parametrize(
    ("values", "load"),
    [
        ({"tool.mass": 0.2}, 0.0),
        ({"tool.mass": 0.2, "tool.gravity": [0.0, -10.0, 0.0]}, 2.0),
        (
            {
                "tool.mass": 0.2,
                "tool.gravity": [0.0, 0.0, -10.0],
                "tool.centre_of_mass": [0.1, 0.0, 0.0],
                "geometry.kind": "torsional_rheometer",
            },
            -0.2,
        ),
    ],
    ids=["mass", "gravity", "lever"],
)
def test_tool_is_made_of_its_parameters(values, load):
    assert tool_weight(check({})) is None
    tool = tool_weight(check(values))
    assert tool.load(QUARTER) == pytest.approx(load, abs=1e-12)


class Samples:
    """What a projector hands on: the names after add_, and the second number."""

    def __init__(self):
        self.heard = []

    def __getattr__(self, name):
        return lambda stamp_ns, value, *_: self.heard.append((name.removeprefix("add_"), value))


WRENCH = WrenchStamped()
WRENCH.wrench.force.x, WRENCH.wrench.force.z = 1.0, 3.0
POINT = PointStamped()
POINT.point.x, POINT.point.z = 0.1, 0.3
JOINTS = JointState(name=["a", "b"], position=[0.1, 0.2], effort=[1.0, 2.0])
READ = {
    "force.axis": ([2.0, 0.0, 0.0], "force", WRENCH, 3.0, 1.0),
    "force.name": ("b", "force", JOINTS, 1.0, 2.0),
    "force.inverted": (True, "force", JOINTS, 1.0, -1.0),
    "displacement.axis": ([2.0, 0.0, 0.0], "displacement", POINT, 0.3, 0.1),
    "displacement.name": ("b", "displacement", JOINTS, 0.1, 0.2),
    "displacement.inverted": (True, "displacement", JOINTS, 0.1, -0.1),
    "surface.axis": ([-2.0, 0.0, 0.0], "surface", POINT, 0.3, -0.1),
    "surface.name": ("b", "surface", JOINTS, 0.1, 0.2),
    "surface.scale": (-0.5, "surface", JOINTS, 0.1, -0.05),
}


@pytest.mark.parametrize("name", READ)
def test_parameter_says_what_of_a_message_counts(name):
    value, stream, message, usual, expected = READ[name]
    for parameters, number in (({}, usual), ({name: value}, expected)):
        samples = Samples()
        inputs = Inputs(check({"surface.message": "point"} | parameters), samples)
        inputs.add(stream, message)
        assert samples.heard == [(stream, number)]


#: Shown with the running node, in test_parameter_files.py.
LIVE = {"force.message", "displacement.message"}
TOOLS = {"tool.mass", "tool.centre_of_mass", "tool.gravity"}
#: In test_frames.py and test_along_tool.py.
FRAMES = {"frames.base", "frames.probe", "displacement.along_tool", "surface.normal"}


def test_no_parameter_is_without_a_test():
    shown = {*EFFECTS, *ARRIVES, *READ, *LIVE, *TOOLS, *FRAMES, "classifier.library"}
    assert shown == {parameter.name for parameter in PARAMETERS}
