# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All parameters: those of messages and frames are declared here, the others by the core.

A parameter is a field with the metadata of :func:`fden_ros.core.parameter.parameter`. Names,
checks, parameter files and the core's configuration follow from the fields.
"""

from __future__ import annotations

import dataclasses
import difflib
import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from fden_ros.core.config import PipelineConfig
from fden_ros.core.law import GeometryConfig, Sphere, TorsionalRheometer
from fden_ros.core.parameter import DESCRIBED, Described, parameter
from fden_ros.core.streams import ToolWeight
from fden_ros.errors import InputError
from fden_ros.message_kinds import FORCES, PLACES
from fden_ros.parameters.parameter import Parameter, Value, Vector


@dataclass(frozen=True)
class ForceInput:
    """Where the force is in its messages."""

    axis: Vector = parameter(
        "force.axis",
        (0.0, 0.0, 1.0),
        "Direction in the wrench's frame in which the measured force grows when the probe "
        "presses.",
    )
    message: str = parameter(
        "force.message",
        "wrench",
        "Type of the live force topic; a bag states its own.",
        choices=tuple(FORCES),
    )
    inverted: bool = parameter(
        "force.inverted", False, "true if the force, along its axis, falls as the probe presses."
    )
    name: str = parameter("force.name", "", "Joint whose effort is the force; empty: the first.")


@dataclass(frozen=True)
class DisplacementInput:
    """Where the displacement is in its messages."""

    axis: Vector = parameter(
        "displacement.axis",
        (0.0, 0.0, 1.0),
        "Direction into the tissue, in the frame of the positions or, with along_tool, in the "
        "probe's own.",
    )
    along_tool: bool = parameter(
        "displacement.along_tool",
        False,
        "displacement.axis and force.axis are fixed in the tool and turn with it.",
    )
    message: str = parameter(
        "displacement.message",
        "joint_state",
        "Type of the live displacement topic; a bag states its own. tf: the motion of "
        "frames.probe in frames.base.",
        choices=(*PLACES, "tf"),
    )
    name: str = parameter(
        "displacement.name", "", "Joint whose position is the displacement; empty: the first."
    )
    inverted: bool = parameter(
        "displacement.inverted",
        False,
        "true if the displacement, along its axis, falls as the probe moves into the tissue.",
    )
    surface_normal: Vector = parameter(
        "surface.normal",
        (0.0, 0.0, 0.0),
        "Direction into the tissue, perpendicular to its surface, in the frame of the poses or "
        "frames.base; zeros: the probe stands upright.",
        may_be_zero=True,
    )


@dataclass(frozen=True)
class FrameNames:
    """Frames that move, by /tf and /tf_static, where force or displacement are given in them."""

    base: str = parameter(
        "frames.base",
        "",
        "Frame of force.axis; forces are rotated into it by the transforms at their stamps; "
        "empty: no transform is used.",
    )
    probe: str = parameter(
        "frames.probe",
        "",
        "Frame of the probe's tip. Its motion is the displacement if displacement.message is tf; "
        "forces without a frame are in it.",
    )


@dataclass(frozen=True)
class NodeSettings:
    """Settings of the node other than the identification."""

    autostart: bool = parameter(
        "autostart",
        False,
        "Configure and activate at start-up, without a lifecycle manager.",
    )
    source_timeout: float = parameter(
        "source_timeout",
        0.5,
        "Time without a usable pair of samples after which the estimate is stale.",
        "s",
        0.01,
        60.0,
    )
    lag_deadline: float = parameter(
        "lag_deadline",
        0.1,
        "Time from the receipt of a sample to its estimate after which the estimate is late.",
        "s",
        0.01,
        60.0,
    )


@dataclass(frozen=True)
class Parameters:
    """All parameters of the identifier; made by :func:`check`."""

    force: ForceInput = ForceInput()
    displacement: DisplacementInput = DisplacementInput()
    frames: FrameNames = FrameNames()
    tool: ToolWeight = field(default_factory=ToolWeight)
    stamp_source: str = parameter(
        "synchronize.stamp_source",
        "header",
        "Time of a sample: from the message's header, or its receipt (in a bag, its recording). "
        "The receipt jitters; use it for drivers that stamp with 0, or from two clocks.",
        choices=("header", "receive"),
    )
    geometry: GeometryConfig = field(default_factory=GeometryConfig)
    #: As stated; :func:`~fden_ros.parameters.pipeline_config` completes it.
    core: PipelineConfig = field(default_factory=lambda: PipelineConfig(None))
    library: str = parameter(
        "classifier.library", "", "Path of a tissue library (YAML); empty: the built-in one."
    )

    def as_dict(self) -> dict[str, Value]:
        """Return every value by the parameter's name, lists as a parameter file has them."""
        return {described.name: _plain(value) for described, value in _leaves(self)}

    def changed(self, values: Mapping[str, object]) -> Parameters:
        """Return these parameters with others in place of some."""
        own = {name: parameter_named(name).check(value) for name, value in values.items()}
        found: Parameters = _changed(self, own)
        kind = found.geometry.kind
        if kind in (Sphere.kind, TorsionalRheometer.kind) and not found.geometry.radius:
            raise InputError(
                f"geometry.kind is {kind} and geometry.radius is 0: state the radius [m]"
            )
        return found


