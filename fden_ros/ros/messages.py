# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The values of the core as ROS messages, and back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from fden_msgs.msg import ComplexModulus, PalpationSummary, TissueClassification, TissueEstimate
from geometry_msgs.msg import Point

from fden_ros.core.classification import ClassProbabilities
from fden_ros.core.estimation import (
    PUBLISHED,
    Component,
    Estimate,
    Innovation,
    LawError,
    ParameterSet,
)
from fden_ros.core.outputs import (
    ApparentStiffness,
    Classification,
    ContactSummary,
    Decided,
    DynamicModulus,
    Flag,
    OrderSource,
    Output,
    Phase,
    Signals,
    Status,
    TissueState,
)
from fden_ros.core.stiffness import MeasuredSlope, Slopes
from fden_ros.core.streams import NANOSECONDS
from fden_ros.inputs import stamp_ns

_Message = TypeVar("_Message")

#: Fields of the messages: of loading, of unloading.
_MEASURED = ("measured_slope", "measured_slope_unloading")


def to_stamp(nanoseconds: int) -> Time:
    """Return integer nanoseconds as a stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def type_name(kind: Callable[..., Any]) -> str:
    """Return the name of a message class, such as ``geometry_msgs/msg/WrenchStamped``."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"


def _unknown(kind: type[_Message]) -> _Message:
    """Return a message whose numbers are NaN until they are set."""
    message = kind()
    for name, own in message.get_fields_and_field_types().items():  # type: ignore[attr-defined]
        if own == "double":
            setattr(message, name, math.nan)
        elif own.startswith("double["):
            setattr(message, name, np.full(len(getattr(message, name)), math.nan))
        elif own == "geometry_msgs/Point":
            setattr(message, name, Point(x=math.nan, y=math.nan, z=math.nan))
    return message


def estimate_message(state: TissueState, frame_id: str) -> TissueEstimate:
    """Return a :class:`TissueState` as a message."""
    message = _unknown(TissueEstimate)
    _fill_head(message, state, frame_id)
    message.flags = int(state.flags)
    message.status = int(state.status)
    message.lag = state.lag
    message.phase = int(state.phase)
    valid = 0
    if state.estimate is not None:
        valid |= TissueEstimate.VALID_PARAMETERS
        _fill_parameters(message, state.estimate, state.order_source)
        message.sample_count = state.estimate.sample_count
    if state.signals is not None:
        valid |= TissueEstimate.VALID_SIGNALS
        _fill(message, state.signals, "strain", "stress", "fractional_stress")
    if state.innovation is not None:
        valid |= TissueEstimate.VALID_INNOVATION | TissueEstimate.VALID_PREDICTED_STRESS
        names = "predicted_fractional_stress", "predicted_stress", "innovation"
        _fill(message, state.innovation, *names)
        message.normalized_innovation_squared = state.innovation.normalized_squared
    if state.apparent_stiffness is not None:
        valid |= TissueEstimate.VALID_APPARENT_STIFFNESS
        _fill_apparent_stiffness(message, state.apparent_stiffness)
    _fill_measured(message, state.measured)
    if state.measured.loading is not None:
        valid |= TissueEstimate.VALID_MEASURED_SLOPE
    if state.measured.unloading is not None:
        valid |= TissueEstimate.VALID_MEASURED_SLOPE_UNLOADING
    message.valid = valid
    return message


def classification_message(output: Classification, frame_id: str) -> TissueClassification:
    """Return a :class:`Classification` as a message."""
    message = _unknown(TissueClassification)
    _fill_head(message, output, frame_id)
    message.flags = int(output.flags)
    message.decision = int(output.decision)
    message.library = output.library_name
    _fill_classes(message, output)
    return message


def modulus_message(output: DynamicModulus, frame_id: str) -> ComplexModulus:
    """Return a :class:`DynamicModulus` as a message."""
    message, modulus = _unknown(ComplexModulus), output.modulus
    _fill_head(message, output, frame_id)
    message.start = to_stamp(output.start_ns)
    _fill(message, modulus, "angular_frequency", "mean_strain", "strain_amplitude")
    _fill(message, modulus, "fractional_order", "fractional_order_sd", "stiffness", "distortion")
    message.storage_modulus = modulus.storage
    message.loss_modulus = modulus.loss
    message.modulus_sd = modulus.sd
    if modulus.slope is not None and modulus.slope_sd is not None:
        message.slope, message.slope_sd = modulus.slope, modulus.slope_sd
    message.sample_count = modulus.samples
    return message


