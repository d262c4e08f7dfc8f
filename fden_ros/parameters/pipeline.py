# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The core's configuration from checked parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fden_ros.core.classification.labelling import DecisionConfig
from fden_ros.core.classification.relative import RelativeConfig
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import ContactConfig
from fden_ros.core.estimation.estimator_config import (
    KERNEL_SHARE,
    EstimatorConfig,
    Observation,
    Prior,
    Uncertainty,
)
from fden_ros.core.law.geometry import FlatPunch, Geometry, PassThrough, Sphere, TorsionalRheometer
from fden_ros.core.plausibility import PlausibilityConfig
from fden_ros.core.streams.frames import FramesConfig
from fden_ros.core.streams.synchronize import SynchronizeConfig
from fden_ros.core.streams.tool import ToolPathConfig, ToolWeight
from fden_ros.errors import InputError
from fden_ros.parameters.table import Parameters
from fden_ros.tissues.library import library_for

#: Two touches this part of the probe's radius apart [1] are of two sites, which share most of
#: their tissue but not its memory: so a scan of 3 mm has a site at each touch. Positions are known
#: to half a millimetre [m] or better.
_SITE_PART, _LEAST_SITE_DISTANCE, _LARGEST_SITE_DISTANCE = 0.2, 5e-4, 2e-3


#: Sizes that stand in for those that are not stated [m^2, m].
_AREA, _THICKNESS, _RADIUS = 1e-4, 0.02, 0.005


def unit_vector(values: Sequence[float]) -> tuple[float, float, float]:
    """Return `values`, three numbers, scaled to length 1."""
    length = math.hypot(*values)
    x, y, z = (v / length for v in values)
    return x, y, z


def pipeline_config(parameters: Parameters) -> PipelineConfig:
    """Return the core's configuration for checked parameters.

    Raises
    ------
    InputError
        If the tissue library cannot be read, or is in other units than the estimates, a friction
        is given without a deviation, or several frequencies of a palpation.
    """
    geometry = geometry_of(parameters)
    frequencies = tuple(sorted({f for f in parameters.dither.frequencies if f > 0.0}))
    if parameters.contact.mode == "continuous" and len(frequencies) > 1:
        raise InputError(
            f"dither.frequencies has {len(frequencies)} frequencies: with contact.mode continuous "
            "give that of the palpation alone, or 0 to find it"
        )
    prior = Prior(
        linear_stiffness=parameters.prior.linear_stiffness,
        linear_stiffness_log_sd=parameters.prior.linear_stiffness_log_sd,
        nonlinear_stiffness=parameters.prior.nonlinear_stiffness,
        nonlinear_stiffness_log_sd=parameters.prior.nonlinear_stiffness_log_sd,
        fractional_order=parameters.prior.alpha,
        fractional_order_sd=parameters.prior.alpha_sd,
    )
    return PipelineConfig(
        library=library_for(parameters.classifier.library, geometry),
        geometry=geometry,
        synchronize=SynchronizeConfig(
            displacement_delay=parameters.displacement.delay,
            max_gap=parameters.synchronize.max_gap,
            pairing_window=parameters.synchronize.window,
            force_limit=parameters.force.limit,
            displacement_limit=parameters.displacement.limit,
            takes_surface=takes_surface(parameters),
            surface_delay=parameters.surface.delay,
            frames=frames_config(parameters),
            tool_path=_tool_path(parameters),
        ),
        contact=ContactConfig(
            force_threshold=parameters.force.threshold,
            measure_bias=parameters.force.measure_bias,
            force_noise=parameters.force.noise,
            noise_floor=parameters.force.noise_floor,
            lookback=parameters.contact.lookback,
            site_distance=parameters.site.distance or _site_distance(parameters),
            site_timeout=parameters.site.timeout,
            approach_axis=_approach_axis(parameters),
            series_compliance=parameters.displacement.compliance,
        ),
        estimator=EstimatorConfig(
            prior=prior,
            observation=Observation(parameters.estimator.observation),
            fractional_order_given=not parameters.alpha.learn,
            converged_log_sd=parameters.converged.log_sd,
            converged_linear_log_sd=parameters.converged.linear_log_sd,
            converged_order_sd=parameters.converged.alpha_sd,
            converged_probability=parameters.converged.probability,
            uncertainty=uncertainty_of(parameters),
            friction=_friction(parameters),
        ),
        strain_origin=(
            parameters.origin.displacement if parameters.origin.source == "given" else None
        ),
        block_duration=parameters.estimate.period,
        apparent_stiffness_time_scale=parameters.estimate.time_scale,
        decision=DecisionConfig(
            probability=parameters.classification.probability,
            release=parameters.classification.release,
            dwell=parameters.classification.dwell,
            significance=parameters.classification.significance,
        ),
        relative=(
            RelativeConfig(
                ratio=parameters.classification.ratio,
                strain=parameters.classification.strain,
                time_scale=parameters.estimate.time_scale,
                distance=parameters.classification.distance,
            )
            if parameters.classification.mode == "relative"
            else None
        ),
        dither_frequencies=frequencies,
        dither_periods=parameters.dither.periods,
        learns_rig=parameters.rig.learn,
        learns_motion=parameters.surface.learn_motion,
        learns_drift=parameters.force.learn_drift,
        is_continuous=parameters.contact.mode == "continuous",
        plausibility=PlausibilityConfig(
            most_force=parameters.plausible.force,
            least_strain_rate=parameters.plausible.strain_rate,
        ),
    )


