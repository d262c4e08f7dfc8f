# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one table of parameters, as dataclasses: a field is a parameter, its group a class.

``force.axis`` of a parameter file is ``parameters.force.axis`` here. To add a parameter, add a
field: declaration, check, parameter file and documentation follow from it.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from fden_ros.errors import InputError
from fden_ros.parameters.parameter import (
    TINY,
    Parameter,
    Value,
    flag,
    number,
    text,
)


@dataclass(frozen=True)
class ForceParameters:
    """The force: where it is in its messages, and how noisy it is."""

    axis: tuple[float, float, float] = number(
        (0.0, 0.0, 1.0),
        "1",
        "Direction in the wrench's frame in which the measured force grows when the probe "
        "presses.",
    )
    message: str = text(
        "wrench",
        "Type of the live force topic; a bag says its own.",
        choices=("wrench", "joint_state"),
    )
    inverted: bool = flag(
        False,
        "true where a joint's effort falls as the probe presses.",
    )
    name: str = text(
        "",
        "Joint whose effort is the force; empty: the first.",
    )
    threshold: float = number(
        0.0,
        "N",
        "Force above its bias that is a contact; 0: what means over 1 to 16 chunks of the air "
        "exceed with a probability of 5e-6.",
        0.0,
        1000.0,
    )
    noise: float = number(
        0.0,
        "N",
        "Standard deviation of the force's noise per sample; 0: measured in the air before each "
        "contact.",
        0.0,
        1000.0,
    )
    noise_floor: float = number(
        1e-05,
        "N",
        "Least noise that is believed, so that a quantised signal does not look perfect.",
        TINY,
        1000.0,
    )
    measure_bias: bool = flag(
        True,
        "Measure the force's bias in the air before each contact; false: it is 0 after any tare.",
    )
    drift_sd: float = number(
        0.005,
        "N",
        "Standard deviation of the drift of the force's zero in one second of contact; 0: none.",
        0.0,
        1000.0,
    )
    learn_drift: bool = flag(
        True,
        "Learn from site to site how far the zero drifts: from a quarter of force.drift_sd to "
        "four times.",
    )
    friction: float = number(
        0.0,
        "N",
        "Friction against the motion of the probe; counts where force.friction_sd is not 0.",
        -1000.0,
        1000.0,
    )
    friction_sd: float = number(
        0.007,
        "N",
        "Standard deviation of the friction that force.friction leaves; 0: none.",
        0.0,
        1000.0,
    )
    limit: float = number(
        100000.0,
        "N",
        "Forces of larger magnitude are rejected.",
        TINY,
        1000000000.0,
    )


@dataclass(frozen=True)
class DisplacementParameters:
    """The displacement: where it is in its messages, and how it is related to the force."""

    axis: tuple[float, float, float] = number(
        (0.0, 0.0, 1.0),
        "1",
        "Direction into the tissue, in the frame of the positions or, with along_tool, in the "
        "probe's own.",
    )
    along_tool: bool = flag(
        False,
        "displacement.axis and force.axis are fixed in the tool and turn with it.",
    )
    message: str = text(
        "joint_state",
        "Type of the live displacement topic; a bag says its own. tf: the motion of frames.probe "
        "in frames.base.",
        choices=("joint_state", "pose", "transform", "point", "tf"),
    )
    name: str = text(
        "",
        "Joint whose position is the displacement; empty: the first.",
    )
    inverted: bool = flag(
        False,
        "true where a joint's position falls as the probe goes into the tissue.",
    )
    delay: float = number(
        0.0,
        "s",
        "How much later than the force the displacement is stamped for the same instant.",
        -10.0,
        10.0,
    )
    limit: float = number(
        10.0,
        "m",
        "Displacements of larger magnitude are rejected.",
        TINY,
        1000000000.0,
    )
    compliance: float = number(
        0.0,
        "m/N",
        "Compliance of tool and robot in series with the tissue; taken off the displacement.",
        0.0,
        1.0,
    )
    compliance_sd: float = number(
        0.0002,
        "m/N",
        "Standard deviation of the compliance that displacement.compliance leaves; 0: none.",
        0.0,
        1.0,
    )
    delay_sd: float = number(
        0.0025,
        "s",
        "Standard deviation of the delay that displacement.delay leaves; 0: none. Above 0.01 each "
        "press learns it, and nothing is claimed before it is known.",
        0.0,
        0.1,
    )


