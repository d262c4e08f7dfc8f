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

"""Compliance of tool and robot in series with the tissue, from presses on something rigid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.rigid import Press

#: A compliance is stated as such up to this relative deviation: 10 % are then 2.5 deviations.
_LARGEST_SHARE = 0.04
#: Least deviation, relative, in the file: a tool bends differently at other places.
_LEAST_SHARE = 0.02
_MOTION = (
    "press a rigid plate twice, slowly, to the largest force of your presses, and in the same "
    "recording press tissue (or say that the recording is of a rigid plate: --rigid)"
)


def compliance_finding(presses: Sequence[Press]) -> Finding:
    """Return the compliance, or its bound where it is too small to measure."""
    subject = "compliance"
    if not presses:
        return unknown(subject, "no press on something rigid was seen", _MOTION)
    values = np.array([press.compliance for press in presses])
    sds = np.array([press.compliance_sd for press in presses])
    weights = 1.0 / sds**2
    value = float(weights @ values / weights.sum())
    sd = math.sqrt(1.0 / float(weights.sum()))
    chi = float(np.sum(((values - value) / sds) ** 2)) / max(len(presses) - 1, 1)
    sd *= math.sqrt(max(chi, 1.0))
    seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
    count = f"{len(presses)} presses in which the displacement is a line of the force"
    if sd > _LARGEST_SHARE * abs(value):
        limit = max(value, 0.0) + 2.0 * sd
        return Finding(
            subject,
            True,
            max(value, 0.0),
            sd,
            "m/N",
            seconds,
            f"too small to measure: below {1e3 * limit:.2g} mm/N, by {count}",
            parameters={
                "displacement.compliance": round(max(value, 0.0), 9),
                "displacement.compliance_sd": round(max(sd, 1e-7), 9),
            },
        )
    if value < 0.0:
        return unknown(
            subject, f"the probe goes back as the force rises, by {count}: not one axis", _MOTION
        )
    return Finding(
        subject,
        True,
        value,
        sd,
        "m/N",
        seconds,
        count,
        parameters={
            "displacement.compliance": float(f"{value:.5g}"),
            "displacement.compliance_sd": float(f"{max(sd, _LEAST_SHARE * value):.3g}"),
        },
    )
