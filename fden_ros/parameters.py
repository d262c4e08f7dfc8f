"""The one table of parameters: it drives declaration, checking, parameter files and the README.

The node declares these with descriptor, range and read-only flag; ``fden replay --config`` reads
the same names from the same file. :func:`pipeline_config` turns their values into the core's
configuration.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fden_ros.core.classification.decision import DecisionConfig
from fden_ros.core.classification.relative import RelativeConfig
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import ContactConfig
from fden_ros.core.estimation.estimate import EstimatorConfig, Observation, Prior
from fden_ros.core.law.geometry import FlatPunch, Geometry, PassThrough, Sphere, TorsionalRheometer
from fden_ros.core.streams.synchronize import SynchronizeConfig
from fden_ros.core.streams.tool_weight import ToolWeight
from fden_ros.errors import InputError
from fden_ros.tissues.library import library_for

Value = bool | int | float | str | list[float]


@dataclass(frozen=True)
class Parameter:
    """One parameter of the identifier.

    Parameters
    ----------
    name : str
    default : bool, int, float, str or list of float
        Also fixes the type.
    unit : str
        SI unit, "1" where there is none.
    description : str
    minimum, maximum : float
        Inclusive range of a number.
    choices : tuple of str
        What a text may be; empty: anything.
    most : int
        How many numbers a list may have; 0: it is a vector, of three that are not all 0.
    """

    name: str
    default: Value
    unit: str
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    may_be_zero: bool = False  #: of a vector
    most: int = 0

    @property
    def type_name(self) -> str:
        """Name of the type, as a user would say it."""
        names = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
        count = f"1 to {self.most}" if self.most else "three"
        return names.get(type(self.default), f"a list of {count} numbers")

    @property
    def constraint(self) -> str:
        """What values are allowed, in words; empty if anything of the type is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if isinstance(self.default, list) and not self.most:
            return "three numbers" if self.may_be_zero else "three numbers, not all 0"
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        if low and high:
            each = f"1 to {self.most} numbers, each " if self.most else ""
            return f"{each}{self.minimum:g} to {self.maximum:g}"
        return f"at least {self.minimum:g}" if low else f"at most {self.maximum:g}" if high else ""

    def check(self, value: object) -> Value:
        """Return `value` in the parameter's type.

        Raises
        ------
        InputError
            If it is of another type or not allowed.
        """
        default = self.default
        if isinstance(default, bool) or isinstance(value, bool):
            if isinstance(default, bool) and isinstance(value, bool):
                return value
        elif isinstance(default, str):
            if isinstance(value, str):
                return self._choice(value)
        elif isinstance(default, list):
            if isinstance(value, Sequence) and not isinstance(value, str):
                if self.most and 1 <= len(value) <= self.most:
                    return [float(self._number(v)) for v in value]
                if not self.most and len(value) == 3:
                    return self._vector(value)
        elif isinstance(value, (int, float)) and (
            isinstance(default, float) or isinstance(value, int)
        ):
            return self._number(value)
        raise InputError(f"parameter {self.name} is {value!r}, must be {self.type_name}")

    def _choice(self, value: str) -> str:
        if self.choices and value not in self.choices:
            raise InputError(f"parameter {self.name} is {value!r}, must be {self.constraint}")
        return value

    def _vector(self, value: Sequence[object]) -> list[float]:
        if not all(isinstance(v, (int, float)) and math.isfinite(v) for v in value):
            raise InputError(
                f"parameter {self.name} is {list(value)!r}, must be {self.constraint}"
            )
        vector = [float(v) for v in value]  # type: ignore[arg-type]
        if not any(vector) and not self.may_be_zero:
            raise InputError(f"parameter {self.name} is {vector!r}, must be {self.constraint}")
        return vector

    def _number(self, value: Any) -> int | float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"parameter {self.name} is {value!r}, must be {self.type_name}")
        if not math.isfinite(value) or not self.minimum <= value <= self.maximum:
            raise InputError(f"parameter {self.name} is {value!r}, must be {self.constraint}")
        return value if isinstance(self.default, int) else float(value)


_TINY = 1e-9

PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "force.axis",
        [0.0, 0.0, 1.0],
        "1",
        "Direction in the wrench's frame in which the measured force grows when the probe "
        "presses; normalised.",
    ),
    Parameter(
        "force.message",
        "wrench",
        "1",
        "Type of the live force topic: geometry_msgs/WrenchStamped or sensor_msgs/JointState. "
        "A bag says its own.",
        choices=("wrench", "joint_state"),
    ),
    Parameter(
        "force.inverted",
        False,
        "1",
        "true where a joint's effort falls as the probe presses.",
    ),
    Parameter(
        "force.name",
        "",
        "1",
        "Joint whose effort is the force, where the force topic carries joint states; empty: "
        "the first.",
    ),
    Parameter(
        "force.threshold",
        0.0,
        "N",
        "Force above its bias that is a contact; 0: four standard deviations of the measured "
        "noise.",
        0.0,
        1e3,
    ),
    Parameter(
        "force.noise",
        0.0,
        "N",
        "Standard deviation of the force's noise per sample; 0: measured in the air before "
        "each contact.",
        0.0,
        1e3,
    ),
    Parameter(
        "force.noise_floor",
        1e-5,
        "N",
        "Least noise that is believed, so that a quantised signal does not look perfect.",
        _TINY,
        1e3,
    ),
    Parameter(
        "force.measure_bias",
        True,
        "1",
        "Take the force's bias from each approach through the air; false: trust the force "
        "after any tare.",
    ),
    Parameter("force.limit", 1e5, "N", "Forces of larger magnitude are rejected.", _TINY, 1e9),
    Parameter(
        "displacement.axis",
        [0.0, 0.0, 1.0],
        "1",
        "Direction into the tissue, in the frame of the position messages; normalised.",
    ),
    Parameter(
        "displacement.message",
        "joint_state",
        "1",
        "Type of the live displacement topic: sensor_msgs/JointState, or "
        "geometry_msgs/PoseStamped, "
        "TransformStamped or PointStamped. A bag says its own.",
        choices=("joint_state", "pose", "transform", "point"),
    ),
    Parameter(
        "displacement.name",
        "",
        "1",
        "Joint whose position is the displacement, where its topic carries joint states; "
        "empty: the first.",
    ),
    Parameter(
        "displacement.inverted",
        False,
        "1",
        "true where a joint's position falls as the probe goes into the tissue.",
    ),
    Parameter(
        "displacement.delay",
        0.0,
        "s",
        "How much later than the force the displacement is stamped for the same instant.",
        -10.0,
        10.0,
    ),
    Parameter(
        "displacement.limit",
        10.0,
        "m",
        "Displacements of larger magnitude are rejected.",
        _TINY,
        1e9,
    ),
    Parameter(
        "displacement.compliance",
        0.0,
        "m/N",
        "Compliance of tool and robot in series with the tissue; its share is taken off the "
        "displacement.",
        0.0,
        1.0,
    ),
    Parameter(
        "tool.mass",
        0.0,
        "kg",
        "Mass of all that the force sensor carries, where the tool turns: its weight is taken off "
        "the force, by the orientation in the displacement's pose or transform, which must be the "
        "sensor's; 0: not.",
        0.0,
        1e3,
    ),
    Parameter(
        "tool.centre_of_mass",
        [0.0, 0.0, 0.0],
        "m",
        "Its centre in the sensor's frame; counts for a torque.",
        may_be_zero=True,
    ),
    Parameter(
        "tool.gravity",
        [0.0, 0.0, -9.80665],
        "m/s^2",
        "Gravity in the frame of the poses, for a sensor that measures what acts on the tool; the "
        "other way round for one that measures what the tool does.",
    ),
    Parameter(
        "synchronize.max_gap",
        0.25,
        "s",
        "Displacement samples further apart are not interpolated between; a contact with a "
        "longer gap is given up.",
        1e-4,
        10.0,
    ),
    Parameter(
        "synchronize.window",
        5.0,
        "s",
        "How long a sample waits, in stamps, for the other stream.",
        1e-2,
        60.0,
    ),
    Parameter(
        "geometry.kind",
        "flat_punch",
        "1",
        "How force and displacement become stress and strain.",
        choices=("flat_punch", "sphere", "torsional_rheometer", "pass_through"),
    ),
    Parameter("geometry.area", 1e-4, "m^2", "flat_punch: area of the probe's face.", _TINY, 1.0),
    Parameter(
        "geometry.thickness",
        0.02,
        "m",
        "flat_punch: thickness of the tissue; torsional_rheometer: height of the sample.",
        1e-6,
        1.0,
    ),
    Parameter(
        "geometry.radius",
        0.005,
        "m",
        "sphere: radius of the tip; torsional_rheometer: radius of the sample.",
        1e-6,
        1.0,
    ),
    Parameter(
        "geometry.hayes",
        False,
        "1",
        "flat_punch: divide by Hayes' factor, for a probe smaller than the tissue around it.",
    ),
    Parameter("geometry.poisson_ratio", 0.5, "1", "Poisson's ratio for Hayes' factor.", 0.0, 0.5),
    Parameter(
        "origin.source",
        "touch",
        "1",
        "Strain origin: found from the force at the touch and refined, or given as a "
        "displacement.",
        choices=("touch", "given"),
    ),
    Parameter(
        "origin.displacement",
        0.0,
        "m",
        "Displacement at zero strain where it is given.",
        -10.0,
        10.0,
    ),
    Parameter(
        "contact.lookback",
        5.0,
        "s",
        "How far before its detection the onset of a contact is looked for.",
        0.1,
        60.0,
    ),
    Parameter(
        "site.distance",
        0.005,
        "m",
        "A touch further to the side than this is a new site, where positions are known.",
        0.0,
        1.0,
    ),
    Parameter(
        "site.timeout",
        2.0,
        "s",
        "A touch after a longer time in the air is a new site, where no positions are known.",
        0.0,
        1e5,
    ),
    Parameter(
        "alpha.source",
        "prior",
        "1",
        "The order alpha: learned from the tissue prior on, or given; either counts with its "
        "standard deviation.",
        choices=("prior", "given"),
    ),
    Parameter("alpha.value", 0.131, "1", "alpha where it is given.", 0.02, 0.6),
    Parameter("alpha.sd", 0.0, "1", "Standard deviation of an alpha that is given.", 0.0, 0.3),
    Parameter(
        "estimator.observation",
        "stress",
        "1",
        "What the filter looks at: the stress, which learns alpha as well, or the fractional "
        "stress, the paper's way.",
        choices=("stress", "fractional_stress"),
    ),
    Parameter(
        "prior.linear_stiffness", 520.0, "Pa s^alpha", "Median of G before the touch.", 1e-3, 1e9
    ),
    Parameter("prior.linear_stiffness_log_sd", 0.3, "1", "Standard deviation of ln G.", 1e-3, 5.0),
    Parameter("prior.nonlinear_stiffness", 8.4, "1", "Median of Gn before the touch.", 0.1, 100.0),
    Parameter(
        "prior.nonlinear_stiffness_log_sd", 0.2, "1", "Standard deviation of ln Gn.", 1e-2, 2.0
    ),
    Parameter("prior.alpha", 0.131, "1", "alpha of the tissue prior.", 0.02, 0.6),
    Parameter("prior.alpha_sd", 0.011, "1", "Its standard deviation.", 0.0, 0.3),
    Parameter(
        "converged.log_sd",
        0.05,
        "1",
        "Converged only while the standard deviation of ln Gn is below this.",
        1e-4,
        1.0,
    ),
    Parameter(
        "converged.probability",
        0.99,
        "1",
        "Converged only while the strain has passed 1/Gn with this probability.",
        0.5,
        1.0,
    ),
    Parameter("estimate.period", 0.01, "s", "One estimate per this time.", 1e-3, 1.0),
    Parameter(
        "estimate.time_scale", 0.1, "s", "Time scale tau of the apparent stiffness.", 1e-4, 1e4
    ),
    Parameter(
        "dither.frequencies",
        [0.0],
        "Hz",
        "Frequencies of a small oscillation of the probe at which the complex modulus is "
        "measured; 0: there is none.",
        0.0,
        1e3,
        most=8,
    ),
    Parameter(
        "dither.periods",
        4,
        "1",
        "One complex modulus per so many periods of the lowest frequency.",
        1,
        1000,
    ),
    Parameter(
        "classifier.library",
        "",
        "1",
        "Path of a tissue library (YAML); empty: the one that comes along.",
    ),
    Parameter(
        "classification.mode",
        "library",
        "1",
        "Tell the tissues of the library apart, or how much stiffer each site is than those "
        "around it that were touched before.",
        choices=("library", "relative"),
    ),
    Parameter(
        "classification.probability",
        0.7,
        "1",
        "A class is named when it is at least so probable.",
        0.34,
        1.0,
    ),
    Parameter(
        "classification.release",
        0.5,
        "1",
        "It stays named while it is at least so probable.",
        0.0,
        1.0,
    ),
    Parameter(
        "classification.dwell",
        0.2,
        "s",
        "How long another answer must stand before it replaces the one that is named.",
        0.0,
        60.0,
    ),
    Parameter(
        "classification.significance",
        0.06,
        "1",
        "library: unknown is what only this share of the best fitting tissue lies as far from.",
        0.0,
        0.5,
    ),
    Parameter(
        "classification.ratio", 1.5, "1", "relative: stiffer, or softer, by this.", 1.0, 1e3
    ),
    Parameter("classification.strain", 0.1, "1", "relative: strain of the comparison.", 0.0, 2.0),
    Parameter(
        "classification.distance",
        0.0,
        "m",
        "relative: surroundings are sites within this distance; 0: all.",
        0.0,
        10.0,
    ),
)