@dataclass(frozen=True)
class SurfaceParameters:
    """The tissue's surface where nobody touches it: measured, or how much it may move."""

    message: str = text(
        "none",
        "Type of the topic surface, whose place is taken off the displacement; a bag says its "
        "own. none: it is not measured.",
        choices=("none", "joint_state", "pose", "transform", "point"),
    )
    axis: tuple[float, float, float] = number(
        (0.0, 0.0, 0.0),
        "1",
        "Direction into the tissue, in the frame of the surface's positions; zeros: "
        "displacement.axis.",
        may_be_zero=True,
    )
    normal: tuple[float, float, float] = number(
        (0.0, 0.0, 0.0),
        "1",
        "Direction into the tissue, perpendicular to its surface, in the frame of the poses or "
        "frames.base; zeros: the probe stands upright.",
        may_be_zero=True,
    )
    name: str = text(
        "",
        "Joint whose position is the surface's place; empty: the first.",
    )
    scale: float = number(
        1.0,
        "1",
        "Motion of the surface into the tissue in m per unit of its reading.",
        -1000.0,
        1000.0,
    )
    delay: float = number(
        0.0,
        "s",
        "How much later than the force the surface is stamped for the same instant.",
        -10.0,
        10.0,
    )

    motion_sd: float = number(
        0.00012,
        "m",
        "Standard deviation of its motion in one second that is not measured, as by breathing; "
        "0: it rests.",
        0.0,
        0.1,
    )
    learn_motion: bool = flag(
        True,
        "Learn from site to site how little it moves: down to a quarter of surface.motion_sd.",
    )


@dataclass(frozen=True)
class FramesParameters:
    """Frames that move, by /tf and /tf_static, where force or displacement are given in them."""

    base: str = text(
        "",
        "Frame of force.axis, into which forces are turned by the transforms at their stamps; "
        "empty: no transform is used.",
    )
    probe: str = text(
        "",
        "Frame of the probe's tip, whose motion is the displacement where displacement.message "
        "is tf; also of forces without a frame.",
    )


@dataclass(frozen=True)
class RigParameters:
    """What is learned of the robot that holds the probe."""

    learn: bool = flag(
        False,
        "Learn delay and friction from contact to contact; false: each begins with what is "
        "stated.",
    )


@dataclass(frozen=True)
class ModelErrorParameters:
    """How far tissue is from the FDEN law."""

    sd: float = number(
        0.2,
        "1",
        "Relative standard deviation of the stress-strain curve from the law over a factor e of "
        "stress; the relaxation's is a quarter of it. 0: the law is exact.",
        0.0,
        1.0,
    )


@dataclass(frozen=True)
class ToolParameters:
    """The tool that the force sensor carries, where it turns."""

    mass: float = number(
        0.0,
        "kg",
        "Mass that the force sensor carries, where the tool turns: its weight is taken off the "
        "force, by the orientation of the displacement's pose or transform.",
        0.0,
        1000.0,
    )
    centre_of_mass: tuple[float, float, float] = number(
        (0.0, 0.0, 0.0),
        "m",
        "Its centre in the sensor's frame; counts for a torque.",
        may_be_zero=True,
    )
    gravity: tuple[float, float, float] = number(
        (0.0, 0.0, -9.80665),
        "m/s^2",
        "Gravity in the frame of the poses, for a sensor that measures what acts on the tool; "
        "else the other way round.",
    )


@dataclass(frozen=True)
class SynchronizeParameters:
    """How the samples of the two streams find each other."""

    max_gap: float = number(
        0.25,
        "s",
        "Displacement samples further apart, and than 2 usual steps of the force, are not "
        "interpolated between; a longer gap ends a contact.",
        0.0001,
        10.0,
    )
    window: float = number(
        5.0,
        "s",
        "How long a sample waits, in stamps, for the other stream; or 4 usual steps of its own.",
        0.01,
        60.0,
    )
    stamp_source: str = text(
        "header",
        "Whose time a sample has: its message's header, or its receipt (of a bag: its recording), "
        "which jitters: for drivers that stamp with 0, or by two clocks.",
        choices=("header", "receive"),
    )


