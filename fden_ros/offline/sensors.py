# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How well force and displacement are measured: what ``fden configure`` has written of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from fden_ros.errors import InputError
from fden_ros.parameters import Parameters
from fden_ros.planning.motion import Sensors

#: What ``fden configure`` writes of the streams, and the factor to SI units.
_MEASURED = re.compile(r"# (force|displacement) (noise|rate): ([\d.e+-]+)(?: ± \S+)? (\w+)")
_UNITS = {"N": 1.0, "Hz": 1.0, "m": 1.0, "mm": 1e-3, "um": 1e-6, "rad": 1.0}


def sensors_of(
    files: Sequence[Path],
    parameters: Parameters,
    noise: float = 0.0,
    rate: float = 0.0,
    displacement_noise: float = 0.0,
) -> Sensors:
    """Return the sensors of parameter files, or as stated: 0 is not.

    Raises
    ------
    InputError
        Where neither says noise and rate of the force.
    """
    found = {"force noise": parameters.core.contact.force_noise}
    for path in files:
        for stream, quantity, number, unit in _MEASURED.findall(path.read_text(encoding="utf-8")):
            found[f"{stream} {quantity}"] = float(number) * _UNITS.get(unit, 1.0)
    noise, rate = noise or found["force noise"], rate or found.get("force rate", 0.0)
    if not noise or not rate:
        raise InputError(
            "noise and rate of the force are not known: state --noise (standard deviation per "
            "sample, N) and --rate (Hz), or give the file that fden configure writes"
        )
    return Sensors(rate, noise, displacement_noise or found.get("displacement noise", 0.0))
