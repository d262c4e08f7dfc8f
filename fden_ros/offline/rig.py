# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a recording tells of the rig, as parameters."""

from __future__ import annotations

from pathlib import Path

import yaml

from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.parameters import Parameters
from fden_ros.recording.source import Selection

#: Parameters of each quantity: the value that a learned one adds to, and its deviation.
_NAMES = {
    "delay": ("displacement.delay", "displacement.delay_sd"),
    "friction": ("force.friction", "force.friction_sd"),
}


def learn_rig(
    bag: str | Path, parameters: Parameters, selection: Selection | None = None
) -> RigKnowledge:
    """Return what is known of the rig after the contacts of a recording.

    Raises
    ------
    InputError
        If the recording cannot be used, or no contact in it tells of the rig.
    """
    learning = parameters.changed({"rig.learn": True})
    summaries = replay(bag, learning, selection, progress=True).summaries
    rig = summaries[-1].rig if summaries else None
    if rig is None or not rig.contacts:
        raise InputError(
            f"{bag}: none of its {len(summaries)} contacts tells of the rig: it takes contacts "
            "that converge, without a flag, with hold and release"
        )
    return rig


def learned_parameters(rig: RigKnowledge, parameters: Parameters) -> dict[str, float]:
    """Return the parameters with which identification goes on from `rig`.

    Correlations are left out: a parameter file has no place for them.
    """
    now = parameters.as_dict()
    learned: dict[str, float] = {}
    for what, value in rig.values.items():
        mean_name, sd_name = _NAMES[what]
        if not value.sd:
            continue
        # The friction is known as a whole; of the others what their parameter leaves.
        before = 0.0 if what == "friction" else _number(now[mean_name])
        learned[mean_name] = before + value.mean
        learned[sd_name] = value.sd
    if rig.motion_share < 1.0:
        learned["surface.motion_sd"] = rig.motion_share * _number(now["surface.motion_sd"])
    return learned


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)


def parameter_text(parameters: Parameters) -> str:
    """Return a parameter file with what is not at its default."""
    defaults = Parameters().as_dict()
    nested: dict[str, dict[str, object]] = {}
    for name, value in parameters.as_dict().items():
        if value != defaults[name]:
            group, _, own = name.partition(".")
            nested.setdefault(group, {})[own] = value
    return yaml.safe_dump({"/**": {"ros__parameters": nested}}, sort_keys=False)