@dataclass(frozen=True)
class GeometryParameters:
    """How force and displacement become stress and strain."""

    kind: str = text(
        "flat_punch",
        "How force and displacement become stress and strain.",
        choices=("flat_punch", "sphere", "torsional_rheometer", "pass_through"),
    )
    area: float = number(
        0.0,
        "m^2",
        "flat_punch: area of the probe's face; 0: not stated, so nothing is converged.",
        TINY,
        1.0,
        may_be_zero=True,
    )
    thickness: float = number(
        0.0,
        "m",
        "flat_punch, sphere: thickness of the tissue on its rigid base; torsional_rheometer: "
        "height of the sample; 0: not stated, under a sphere then thick.",
        1e-09,
        1.0,
        may_be_zero=True,
    )
    radius: float = number(
        0.0,
        "m",
        "sphere: radius of the tip; torsional_rheometer: radius of the sample; 0: not stated.",
        1e-09,
        1.0,
        may_be_zero=True,
    )
    hayes: bool = flag(
        False,
        "flat_punch: divide by Hayes' factor, for a probe smaller than the tissue around it.",
    )
    bonded: bool = flag(
        True,
        "The base holds the tissue; false: the tissue slips on it. Counts with hayes, and under a "
        "sphere with a thickness.",
    )
    thickness_sd: float = number(
        0.02,
        "1",
        "Relative standard deviation of the thickness, or of a sphere's radius; 0: exact.",
        0.0,
        1.0,
    )
    poisson_ratio: float = number(
        0.5,
        "1",
        "Poisson's ratio of a layer that its base holds: with hayes, or under a sphere with a "
        "thickness.",
        0.0,
        0.5,
    )


@dataclass(frozen=True)
class PlausibleParameters:
    """What a contact cannot exceed where the units are right."""

    force: float = number(
        200.0,
        "N",
        "flat_punch, sphere: a contact of more force is implausible, and never converged.",
        TINY,
        1000000000.0,
    )
    strain_rate: float = number(
        0.001,
        "1/s",
        "A press strained slower than this and sampled slower than 2 Hz is implausible; 0: any "
        "is plausible.",
        0.0,
        1.0,
    )


@dataclass(frozen=True)
class OriginParameters:
    """Where the strain is zero."""

    source: str = text(
        "touch",
        "Strain origin: found from the force at the touch and refined, or given as a "
        "displacement.",
        choices=("touch", "given"),
    )
    displacement: float = number(
        0.0,
        "m",
        "Displacement at zero strain where it is given.",
        -10.0,
        10.0,
    )


@dataclass(frozen=True)
class ContactParameters:
    """How a contact is detected."""

    mode: str = text(
        "touch",
        "touch: contacts begin in the air, with G and Gn; continuous: the probe stays on the "
        "tissue and palpates, and dF/dd along its path is found.",
        choices=("touch", "continuous"),
    )
    lookback: float = number(
        5.0,
        "s",
        "How far before its detection the onset of a contact is looked for; or 24 times 3 "
        "samples, where those last longer.",
        0.1,
        60.0,
    )


@dataclass(frozen=True)
class SiteParameters:
    """When a touch is a new site."""

    distance: float = number(
        0.0,
        "m",
        "A touch further to the side is a new site, where positions are known; 0: a fifth of the "
        "probe's radius, 0.5 to 2 mm.",
        0.0,
        1.0,
    )
    timeout: float = number(
        2.0,
        "s",
        "Without positions, a touch after a longer time in the air is a new site, and is followed "
        "as the place of the last one too, until the data say which.",
        0.0,
        100000.0,
    )


@dataclass(frozen=True)
class AlphaParameters:
    """Whether the order alpha is learned."""

    learn: bool = flag(
        True,
        "Learn alpha together with G and Gn; false: it is prior.alpha, and counts with "
        "prior.alpha_sd.",
    )


@dataclass(frozen=True)
class EstimatorParameters:
    """What the filter observes."""

    observation: str = text(
        "stress",
        "What is observed: the stress, or the fractional stress, the paper's way, which does not "
        "learn alpha.",
        choices=("stress", "fractional_stress"),
    )


