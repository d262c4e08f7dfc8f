# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What each parameter does to what comes out, on recordings of one press or a few.

Those of messages, tools and labels are in test_parameters.py, which says where a row is missing.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pipeline_helpers import LIVER_PARAMETERS

from fden_ros.core import (
    Classification,
    ContactSummary,
    DynamicModulus,
    Pipeline,
    Status,
    TissueState,
)
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.disturbance import Disturbances, SurfaceMotion
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    Dropout,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    SurfaceSensor,
    Tissue,
)
from fden_ros.simulation.simulate import Recording, simulate
from fden_ros.simulation.trajectory import Approach, Ramp, RampHold, Sinusoid

LIVER = Tissue(520.0, 8.4, 0.131)
HOLD = RampHold(0.3, 0.25, 0.5, 1.0)
GEOMETRY = Geometry("flat_punch", area_m2=1e-4, thickness_m=0.02)
#: Of every row: the prior of the tissue that is pressed, and a probe of stated sizes.
BASE: dict[str, Any] = LIVER_PARAMETERS | {
    "estimate.period": 0.02,
    "geometry.area": GEOMETRY.area_m2,
    "geometry.thickness": GEOMETRY.thickness_m,
    "geometry.radius": 0.005,
}


@functools.cache
def recording(name: str) -> Recording:
    """Return a recording at 200 Hz."""
    sites: tuple[Site, ...] = (Site(LIVER, (HOLD,)),)
    force, moved = ForceSensor(200.0, noise_n=2e-4), DisplacementSensor(200.0, noise_m=1e-6)
    distance, pause, disturbances = 0.004, 1.0, Disturbances()
    dropouts: tuple[Dropout, ...] = ()
    surface: SurfaceSensor | None = None
    if name == "silent":
        force = ForceSensor(200.0)
    elif name == "biased":
        force = ForceSensor(200.0, noise_n=2e-4, bias_n=5e-4)
    elif name == "late":
        moved = DisplacementSensor(200.0, delay_s=0.02)
    elif name == "yielding":
        disturbances = Disturbances(compliance_m_per_n=2e-3)
    elif name == "breathing":
        disturbances = Disturbances(breathing=SurfaceMotion(1e-3))
        surface = SurfaceSensor(100.0, noise_m=1e-6, message="joint_state")
    elif name == "gap":
        dropouts = (Dropout("displacement", 2.0, 0.15),)
    elif name == "slow":
        sites = (Site(LIVER, (Ramp(0.03, 0.12, 1.0),)),)
        force, pause = ForceSensor(200.0, noise_n=5e-4), 8.0
    elif name == "dithered":
        sites = (Site(LIVER, (Sinusoid(0.3, 0.2, 0.01, 2.0, 12, 0.3),)),)
    elif name == "palpated":
        sites = (Site(LIVER, (Sinusoid(0.3, 0.2, 0.04, 2.0, 30, 0.3),)),)
    elif name in ("apart", "again"):
        places = [0.008 * number * (name == "apart") for number in range(2)]
        sites = tuple(Site(LIVER, (HOLD,), (place, 0.0)) for place in places)
        if name == "apart":
            moved = DisplacementSensor(200.0, noise_m=1e-6, message="point")
    elif name == "row":
        stiff = Tissue(520.0 * 1.8, 8.4, 0.131)
        tissues = [LIVER] * 5 + [stiff]
        sites = tuple(Site(one, (HOLD,), (0.01 * n, 0.0)) for n, one in enumerate(tissues))
        moved = DisplacementSensor(200.0, noise_m=1e-6, message="point")
    return simulate(
        Scenario(
            name=name,
            seed=3,
            geometry=GEOMETRY,
            sites=sites,
            approach=Approach(distance_m=distance, speed_m_per_s=0.01, start_pause_s=pause),
            force=force,
            displacement=moved,
            disturbances=disturbances,
            dropouts=dropouts,
            surface=surface,
        )
    )


