# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The table of parameters: checks, files, and what each does to what comes out."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped
from pipeline_helpers import LIVER_PARAMETERS, refusal
from sensor_msgs.msg import JointState

from benchmark.trial import through
from fden_ros.core import ContactSummary, Status, TissueState
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import NOTHING_UNKNOWN, Uncertainty
from fden_ros.core.law import FlatPunch, PassThrough, Sphere, TorsionalRheometer
from fden_ros.inputs import Inputs
from fden_ros.parameters import (
    PARAMETERS,
    Parameters,
    check,
    pipeline_config,
    read_parameter_file,
    tool_weight,
)
from simulation.disturbance import Disturbances
from simulation.scenario import (
    DisplacementSensor,
    Dropout,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import EXACT, Recording, simulate
from simulation.trajectory import Approach, RampHold


def test_what_is_not_given_takes_its_default():
    assert check({}) == Parameters()
    assert check({}).as_dict() == {p.name: p.default for p in PARAMETERS}
    changed = check({"geometry.area": 2e-4})
    assert changed.geometry.area == 2e-4
    assert changed.changed({"geometry.area": 0.0}) == Parameters()


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [
        ("geometry.area", "large", "must be a number"),
        ("geometry.thickness", 20.0, "[m]: 20 mm are 0.02 m"),
        ("geometry.area", 2.0, "1e-18 to 1"),
        ("geometry.area", math.nan, "1e-18 to 1"),
        ("geometry.hayes", 1, "must be true or false"),
        ("geometry.kind", "cube", "must be one of flat_punch, sphere"),
        ("force.axis", [0.0, 0.0, 0.0], "three numbers, not all 0"),
        ("dither.frequencies", [1.0, -1.0], "each 0 to 1000"),
        ("prior.alpha", 0.7, "0 to 0.6"),
    ],
)
def test_value_that_is_not_allowed_says_what_is(name, value, right):
    message = refusal(check, {name: value})
    assert message.startswith(f"parameter {name} is ")
    assert right in message


PUNCH = {"geometry.area": 1e-4, "geometry.thickness": 0.02}
SPHERE = {"geometry.kind": "sphere", "geometry.radius": 0.01}


@pytest.mark.parametrize(
    ("values", "geometry"),
    [
        ({"geometry.area": 2e-4, "geometry.thickness": 0.03}, FlatPunch(2e-4, 0.03)),
        (
            {**PUNCH, "geometry.hayes": True, "geometry.poisson_ratio": 0.45},
            FlatPunch(1e-4, 0.02, 0.45),
        ),
        (SPHERE, Sphere(0.01)),
        (
            {**SPHERE, "geometry.thickness": 0.02, "geometry.bonded": False},
            Sphere(0.01, 0.02, is_bonded=False),
        ),
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
    ids=["flat", "hayes", "sphere", "layer", "rheometer", "pass through", "half stated"],
)
def test_geometry_is_made_of_its_parameters(values, geometry):
    assert pipeline_config(check(values)).geometry == geometry


def test_no_default_stands_twice():
    config = pipeline_config(Parameters())
    assert config == PipelineConfig(config.library)
    assert len({parameter.name for parameter in PARAMETERS}) == len(PARAMETERS)


def test_exact_parameters_leave_nothing_unknown():
    assert pipeline_config(check(EXACT)).estimator.uncertainty == NOTHING_UNKNOWN
    assert min(astuple(Uncertainty())) > 0.0


def test_the_parameters_of_a_bench_leave_out_the_model_s_error_only():
    path = Path(__file__).parent.parent / "config" / "bench.yaml"
    bench = pipeline_config(read_parameter_file(path)).estimator
    stated = Uncertainty().characteristic_sd
    assert bench.uncertainty == replace(NOTHING_UNKNOWN, characteristic_sd=stated)
    assert bench.converged_log_gn_sd == 0.05


def other_value(parameter):
    """A value that is allowed and is not the default."""
    default = parameter.default
    if isinstance(default, bool):
        return not default
    if isinstance(default, str):
        return next((one for one in parameter.choices if one != default), "other")
    if isinstance(default, list):
        return [1.0, 2.0, 3.0]
    return parameter.minimum if default != parameter.minimum else parameter.maximum


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.name)
def test_a_name_sets_the_one_field_that_declares_it(parameter):
    value = other_value(parameter)
    # A kind of geometry is refused without its size.
    size = {"geometry.radius": 0.01} if parameter.name == "geometry.kind" else {}
    changed = check({parameter.name: value, **size}).as_dict()
    usual = Parameters().as_dict()
    assert changed == usual | {parameter.name: value, **size} != usual


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
                "geometry.radius": 0.01,
                "geometry.thickness": 0.002,
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
}