@dataclass(frozen=True)
class PriorParameters:
    """The tissue before the touch, by default what soft tissue can be."""

    linear_stiffness: float = number(
        3200.0,
        "Pa s^alpha",
        "Median of G before the touch.",
        0.001,
        1000000000.0,
    )
    linear_stiffness_log_sd: float = number(
        2.9,
        "1",
        "Standard deviation of ln G.",
        0.001,
        5.0,
    )
    nonlinear_stiffness: float = number(
        6.3,
        "1",
        "Median of Gn before the touch.",
        0.1,
        100.0,
    )
    nonlinear_stiffness_log_sd: float = number(
        0.92,
        "1",
        "Standard deviation of ln Gn.",
        0.01,
        2.0,
    )
    alpha: float = number(
        0.31,
        "1",
        "Median of alpha before the touch, or alpha itself where alpha.learn is false; "
        "0: a spring.",
        0.0,
        0.6,
    )
    alpha_sd: float = number(
        0.145,
        "1",
        "Standard deviation of alpha.",
        0.0,
        0.3,
    )


@dataclass(frozen=True)
class ConvergedParameters:
    """When each parameter of an estimate has converged; the status says so of G and Gn both."""

    log_sd: float = number(
        0.1,
        "1",
        "Gn has converged only while the standard deviation of ln Gn is below this.",
        0.0001,
        1.0,
    )
    linear_log_sd: float = number(
        0.5,
        "1",
        "G has converged only while the standard deviation of ln G is below this.",
        0.0001,
        5.0,
    )
    alpha_sd: float = number(
        0.05,
        "1",
        "alpha has converged only while its standard deviation is below this.",
        0.0001,
        1.0,
    )
    probability: float = number(
        0.99,
        "1",
        "Gn is observable only while the strain has passed 1/Gn with this probability.",
        0.5,
        1.0,
    )


@dataclass(frozen=True)
class EstimateParameters:
    """How often there is an estimate, and on which time scale its stiffness is."""

    period: float = number(
        0.01,
        "s",
        "One estimate per this time.",
        0.001,
        1.0,
    )
    time_scale: float = number(
        0.1,
        "s",
        "Time scale tau of the apparent stiffness.",
        0.0001,
        10000.0,
    )


@dataclass(frozen=True)
class DitherParameters:
    """A small oscillation of the probe at which the complex modulus is measured."""

    frequencies: tuple[float, ...] = number(
        (0.0,),
        "Hz",
        "Frequencies of a small oscillation of the probe at which the complex modulus is "
        "measured; 0: there is none.",
        0.0,
        1000.0,
        most=8,
    )
    periods: int = number(
        4,
        "1",
        "One complex modulus per this number of periods of the lowest frequency.",
        1,
        1000,
    )


@dataclass(frozen=True)
class ClassifierParameters:
    """The tissues that are told apart."""

    library: str = text(
        "",
        "Path of a tissue library (YAML); empty: the built-in one.",
    )


@dataclass(frozen=True)
class ClassificationParameters:
    """How a class is decided on."""

    mode: str = text(
        "library",
        "Tell the tissues of the library apart, or how much stiffer each site is than earlier "
        "ones around it.",
        choices=("library", "relative"),
    )
    probability: float = number(
        0.7,
        "1",
        "A class is named when its probability is at least this.",
        0.34,
        1.0,
    )
    release: float = number(
        0.5,
        "1",
        "It stays named while its probability is at least this.",
        0.0,
        1.0,
    )
    dwell: float = number(
        0.2,
        "s",
        "How long another answer must stand before it replaces the one that is named.",
        0.0,
        60.0,
    )
    significance: float = number(
        0.06,
        "1",
        "library: unknown where less than this part of the contacts with the best fitting tissue "
        "lies as far from it.",
        0.0,
        0.5,
    )
    ratio: float = number(
        1.5,
        "1",
        "relative: stiffer, or softer, by this.",
        1.0,
        1000.0,
    )
    strain: float = number(
        0.1,
        "1",
        "relative: strain of the comparison.",
        0.0,
        2.0,
    )
    distance: float = number(
        0.0,
        "m",
        "relative: surroundings are sites within this distance; 0: all.",
        0.0,
        10.0,
    )