def summary_message(summary: ContactSummary, frame_id: str) -> PalpationSummary:
    """Return a :class:`ContactSummary` as a message."""
    message = _unknown(PalpationSummary)
    _fill_head(message, summary, frame_id)
    message.flags = int(summary.flags)
    message.start, message.end = to_stamp(summary.start_ns), to_stamp(summary.end_ns)
    _fill(message, summary, "converged", "complete", "max_strain", "max_stress", "max_force")
    _fill(message, summary, "sample_count", "rejected_count")
    if summary.position is not None:
        message.position_valid = True
        message.position.x, message.position.y, message.position.z = summary.position
        message.position_frame_id = summary.position_frame
    if summary.estimate is not None:
        _fill_parameters(message, summary.estimate, summary.order_source)
        members = summary.estimate.mixture
        message.component_weights = [float(m.weight) for m in members]
        message.component_means = np.concatenate([m.mean for m in members]).tolist()
        covariances = np.concatenate([m.covariance.ravel() for m in members])
        message.component_covariances = covariances.tolist()
    _fill_apparent_stiffness(message, summary.apparent_stiffness)
    _fill_measured(message, summary.measured)
    _fill_classes(message, summary)
    return message


def _fill_head(message: Any, output: Output, frame_id: str) -> None:
    message.header.stamp = to_stamp(output.stamp_ns)
    message.header.frame_id = frame_id
    _fill(message, output, "site_id", "contact_id")


def _fill(message: Any, source: Any, *names: str) -> None:
    """Set what has the same name in both."""
    for name in names:
        setattr(message, name, getattr(source, name))


def _fill_parameters(
    message: TissueEstimate | PalpationSummary, estimate: Estimate, source: OrderSource
) -> None:
    for name, value in estimate.numbers.items():
        setattr(message, name, value)
    message.mean_dwell_time = estimate.mean_dwell_time or math.nan
    message.covariance = estimate.covariance.ravel()
    message.alpha_source = int(source)
    message.observable_parameters = int(estimate.observable)
    message.converged_parameters = int(estimate.known)
    message.prior_limit_parameters = int(estimate.at_edge)


def _fill_apparent_stiffness(
    message: TissueEstimate | PalpationSummary, stiffness: ApparentStiffness | None
) -> None:
    if stiffness is None:
        return
    message.apparent_stiffness = stiffness.value
    message.apparent_stiffness_sd = stiffness.sd
    message.apparent_stiffness_time_scale = stiffness.time_scale


def _fill_measured(message: TissueEstimate | PalpationSummary, measured: Slopes) -> None:
    for name, found in zip(_MEASURED, measured, strict=True):
        if found is None:
            continue
        setattr(message, name, found.value)
        for part in ("sd", "depth"):
            setattr(message, f"{name}_{part}", getattr(found, part))
        setattr(message, f"{name}_time", to_stamp(found.stamp_ns))


def _fill_classes(
    message: TissueClassification | PalpationSummary, output: Classification | ContactSummary
) -> None:
    classes, decided, comparison = output.classes, output.decided, output.comparison
    if classes is not None:
        message.label = classes.label
        message.class_names = list(classes.names)
        message.probabilities = list(classes.probabilities)
        message.p_value = classes.p_value
    if decided is not None:
        message.decision_time, message.decision_strain = decided.time, decided.strain
    if comparison is not None:
        message.ratio = comparison.ratio
        message.ratio_low, message.ratio_high = comparison.interval()


