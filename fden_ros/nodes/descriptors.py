# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A parameter's description and range, as ROS tells them."""

from __future__ import annotations

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from fden_ros.parameters import Parameter


def descriptor_of(parameter: Parameter, *, read_only: bool) -> ParameterDescriptor:
    """Return the descriptor with unit and range."""
    descriptor = ParameterDescriptor(
        description=f"{parameter.description} [{parameter.unit}]", read_only=read_only
    )
    is_number = isinstance(parameter.default, (int, float)) and not isinstance(
        parameter.default, bool
    )
    if is_number and isinstance(parameter.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=0.0 if parameter.may_be_zero else parameter.minimum,
                to_value=parameter.maximum,
            )
        ]
    elif is_number:
        descriptor.integer_range = [
            IntegerRange(
                from_value=int(parameter.minimum), to_value=int(parameter.maximum), step=1
            )
        ]
    return descriptor