@pytest.mark.parametrize(("stream", "message"), [("force", WRENCH), ("displacement", POINT)])
def test_inverted_turns_vectors_too(stream, message):
    samples = Samples()
    inputs = Inputs(check({f"{stream}.inverted": True}), samples)
    inputs.add(stream, message)
    assert samples.heard == [(stream, -READ[f"{stream}.axis"][3])]


@pytest.mark.parametrize("name", READ)
def test_parameter_says_what_of_a_message_counts(name):
    value, stream, message, usual, expected = READ[name]
    for parameters, number in (({}, usual), ({name: value}, expected)):
        samples = Samples()
        inputs = Inputs(check(parameters), samples)
        inputs.add(stream, message)
        assert samples.heard == [(stream, number)]


LIVER = Tissue(520.0, 8.4, 0.131)
HOLD = RampHold(0.3, 0.25, 0.5, 1.0)
GEOMETRY = Geometry("flat_punch", area_m2=1e-4, thickness_m=0.02)
#: Of every row: the prior of the tissue that is pressed, and a probe of stated sizes.
BASE: dict[str, Any] = LIVER_PARAMETERS | {
    "estimate.period": 0.02,
    "geometry.area": GEOMETRY.area_m2,
    "geometry.thickness": GEOMETRY.thickness_m,
}
APPROACH = Approach(distance_m=0.004, speed_m_per_s=0.01, start_pause_s=1.0)


#: At 200 Hz each; what differs from the plain one.
RECORDINGS: dict[str, dict[str, Any]] = {
    "plain": {},
    "silent": {"force": ForceSensor(200.0)},
    "late": {"displacement": DisplacementSensor(200.0, delay_s=0.02)},
    "yielding": {"disturbances": Disturbances(compliance_m_per_n=2e-3)},
    "gap": {"dropouts": (Dropout("displacement", 2.0, 0.15),)},
}


@functools.cache
def recording(name: str) -> Recording:
    plain = Scenario(
        name=name,
        seed=3,
        geometry=GEOMETRY,
        sites=(Site(LIVER, (HOLD,)),),
        approach=APPROACH,
        force=ForceSensor(200.0, noise_n=2e-4),
        displacement=DisplacementSensor(200.0, noise_m=1e-6),
    )
    return simulate(replace(plain, **RECORDINGS[name]))


class Heard:
    """What a pipeline made of a recording."""

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        made = recording(name)
        message = made.truth["identifier_parameters"]["displacement.message"]
        parameters = BASE | {"displacement.message": message} | values
        pipeline, self.outputs = through(made, parameters)
        self.rejected = pipeline.rejected
        self.summaries = self._of(ContactSummary)
        states = self._of(TissueState)
        self.pressing = [s for s in states if s.estimate is not None and s.signals is not None]
        self.in_air = sum(state.status is Status.NO_CONTACT for state in states)
        self.converged = sum(state.status is Status.CONVERGED for state in states)
        #: The first estimate in contact, and that of the last summary.
        self.first = self.pressing[0].estimate if self.pressing else None
        self.last = self.summaries[-1].estimate if self.summaries else None

    def _of(self, kind: type) -> list[Any]:
        return [output for output in self.outputs if isinstance(output, kind)]


@functools.cache
def heard(name: str, values: tuple[tuple[str, Any], ...]) -> Heard:
    return Heard(name, {key: list(v) if isinstance(v, tuple) else v for key, v in values})


Check = Callable[[Heard, Heard], bool]


