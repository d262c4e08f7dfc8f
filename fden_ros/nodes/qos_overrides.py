# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Overrides of the quality of service by parameter: of topics in use, with policies there are."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from fden_ros.errors import InputError

_PREFIX = "qos_overrides."
#: What may be overridden, and the names that a policy may have; depth is a whole number.
_POLICIES: dict[str, type | None] = {
    "history": HistoryPolicy,
    "depth": None,
    "reliability": ReliabilityPolicy,
    "durability": DurabilityPolicy,
}
OVERRIDABLE = QoSOverridingOptions([QoSPolicyKind[name.upper()] for name in _POLICIES])


def check_qos_overrides(
    values: Mapping[str, object], inputs: Sequence[str], outputs: Sequence[str]
) -> None:
    """Check the ``qos_overrides`` among a node's parameters.

    Parameters
    ----------
    values : mapping
        Parameters by name, such as ``qos_overrides./force.subscription.depth``.
    inputs, outputs : sequence of str
        Resolved names of the topics that the node subscribes to, and of those that it publishes.

    Raises
    ------
    InputError
        If one is of a topic or policy that is not used, or has a value that is none.
    """
    known = [f"{topic}.subscription" for topic in inputs] + [f"{t}.publisher" for t in outputs]
    for name, value in values.items():
        if not name.startswith(_PREFIX):
            continue
        entity, _, policy = name.removeprefix(_PREFIX).rpartition(".")
        if entity not in known:
            near = difflib.get_close_matches(entity, known, n=1, cutoff=0.0)
            raise InputError(
                f"parameter {name}: there is no {entity or 'such topic'}; did you mean {near[0]}?"
            )
        if policy not in _POLICIES:
            raise InputError(
                f"parameter {name}: {policy} cannot be overridden, only {', '.join(_POLICIES)}"
            )
        _check(name, value, _POLICIES[policy])


def _check(name: str, value: object, kind: type | None) -> None:
    if kind is None:
        # A queue of any length, but not one that holds nothing.
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise InputError(f"parameter {name} is {value!r}, must be a whole number, at least 1")
        return
    names = [member.name.lower() for member in kind if member.name != "UNKNOWN"]  # type: ignore[attr-defined]
    if value not in names:
        raise InputError(f"parameter {name} is {value!r}, must be one of {', '.join(names)}")