@dataclass(frozen=True)
class Parameters:
    """All parameters of the identifier; made by :func:`check`."""

    force: ForceParameters = ForceParameters()
    displacement: DisplacementParameters = DisplacementParameters()
    surface: SurfaceParameters = SurfaceParameters()
    frames: FramesParameters = FramesParameters()
    rig: RigParameters = RigParameters()
    model_error: ModelErrorParameters = ModelErrorParameters()
    tool: ToolParameters = ToolParameters()
    synchronize: SynchronizeParameters = SynchronizeParameters()
    geometry: GeometryParameters = GeometryParameters()
    plausible: PlausibleParameters = PlausibleParameters()
    origin: OriginParameters = OriginParameters()
    contact: ContactParameters = ContactParameters()
    site: SiteParameters = SiteParameters()
    alpha: AlphaParameters = AlphaParameters()
    estimator: EstimatorParameters = EstimatorParameters()
    prior: PriorParameters = PriorParameters()
    converged: ConvergedParameters = ConvergedParameters()
    estimate: EstimateParameters = EstimateParameters()
    dither: DitherParameters = DitherParameters()
    classifier: ClassifierParameters = ClassifierParameters()
    classification: ClassificationParameters = ClassificationParameters()

    def as_dict(self) -> dict[str, Value]:
        """Return every value by the parameter's name, lists as a parameter file has them."""
        return {name: _plain(value) for name, _, value in _leaves(self)}

    def changed(self, values: Mapping[str, object]) -> Parameters:
        """Return these parameters with others in place of some.

        Raises
        ------
        InputError
            As :func:`check`.
        """
        return check({**self.as_dict(), **values})


def _leaves(parameters: Parameters) -> Iterator[tuple[str, dataclasses.Field[Any], Any]]:
    for group in dataclasses.fields(parameters):
        values = getattr(parameters, group.name)
        for leaf in dataclasses.fields(values):
            yield f"{group.name}.{leaf.name}", leaf, getattr(values, leaf.name)


def _plain(value: Any) -> Value:
    return list(value) if isinstance(value, tuple) else value


PARAMETERS: tuple[Parameter, ...] = tuple(
    Parameter(name, _plain(value), **leaf.metadata) for name, leaf, value in _leaves(Parameters())
)

_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}

#: What a replay says, too, which reads no parameters of the node alone.
DEFAULT_HARDWARE_ID = "force_sensor"

#: Parameters of the node alone, or of every node: not the identification's, in the same file.
NODE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "autostart",
        False,
        "1",
        "Configure and activate at start-up, without a lifecycle manager.",
    ),
    Parameter(
        "stale_timeout",
        0.5,
        "s",
        "Time without a usable pair of samples after which the estimate is stale.",
        0.01,
        60.0,
    ),
    Parameter(
        "lag_deadline",
        0.1,
        "s",
        "Time from the receipt of a sample to its estimate after which the estimate is late.",
        0.01,
        60.0,
    ),
    Parameter(
        "hardware_id",
        DEFAULT_HARDWARE_ID,
        "1",
        "What /diagnostics says it is about, such as the serial number of the force sensor.",
    ),
    Parameter("use_sim_time", False, "1", "Take the time from the topic /clock."),
    Parameter("start_type_description_service", True, "1", "Offer the type description service."),
)
_NODE_BY_NAME = {parameter.name: parameter for parameter in NODE_PARAMETERS}

#: Names of before, and what stands in their place.
_RENAMED = {
    "alpha.source": "alpha.learn: true for prior, false for given",
    "alpha.value": "prior.alpha, with alpha.learn: false",
    "alpha.sd": "prior.alpha_sd, with alpha.learn: false",
}


def check(values: Mapping[str, object]) -> Parameters:
    """Return all parameters: `values` checked, the others at their defaults.

    Raises
    ------
    InputError
        If a name is unknown or a value not allowed.
    """
    defaults = Parameters()
    groups: dict[str, dict[str, Any]] = {group.name: {} for group in dataclasses.fields(defaults)}
    for name, value in values.items():
        checked = parameter_named(name).check(value)
        group, _, leaf = name.partition(".")
        groups[group][leaf] = tuple(checked) if isinstance(checked, list) else checked
    return Parameters(
        **{
            name: dataclasses.replace(getattr(defaults, name), **given)
            for name, given in groups.items()
        }
    )


def parameter_named(name: str) -> Parameter:
    """Return the parameter of a name.

    Raises
    ------
    InputError
        If there is none; the line names the new name of an old one, or the nearest.
    """
    if name in _BY_NAME:
        return _BY_NAME[name]
    if name in _RENAMED:
        raise InputError(f"there is no parameter {name} any more: use {_RENAMED[name]}")
    near = difflib.get_close_matches(name, [*_BY_NAME, *_NODE_BY_NAME], n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise InputError(f"there is no parameter {name}{hint}")


def node_parameter_named(name: str) -> Parameter | None:
    """Return the parameter of the node alone; None where there is none of this name."""
    return _NODE_BY_NAME.get(name)
