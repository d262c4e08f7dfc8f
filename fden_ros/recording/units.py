# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units as instruments write them, and their factors to SI."""

from __future__ import annotations

import re

_GRAVITY = 9.80665
_POUND = 4.4482216152605

#: What stands in brackets in a heading, as a unit does.
BRACKETED = re.compile(r"[(\[{<]\s*([^)\]}>]*?)\s*[)\]}>]")
#: By quantity: unit and its factor to s, N, m, Pa, a ratio.
UNITS: dict[str, dict[str, float]] = {
    "time": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "sek": 1.0,
        "sekunden": 1.0, "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
        "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
    },
    "force": {
        "N": 1.0, "pN": 1e-12, "nN": 1e-9, "uN": 1e-6, "mN": 1e-3, "cN": 1e-2, "dN": 0.1,
        "kN": 1e3, "MN": 1e6, "newton": 1.0, "newtons": 1.0, "millinewton": 1e-3,
        "millinewtons": 1e-3, "dyn": 1e-5, "g": 1e-3 * _GRAVITY, "gf": 1e-3 * _GRAVITY,
        "kg": _GRAVITY, "kgf": _GRAVITY, "kp": _GRAVITY, "lb": _POUND, "lbs": _POUND,
        "lbf": _POUND, "oz": _POUND / 16.0, "ozf": _POUND / 16.0,
    },
    "displacement": {
        "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "micron": 1e-6,
        "microns": 1e-6, "micrometer": 1e-6, "micrometers": 1e-6, "micrometre": 1e-6,
        "micrometres": 1e-6, "millimeter": 1e-3, "millimeters": 1e-3, "millimetre": 1e-3,
        "millimetres": 1e-3, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0,
        "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
    },
    "stress": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "psi": 6894.757293168},
    "strain": {
        "1": 1.0, "-": 1.0, "mm/mm": 1.0, "m/m": 1.0, "%": 0.01, "percent": 0.01, "pct": 0.01,
    },
    "area": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6, "in2": 0.0254**2},
}  # fmt: skip
#: Small letters alone would make torque of this a length.
_TORQUE = "Nm"
_SPELLING = str.maketrans("µμ²", "uu2", "^ ")
_BRACKETS = re.compile(r"[(\[{<]\s*(.*?)\s*[)\]}>]")


def spelled(unit: str) -> str:
    """Return a unit without brackets, its micro as u and its square as 2."""
    inner = _BRACKETS.fullmatch(unit.strip())
    text = inner[1] if inner else unit.strip()
    return text.translate(_SPELLING)


def factor_of(quantity: str, unit: str) -> float | None:
    """Return a unit's factor to SI, or None if it is no unit of that quantity."""
    known, text = UNITS[quantity], spelled(unit)
    if text in known:
        return known[text]
    if text == _TORQUE:
        return None
    small = {name.lower(): factor for name, factor in reversed(list(known.items()))}
    return small.get(text.lower())


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any quantity."""
    return any(factor_of(quantity, text) is not None for quantity in UNITS)
