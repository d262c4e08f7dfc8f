# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The core's configuration from checked parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Uncertainty
from fden_ros.core.law import TorsionalRheometer
from fden_ros.core.streams import FramesConfig, ToolWeight
from fden_ros.errors import InputError
from fden_ros.parameters.parameter import Vector
from fden_ros.parameters.table import DisplacementInput, ForceInput, Parameters
from fden_ros.tissues.library import library_for


def unit_vector(values: Sequence[float]) -> Vector:
    """Return `values`, three numbers, scaled to length 1, but zeros as they are."""
    length = math.hypot(*values) or 1.0
    x, y, z = (v / length for v in values)
    return x, y, z


def direction(stated: ForceInput | DisplacementInput) -> Vector:
    """Return the unit vector along which a measured vector grows as the probe presses."""
    x, y, z = unit_vector(stated.axis)
    return (-x, -y, -z) if stated.inverted else (x, y, z)


def pipeline_config(parameters: Parameters) -> PipelineConfig:
    """Return the core's configuration for checked parameters."""
    core, geometry = parameters.core, parameters.geometry.build()
    displacement = parameters.displacement
    if core.is_continuous and len(core.dither_frequencies) > 1:
        raise InputError(
            f"dither.frequencies has {len(core.dither_frequencies)} frequencies: with "
            "contact.mode continuous give only that of the palpation, or 0 to find it"
        )
    if core.estimator.friction and not core.estimator.uncertainty.friction_sd:
        raise InputError(
            f"force.friction is {core.estimator.friction} and force.friction_sd is 0: a friction "
            "is used only with a standard deviation, such as 0.001"
        )
    axis, stated = direction(displacement), unit_vector(displacement.surface_normal)
    frames, along_tool = frames_config(parameters), displacement.along_tool
    normal = stated if along_tool and any(stated) else None
    return replace(
        core,
        library=library_for(parameters.library, geometry),
        geometry=geometry,
        synchronize=replace(
            core.synchronize,
            frames=frames,
            tool_axis=axis if along_tool else None,
            tool_normal=normal,
        ),
        # Along the tool two touches may differ and be of one site; without a normal there is no
        # such line.
        contact=replace(core.contact, approach_axis=stated if along_tool else axis),
        estimator=replace(core.estimator, uncertainty=uncertainty_of(parameters)),
    )


def uncertainty_of(parameters: Parameters) -> Uncertainty:
    """Return what is not known of model and rig, the thickness by what it does to G and Gn."""
    stated = parameters.core.estimator.uncertainty
    gain = parameters.geometry.build().size_gain
    return replace(stated, thickness_sd=stated.thickness_sd * gain)


def frames_config(parameters: Parameters) -> FramesConfig | None:
    """Return which frames count; None where no transform is used."""
    base, probe = parameters.frames.base, parameters.frames.probe
    moves_probe = parameters.displacement.message == "tf"
    if moves_probe and not (base and probe):
        raise InputError(
            "displacement.message is tf: name the frame of the probe's tip and that of the tissue "
            "in frames.probe and frames.base"
        )
    if not base:
        return None
    return FramesConfig(
        base,
        probe,
        direction(parameters.force),
        direction(parameters.displacement),
        moves_probe,
        tool_weight(parameters),
    )


def tool_weight(parameters: Parameters) -> ToolWeight | None:
    """Return the tool whose weight is to be subtracted; None without one."""
    if not parameters.tool.mass:
        return None
    return replace(
        parameters.tool,
        axis=direction(parameters.force),
        is_torque=parameters.geometry.kind == TorsionalRheometer.kind,
    )