def uncertainty_of(parameters: Parameters) -> Uncertainty:
    """Return what is not known of model and rig."""
    return Uncertainty(
        kernel_sd=KERNEL_SHARE * parameters.model_error.sd,
        characteristic_sd=parameters.model_error.sd,
        surface_motion_sd=parameters.surface.motion_sd,
        force_drift_sd=parameters.force.drift_sd,
        friction_sd=parameters.force.friction_sd,
        compliance_sd=parameters.displacement.compliance_sd,
        delay_sd=parameters.displacement.delay_sd,
        thickness_sd=parameters.geometry.thickness_sd * geometry_of(parameters).size_gain,
    )


def _friction(parameters: Parameters) -> float:
    force = parameters.force
    if force.friction and not force.friction_sd:
        raise InputError(
            f"force.friction is {force.friction} and force.friction_sd is 0: a friction counts "
            "only with a standard deviation, 0.001 say"
        )
    return force.friction


def frames_config(parameters: Parameters) -> FramesConfig | None:
    """Return which frames count; None where no transform is used.

    Raises
    ------
    InputError
        If a frame is missing.
    """
    base, probe = parameters.frames.base, parameters.frames.probe
    by_transform = moves_probe(parameters)
    if by_transform and not (base and probe):
        raise InputError(
            "displacement.message is tf: name the frame of the probe's tip and that of the tissue "
            "in frames.probe and frames.base"
        )
    if not base:
        return None
    return FramesConfig(
        base,
        probe,
        unit_vector(parameters.force.axis),
        unit_vector(parameters.displacement.axis),
        by_transform,
        tool_weight(parameters),
    )


def _tool_path(parameters: Parameters) -> ToolPathConfig | None:
    if not parameters.displacement.along_tool:
        return None
    normal = parameters.surface.normal
    return ToolPathConfig(
        unit_vector(parameters.displacement.axis), unit_vector(normal) if any(normal) else None
    )


def _approach_axis(parameters: Parameters) -> tuple[float, float, float]:
    """Return the direction along which two touches may differ and be of one site; zeros: none."""
    if not parameters.displacement.along_tool:
        return unit_vector(parameters.displacement.axis)
    normal = parameters.surface.normal
    return unit_vector(normal) if any(normal) else (0.0, 0.0, 0.0)


def moves_probe(parameters: Parameters) -> bool:
    """Return whether the displacement is that of a frame, by transforms."""
    return parameters.displacement.message == "tf"


def takes_surface(parameters: Parameters) -> bool:
    """Return whether the place of the surface is measured."""
    return parameters.surface.message != "none"


def surface_axis(parameters: Parameters) -> tuple[float, float, float]:
    """Return the direction into the tissue in the frame of the surface's positions."""
    axis = parameters.surface.axis
    return unit_vector(axis if any(axis) else parameters.displacement.axis)


def tool_weight(parameters: Parameters) -> ToolWeight | None:
    """Return the tool whose weight is to be taken off; None where there is none."""
    if not parameters.tool.mass:
        return None
    return ToolWeight(
        parameters.tool.mass,
        parameters.tool.centre_of_mass,
        parameters.tool.gravity,
        unit_vector(parameters.force.axis),
        is_torque=parameters.geometry.kind == "torsional_rheometer",
    )


def _site_distance(parameters: Parameters) -> float:
    """Return the distance between sites that follows the probe's size [m]."""
    kind = parameters.geometry.kind
    if kind == "pass_through":
        return _LEAST_SITE_DISTANCE
    radius = parameters.geometry.radius or _RADIUS
    if kind == "flat_punch":
        radius = math.sqrt((parameters.geometry.area or _AREA) / math.pi)
    return min(max(_SITE_PART * radius, _LEAST_SITE_DISTANCE), _LARGEST_SITE_DISTANCE)


def geometry_of(parameters: Parameters) -> Geometry:
    """Return how force and displacement become stress and strain.

    It is not stated where a size that its kind needs is 0; another one stands in for it.
    """
    own = parameters.geometry
    area, thickness, radius = own.area or _AREA, own.thickness or _THICKNESS, own.radius or _RADIUS
    has_thickness, has_radius = own.thickness > 0.0, own.radius > 0.0
    if own.kind == "sphere":
        depth = own.thickness or math.inf
        return Sphere(radius, depth, own.poisson_ratio, own.bonded, is_stated=has_radius)
    if own.kind == "torsional_rheometer":
        return TorsionalRheometer(radius, thickness, is_stated=has_radius and has_thickness)
    if own.kind == "pass_through":
        return PassThrough()
    poisson_ratio = own.poisson_ratio if own.hayes else None
    is_stated = own.area > 0.0 and has_thickness
    return FlatPunch(area, thickness, poisson_ratio, own.bonded, is_stated=is_stated)