_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def defaults() -> dict[str, Value]:
    """Return every parameter with its default."""
    return {parameter.name: parameter.default for parameter in PARAMETERS}


def check(values: Mapping[str, object]) -> dict[str, Value]:
    """Return all parameters: `values` checked, the others at their defaults.

    Raises
    ------
    InputError
        If a name is unknown or a value not allowed.
    """
    checked = defaults()
    for name, value in values.items():
        if name not in _BY_NAME:
            near = difflib.get_close_matches(name, _BY_NAME, n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"there is no parameter {name}{hint}")
        checked[name] = _BY_NAME[name].check(value)
    return checked


#: Parameters of the node alone, or of every node: not the pipeline's, allowed in a parameter file.
NODE_PARAMETERS = frozenset(
    {
        "autostart",
        "stale_timeout",
        "use_sim_time",
        "start_type_description_service",
        "qos_overrides",
    }
)


def read_parameter_file(path: str | Path, node: str = "identifier") -> dict[str, Value]:
    """Read a ROS 2 parameter file, or a plain mapping of names to values.

    Sections for ``/**`` and for the node's name count, in that order.

    Raises
    ------
    InputError
        If the file cannot be read, or holds an unknown name or a value that is not allowed.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"{path}: cannot read the parameter file: {reason}") from error
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: not valid YAML: {reason}") from error
    if content is None:
        content = {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no mapping of parameter names to values")
    values: dict[str, object] = {}
    is_ros_file = any(isinstance(b, dict) and "ros__parameters" in b for b in content.values())
    sections = [
        (name, body["ros__parameters"])
        for name, body in content.items()
        if isinstance(body, dict) and _is_for(name, node, body)
    ]
    # What is said to this node outdoes what is said to all, wherever it stands.
    sections.sort(key=lambda section: str(section[0]).endswith(node))
    try:
        for _, section in sections if is_ros_file else [("", content)]:
            _flatten(section or {}, "", values)
        return check({k: v for k, v in values.items() if k.split(".")[0] not in NODE_PARAMETERS})
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _is_for(name: object, node: str, body: Mapping[str, object]) -> bool:
    return "ros__parameters" in body and str(name).rsplit("/", 1)[-1] in ("**", "*", node)


def _flatten(tree: Mapping[object, object], prefix: str, into: dict[str, object]) -> None:
    if not isinstance(tree, Mapping):
        raise InputError(f"{prefix or 'the parameters'}: must be a mapping of names to values")
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            _flatten(value, f"{name}.", into)
        else:
            into[name] = value


def unit_vector(values: Sequence[float]) -> tuple[float, float, float]:
    """Return `values`, three numbers, scaled to length 1."""
    length = math.hypot(*values)
    x, y, z = (v / length for v in values)
    return x, y, z


def pipeline_config(values: Mapping[str, Any]) -> PipelineConfig:
    """Return the core's configuration for checked parameter values.

    Raises
    ------
    InputError
        If the tissue library cannot be read, or is in other units than the estimates.
    """
    given = values["alpha.source"] == "given"
    prior = Prior(
        linear_stiffness=values["prior.linear_stiffness"],
        linear_stiffness_log_sd=values["prior.linear_stiffness_log_sd"],
        nonlinear_stiffness=values["prior.nonlinear_stiffness"],
        nonlinear_stiffness_log_sd=values["prior.nonlinear_stiffness_log_sd"],
        fractional_order=values["alpha.value"] if given else values["prior.alpha"],
        fractional_order_sd=values["alpha.sd"] if given else values["prior.alpha_sd"],
    )
    return PipelineConfig(
        library=library_for(values),
        geometry=_geometry(values),
        synchronize=SynchronizeConfig(
            displacement_delay=values["displacement.delay"],
            max_gap=values["synchronize.max_gap"],
            pairing_window=values["synchronize.window"],
            force_limit=values["force.limit"],
            displacement_limit=values["displacement.limit"],
        ),
        contact=ContactConfig(
            force_threshold=values["force.threshold"],
            measure_bias=values["force.measure_bias"],
            force_noise=values["force.noise"],
            noise_floor=values["force.noise_floor"],
            lookback=values["contact.lookback"],
            site_distance=values["site.distance"],
            site_timeout=values["site.timeout"],
            approach_axis=unit_vector(values["displacement.axis"]),
            series_compliance=values["displacement.compliance"],
        ),
        estimator=EstimatorConfig(
            prior=prior,
            observation=Observation(values["estimator.observation"]),
            fractional_order_given=given,
            converged_log_sd=values["converged.log_sd"],
            converged_probability=values["converged.probability"],
        ),
        strain_origin=(
            values["origin.displacement"] if values["origin.source"] == "given" else None
        ),
        block_duration=values["estimate.period"],
        apparent_stiffness_time_scale=values["estimate.time_scale"],
        decision=DecisionConfig(
            probability=values["classification.probability"],
            release=values["classification.release"],
            dwell=values["classification.dwell"],
            significance=values["classification.significance"],
        ),
        relative=(
            RelativeConfig(
                ratio=values["classification.ratio"],
                strain=values["classification.strain"],
                time_scale=values["estimate.time_scale"],
                distance=values["classification.distance"],
            )
            if values["classification.mode"] == "relative"
            else None
        ),
        dither_frequencies=tuple(sorted({f for f in values["dither.frequencies"] if f > 0.0})),
        dither_periods=values["dither.periods"],
    )


def tool_weight(values: Mapping[str, Any]) -> ToolWeight | None:
    """Return the tool whose weight is to be taken off; None where there is none."""
    if not values["tool.mass"]:
        return None
    centre, gravity = values["tool.centre_of_mass"], values["tool.gravity"]
    return ToolWeight(
        values["tool.mass"],
        (centre[0], centre[1], centre[2]),
        (gravity[0], gravity[1], gravity[2]),
        unit_vector(values["force.axis"]),
        is_torque=values["geometry.kind"] == "torsional_rheometer",
    )


def _geometry(values: Mapping[str, Any]) -> Geometry:
    kind = values["geometry.kind"]
    if kind == "sphere":
        return Sphere(values["geometry.radius"])
    if kind == "torsional_rheometer":
        return TorsionalRheometer(values["geometry.radius"], values["geometry.thickness"])
    if kind == "pass_through":
        return PassThrough()
    poisson_ratio = values["geometry.poisson_ratio"] if values["geometry.hayes"] else None
    return FlatPunch(values["geometry.area"], values["geometry.thickness"], poisson_ratio)