def _leaves(settings: Any) -> Iterator[tuple[Described, Any]]:
    """Yield the description of every field that is a parameter, and its value."""
    for leaf in dataclasses.fields(settings):
        value = getattr(settings, leaf.name)
        if leaf.metadata:
            yield leaf.metadata[DESCRIBED], value
        elif dataclasses.is_dataclass(value):
            yield from _leaves(value)


def _changed(settings: Any, values: Mapping[str, Any]) -> Any:
    """Return a dataclass with values, by the names of parameters, in place of some."""
    changes: dict[str, Any] = {}
    for leaf in dataclasses.fields(settings):
        value, described = getattr(settings, leaf.name), leaf.metadata.get(DESCRIBED)
        if described is not None and described.name in values:
            changes[leaf.name] = type(value)(values[described.name])
        elif dataclasses.is_dataclass(value):
            changes[leaf.name] = _changed(value, values)
    return dataclasses.replace(settings, **changes)


def _plain(value: Any) -> Value:
    if isinstance(value, enum.Enum):
        return str(value.value)
    return list(value) if isinstance(value, tuple) else value


def _described(settings: Any) -> tuple[Parameter, ...]:
    """Return the parameters, each group together at the place of its first one."""
    groups: dict[str, list[Parameter]] = {}
    for own, value in _leaves(settings):
        group = groups.setdefault(own.name.partition(".")[0], [])
        group.append(Parameter(default=_plain(value), **vars(own)))
    return tuple(one for group in groups.values() for one in group)


PARAMETERS = _described(Parameters())
#: Of the node alone: not the identification's, in the same file.
NODE_PARAMETERS = _described(NodeSettings())
#: Of every node, declared by rclpy.
ROS_PARAMETERS = ("use_sim_time", "start_type_description_service")
_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}
_NODE_BY_NAME = {parameter.name: parameter for parameter in NODE_PARAMETERS}


def check(values: Mapping[str, object]) -> Parameters:
    """Return all parameters: `values`, by name or by group, checked, the others at defaults."""
    return Parameters().changed(_flat(values))


def _flat(groups: Mapping[str, object]) -> dict[str, object]:
    """Return parameters by their dotted names."""
    found: dict[str, object] = {}
    for name, value in groups.items():
        if isinstance(value, Mapping):
            found |= {f"{name}.{own}": one for own, one in _flat(value).items()}
        else:
            found[name] = value
    return found


def parameter_named(name: str) -> Parameter:
    """Return the parameter of a name."""
    if name in _BY_NAME:
        return _BY_NAME[name]
    near = difflib.get_close_matches(name, [*_BY_NAME, *_NODE_BY_NAME], n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]}?" if near else ""
    is_group = any(one.startswith(f"{name}.") for one in _BY_NAME)
    words = f"{name} is a group of parameters" if is_group else f"there is no parameter {name}"
    raise InputError(f"{words}{hint}")


def identifier_values(values: Mapping[str, object]) -> dict[str, object]:
    """Return the values that are the identification's; those of the node alone are checked."""
    own: dict[str, object] = {}
    for name, value in values.items():
        if name in _NODE_BY_NAME:
            _NODE_BY_NAME[name].check(value)
        elif name not in ROS_PARAMETERS and not name.startswith("qos_overrides."):
            own[name] = value
    return own