def near(value: float, rel: float = 0.01, **options: Any) -> Any:
    return pytest.approx(value, rel=rel, **options)


def wider(usual: Heard, changed: Heard) -> bool:
    """Whether a deviation of ln G, ln Gn or alpha is larger, in the mean over the press."""
    before, after = (
        np.mean([state.estimate.deviations for state in one.pressing], axis=0)
        for one in (usual, changed)
    )
    return bool(np.any(after > 1.01 * before))


def closer(usual: Heard, changed: Heard) -> bool:
    """Whether ln G at the end is; it is infinitely far where there is none."""
    off = [abs(math.log(one.last.linear_stiffness / 520.0)) if one.last else math.inf
           for one in (usual, changed)]  # fmt: skip
    return off[1] < off[0]


def rejected(reason: str) -> Check:
    return lambda usual, changed: changed.rejected[reason] > 10


RIGID = EXACT | {"converged.log_gn_sd": 0.1}


def ends_with_alpha(value: float) -> Check:
    return lambda a, b: b.last.fractional_order == near(value, 1e-6) != a.last.fractional_order


GIVEN = {"alpha.learn": False}
#: It takes a sixth of the time of the grid.
PAPER = {"estimator.kind": "ekf"}

#: Recording, other parameters, the value, and what it does to what comes out (usual, changed).
Effect = tuple[str, dict[str, Any], Any, Check]
EFFECTS: dict[str, Effect] = {
    "force.noise": ("plain", RIGID, 6e-4, wider),
    "force.noise_floor": ("silent", RIGID, 1e-3, wider),
    "force.drift_sd": ("plain", RIGID, 0.05, wider),
    "force.friction_sd": ("plain", RIGID, 0.005, wider),
    "force.limit": ("plain", PAPER, 0.01, rejected("force.out_of_range")),
    "displacement.delay": ("late", RIGID, 0.02, closer),
    "displacement.compliance": ("yielding", RIGID, 2e-3, closer),
    "displacement.compliance_sd": ("plain", RIGID, 0.1, wider),
    "displacement.delay_sd": ("plain", RIGID, 0.01, wider),
    "surface.motion_sd": ("plain", RIGID, 1e-3, wider),
    "synchronize.max_wait": (
        "gap",
        PAPER | {"synchronize.max_gap": 0.3},
        0.05,
        lambda a, b: b.rejected.total() > a.rejected.total(),
    ),
    "geometry.thickness_sd": (
        "plain",
        RIGID,
        0.2,
        lambda a, b: np.allclose(
            b.last.covariance[:2, :2], a.last.covariance[:2, :2] + 0.04, 0.01
        ),
    ),
    "origin.source": (
        "plain",
        {"origin.displacement": -0.002},
        "given",
        lambda a, b: (
            b.summaries[-1].max_strain == near(a.summaries[-1].max_strain + 0.1, abs=0.02)
        ),
    ),
    "prior.nonlinear_stiffness": (
        "plain",
        {},
        5.0,
        lambda a, b: b.first.nonlinear_stiffness == near(5.0, 0.05),
    ),
    "prior.nonlinear_stiffness_log_sd": (
        "plain",
        RIGID,
        0.05,
        lambda a, b: b.first.deviations[1] == near(0.05, 0.05),
    ),
    "prior.alpha": ("plain", GIVEN, 0.2, ends_with_alpha(0.2)),
    "prior.alpha_sd": (
        "plain",
        GIVEN,
        0.02,
        # The nodes reach 3 deviations.
        lambda a, b: b.last.deviations[2] == near(0.02),
    ),
    "converged.log_gn_sd": ("plain", RIGID, 0.001, lambda a, b: b.converged == 0 < a.converged),
    "estimate.period": ("plain", PAPER, 0.04, lambda a, b: a.in_air == near(2 * b.in_air, 0.1)),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_parameter_does_what_it_says(name):
    which, others, value, holds = EFFECTS[name]
    usual = heard(which, tuple(others.items()))
    changed = heard(which, (*others.items(), (name, value)))
    assert holds(usual, changed)