class Heard:
    """What a pipeline made of a recording."""

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        made = recording(name)
        message = made.truth["identifier_parameters"]["displacement.message"]
        self.outputs: list[Any] = []
        pipeline = Pipeline(
            pipeline_config(check(BASE | {"displacement.message": message} | values)),
            self.outputs.append,
        )
        places: list[Any] = [None] * made.displacement.value.size
        if made.displacement.position is not None:
            places = [tuple(place) for place in made.displacement.position.tolist()]
        moved = zip(
            made.displacement.stamp_ns.tolist(),
            made.displacement.value.tolist(),
            places,
            strict=True,
        )
        events = [(stamp, 0, sample) for stamp, *sample in moved]
        events += [
            (stamp, 1, [value])
            for stamp, value in zip(
                made.force.stamp_ns.tolist(), made.force.value.tolist(), strict=True
            )
        ]
        if made.surface is not None:
            for stamp, value in zip(
                made.surface.stamp_ns.tolist(), made.surface.value.tolist(), strict=True
            ):
                # Before all others: the recording is shorter than the window.
                pipeline.add_surface(stamp, value)
        for stamp, is_force, sample in sorted(events, key=lambda event: event[:2]):
            if is_force:
                pipeline.add_force(stamp, *sample)
            else:
                pipeline.add_displacement(stamp, *sample)
        pipeline.finish()
        self.rejected = pipeline.rejected

    def _of(self, kind: type) -> list[Any]:
        return [output for output in self.outputs if isinstance(output, kind)]

    @property
    def states(self) -> list[Any]:
        """States with an estimate."""
        return [state for state in self._of(TissueState) if state.estimate is not None]

    @property
    def pressing(self) -> list[Any]:
        """States in contact with an estimate."""
        return [state for state in self.states if state.signals is not None]

    @property
    def innovation(self) -> Any:
        """The last innovation."""
        return [state.innovation for state in self.states if state.innovation is not None][-1]

    @property
    def summary(self) -> Any:
        """The last summary."""
        return self._of(ContactSummary)[-1]

    @property
    def summaries(self) -> list[Any]:
        """All summaries."""
        return self._of(ContactSummary)

    @property
    def labels(self) -> list[Any]:
        """All classifications with a label."""
        found = self._of(Classification)
        return [one for one in found if one.classes is not None and one.classes.label]

    @property
    def moduli(self) -> list[Any]:
        """All complex moduli."""
        return self._of(DynamicModulus)

    @property
    def sd(self) -> float:
        """Deviation of ln G at the end."""
        return float(self.summary.estimate.deviations[0])

    @property
    def in_air(self) -> int:
        """How many states are in the air."""
        return sum(state.status is Status.NO_CONTACT for state in self._of(TissueState))

    @property
    def converged(self) -> int:
        """How many states are converged."""
        return sum(state.status is Status.CONVERGED for state in self.states)


@functools.cache
def heard(name: str, values: tuple[tuple[str, Any], ...]) -> Heard:
    return Heard(name, {key: list(v) if isinstance(v, tuple) else v for key, v in values})


def truth_error(of: Heard) -> float:
    return abs(float(of.summary.estimate.mean[0]) - np.log(520.0))


def wider(usual: Heard, changed: Heard) -> bool:
    """Whether the deviation of ln G is larger, in the mean over the press."""
    before, after = (
        np.mean([state.estimate.deviations[0] for state in one.pressing])
        for one in (usual, changed)
    )
    return bool(after > 1.01 * before)


RIGID = {
    name: 0.0
    for name in (
        "force.drift_sd",
        "force.friction_sd",
        "surface.motion_sd",
        "displacement.compliance_sd",
        "displacement.delay_sd",
        "geometry.thickness_sd",
        "model_error.sd",
    )
}
RELATIVE = RIGID | {"classification.mode": "relative"}