def state_of(message: TissueEstimate) -> TissueState:
    """Return an estimate message as a :class:`TissueState`."""
    valid = message.valid
    has_parameters = bool(valid & TissueEstimate.VALID_PARAMETERS)
    return TissueState(
        stamp_ns=stamp_ns(message.header.stamp),
        status=Status(message.status),
        flags=Flag(message.flags),
        site_id=message.site_id,
        contact_id=message.contact_id,
        phase=Phase(message.phase),
        order_source=OrderSource(message.alpha_source),
        estimate=_estimate_of(message, message.sample_count) if has_parameters else None,
        signals=Signals(message.strain, message.stress, message.fractional_stress)
        if valid & TissueEstimate.VALID_SIGNALS
        else None,
        innovation=Innovation(
            message.predicted_stress,
            message.innovation,
            message.innovation**2 / (message.normalized_innovation_squared or 1.0),
            message.predicted_fractional_stress,
        )
        if valid & TissueEstimate.VALID_INNOVATION
        else None,
        apparent_stiffness=_apparent_stiffness_of(message),
        lag=message.lag,
        measured=_measured_of(message),
    )


def summary_of(message: PalpationSummary) -> ContactSummary:
    """Return a summary message as a :class:`ContactSummary`."""
    position = message.position
    return ContactSummary(
        stamp_ns=stamp_ns(message.header.stamp),
        start_ns=stamp_ns(message.start),
        end_ns=stamp_ns(message.end),
        site_id=message.site_id,
        contact_id=message.contact_id,
        flags=Flag(message.flags),
        converged=message.converged,
        complete=message.complete,
        position=(position.x, position.y, position.z) if message.position_valid else None,
        order_source=OrderSource(message.alpha_source),
        estimate=_estimate_of(message, message.sample_count)._replace(
            components=_components_of(message)
        )
        if message.alpha_source
        else None,
        max_strain=message.max_strain,
        max_stress=message.max_stress,
        max_force=message.max_force,
        sample_count=message.sample_count,
        rejected_count=message.rejected_count,
        classes=ClassProbabilities(
            message.label,
            tuple(message.class_names),
            tuple(message.probabilities),
            message.p_value,
        )
        if message.class_names
        else None,
        decided=Decided(message.decision_time, message.decision_strain) if message.label else None,
        position_frame=message.position_frame_id,
        apparent_stiffness=_apparent_stiffness_of(message),
        measured=_measured_of(message),
    )


def _components_of(message: PalpationSummary) -> tuple[Component, ...]:
    means = np.array(message.component_means).reshape(-1, 3)
    covariances = np.array(message.component_covariances).reshape(-1, 3, 3)
    return tuple(map(Component, message.component_weights, means, covariances))


def _apparent_stiffness_of(
    message: TissueEstimate | PalpationSummary,
) -> ApparentStiffness | None:
    if math.isnan(message.apparent_stiffness):
        return None
    return ApparentStiffness(
        message.apparent_stiffness,
        message.apparent_stiffness_sd,
        message.apparent_stiffness_time_scale,
    )


def _measured_of(message: TissueEstimate | PalpationSummary) -> Slopes:
    return Slopes(*(_slope_of(message, name) for name in _MEASURED))


def _slope_of(message: TissueEstimate | PalpationSummary, name: str) -> MeasuredSlope | None:
    value = getattr(message, name)
    if math.isnan(value):
        return None
    sd, depth, time = (getattr(message, f"{name}_{part}") for part in ("sd", "depth", "time"))
    return MeasuredSlope(value, sd, depth, stamp_ns(time))


def _estimate_of(message: TissueEstimate | PalpationSummary, sample_count: int) -> Estimate:
    found = Estimate(
        log_linear_stiffness=math.log(message.linear_stiffness),
        log_nonlinear_stiffness=math.log(message.nonlinear_stiffness),
        covariance=np.array(message.covariance).reshape(3, 3),
        **{name: getattr(message, name) for name in PUBLISHED if name in Estimate._fields},
        law_error=LawError(*(getattr(message, name) for name in LawError.names()))
        if not math.isnan(message.relaxation_error_sd)
        else None,
        probability_beyond_boundary=math.nan,
        observable=ParameterSet(message.observable_parameters),
        known=ParameterSet(message.converged_parameters),
        at_edge=ParameterSet(message.prior_limit_parameters),
        sample_count=sample_count,
        is_order_contradicted=bool(message.flags & Flag.ALPHA_PRIOR_CONFLICT),
    )
    return found if found.mean_dwell_time >= 0.0 else found._replace(mean_dwell_time=0.0)