#: Recording, other parameters, the value, and what it does to what comes out (usual, changed).
Effect = tuple[str, dict[str, Any], Any, Callable[[Heard, Heard], bool]]
EFFECTS: dict[str, Effect] = {
    "force.threshold": (
        "plain",
        {},
        0.01,
        lambda a, b: b.states[0].stamp_ns > a.states[0].stamp_ns,
    ),
    "force.noise": ("plain", RIGID, 6e-4, wider),
    "force.noise_floor": ("silent", RIGID, 1e-3, wider),
    "force.measure_bias": (
        "biased",
        {},
        False,
        lambda a, b: b.summary.max_force == pytest.approx(a.summary.max_force + 5e-4, abs=1e-4),
    ),
    "force.drift_sd": ("plain", RIGID, 0.05, wider),
    "force.friction_sd": ("plain", RIGID, 0.005, wider),
    "force.limit": ("plain", {}, 0.01, lambda a, b: b.rejected["force.out_of_range"] > 10),
    "displacement.delay": ("late", RIGID, 0.02, lambda a, b: truth_error(b) < truth_error(a)),
    "displacement.limit": (
        "plain",
        {},
        0.001,
        lambda a, b: b.rejected["displacement.out_of_range"] > 10,
    ),
    "displacement.compliance": (
        "yielding",
        RIGID,
        2e-3,
        lambda a, b: truth_error(b) < truth_error(a),
    ),
    "displacement.compliance_sd": ("plain", RIGID, 0.1, wider),
    "displacement.delay_sd": ("plain", RIGID, 0.1, wider),
    "surface.motion_sd": ("plain", RIGID, 1e-3, wider),
    "surface.message": (
        "breathing",
        RIGID,
        "joint_state",
        lambda a, b: truth_error(b) < 0.2 * truth_error(a),
    ),
    "surface.delay": (
        "breathing",
        RIGID | {"surface.message": "joint_state"},
        -0.2,
        lambda a, b: b.summary.estimate.deviations[0] > 2.0 * a.summary.estimate.deviations[0],
    ),
    "model_error.sd": (
        "plain",
        RIGID,
        0.4,
        lambda a, b: b.summary.estimate.model_error > 0.0 == a.summary.estimate.model_error,
    ),
    "synchronize.max_gap": (
        "gap",
        {},
        0.1,
        lambda a, b: a.summary.complete and not b.summaries[0].complete,
    ),
    "synchronize.window": (
        "gap",
        {"synchronize.max_gap": 0.3},
        0.05,
        lambda a, b: b.rejected.total() > a.rejected.total(),
    ),
    "geometry.kind": (
        "plain",
        {},
        "sphere",
        lambda a, b: b.summary.max_stress > a.summary.max_stress,
    ),
    "geometry.area": (
        "plain",
        {},
        2e-4,
        lambda a, b: b.summary.max_stress == pytest.approx(0.5 * a.summary.max_stress, rel=0.01),
    ),
    "geometry.thickness": (
        "plain",
        {},
        0.04,
        lambda a, b: b.summary.max_strain == pytest.approx(0.5 * a.summary.max_strain, rel=0.02),
    ),
    "geometry.radius": (
        "plain",
        {"geometry.kind": "sphere"},
        0.01,
        lambda a, b: b.summary.max_stress == pytest.approx(0.25 * a.summary.max_stress, rel=0.01),
    ),
    "geometry.hayes": (
        "plain",
        {},
        True,
        lambda a, b: b.summary.max_stress < a.summary.max_stress,
    ),
    "geometry.poisson_ratio": (
        "plain",
        {"geometry.hayes": True},
        0.3,
        lambda a, b: b.summary.max_stress > a.summary.max_stress,
    ),
    "geometry.thickness_sd": (
        "plain",
        RIGID,
        0.2,
        lambda a, b: b.sd**2 == pytest.approx(a.sd**2 + 0.04, rel=0.01),
    ),
    "origin.source": (
        "plain",
        {"origin.displacement": -0.002},
        "given",
        lambda a, b: b.summary.max_strain == pytest.approx(a.summary.max_strain + 0.1, abs=0.02),
    ),
    "origin.displacement": (
        "plain",
        {"origin.source": "given"},
        -0.002,
        lambda a, b: b.summary.max_strain == pytest.approx(a.summary.max_strain + 0.1, abs=0.02),
    ),
    # What rises more slowly than the baseline is remembered is a drift.
    "contact.lookback": ("slow", {}, 0.3, lambda a, b: len(a.summaries) == 1 and not b.summaries),
    "site.distance": ("apart", {}, 0.02, lambda a, b: [s.site_id for s in b.summaries] == [1, 1]),
    "site.timeout": ("again", {}, 60.0, lambda a, b: [s.site_id for s in b.summaries] == [1, 1]),
    "alpha.learn": (
        "plain",
        {},
        False,
        lambda a, b: (
            b.summary.estimate.fractional_order == pytest.approx(0.131, rel=1e-9)
            and a.summary.estimate.fractional_order != pytest.approx(0.131, rel=1e-3)
        ),
    ),
    "estimator.observation": (
        "plain",
        {},
        "fractional_stress",
        lambda a, b: (
            a.innovation.predicted_stress is not None and b.innovation.predicted_stress is None
        ),
    ),
    "prior.linear_stiffness": (
        "plain",
        {},
        1000.0,
        lambda a, b: (
            b.pressing[0].estimate.linear_stiffness > 1.2 * a.pressing[0].estimate.linear_stiffness
        ),
    ),
    "prior.linear_stiffness_log_sd": (
        "plain",
        {},
        0.01,
        lambda a, b: b.summary.estimate.deviations[0] < 0.021 + 0.01,
    ),
    "prior.nonlinear_stiffness": (
        "plain",
        {},
        5.0,
        lambda a, b: b.pressing[0].estimate.nonlinear_stiffness == pytest.approx(5.0, rel=0.05),
    ),
    "prior.nonlinear_stiffness_log_sd": (
        "plain",
        RIGID,
        0.05,
        lambda a, b: b.pressing[0].estimate.deviations[1] == pytest.approx(0.05, rel=0.05),
    ),
    "prior.alpha": (
        "plain",
        {"alpha.learn": False},
        0.2,
        lambda a, b: b.summary.estimate.fractional_order == pytest.approx(0.2, rel=1e-9),
    ),
    "prior.alpha_sd": (
        "plain",
        {"alpha.learn": False},
        0.05,
        lambda a, b: b.summary.estimate.deviations[2] == pytest.approx(0.05, rel=1e-6),
    ),
    "converged.log_sd": ("plain", RIGID, 0.001, lambda a, b: b.converged == 0 < a.converged),
    "converged.probability": (
        "plain",
        RIGID | {"converged.log_sd": 1.0},
        0.5,
        lambda a, b: b.converged > a.converged,
    ),
    "estimate.period": (
        "plain",
        {},
        0.04,
        lambda a, b: a.in_air == pytest.approx(2 * b.in_air, rel=0.1),
    ),
    "estimate.time_scale": (
        "plain",
        RIGID | {"alpha.learn": False},
        1.0,
        lambda a, b: (
            b.pressing[-1].apparent_stiffness.value
            == pytest.approx(10.0**-0.131 * a.pressing[-1].apparent_stiffness.value, rel=1e-9)
        ),
    ),
    "contact.mode": (
        "palpated",
        {},
        "continuous",
        lambda a, b: a.summary.max_strain > 0.2 and b.summary.is_of_path,
    ),
    "dither.frequencies": (
        "dithered",
        {},
        (2.0,),
        lambda a, b: (
            not a.moduli and b.moduli[-1].modulus.angular_frequency == pytest.approx(4.0 * np.pi)
        ),
    ),
    "dither.periods": (
        "dithered",
        {"dither.frequencies": (2.0,)},
        2,
        lambda a, b: len(b.moduli) >= 2 * len(a.moduli) > 0,
    ),
    "classification.mode": (
        "row",
        RIGID,
        "relative",
        lambda a, b: a.summary.comparison is None and b.summary.comparison is not None,
    ),
    "classification.ratio": (
        "row",
        RELATIVE,
        3.0,
        lambda a, b: (a.summary.classes.label, b.summary.classes.label) == ("stiffer", "alike"),
    ),
    "classification.strain": (
        "row",
        RELATIVE,
        0.3,
        lambda a, b: a.summary.comparison.log_ratio_sd != b.summary.comparison.log_ratio_sd,
    ),
    "classification.distance": (
        "row",
        RELATIVE,
        0.02,
        lambda a, b: b.summary.comparison is None and a.summary.comparison is not None,
    ),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_parameter_does_what_it_says(name: str) -> None:
    which, others, value, holds = EFFECTS[name]
    usual = heard(which, tuple(others.items()))
    changed = heard(which, (*others.items(), (name, value)))
    assert holds(usual, changed)
