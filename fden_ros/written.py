# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers as a person writes them."""

from __future__ import annotations

import math

#: Magnitudes within these are written out, others by a power of ten.
_SMALL, _LARGE = 1e-5, 1e7


def written(value: float, digits: int) -> str:
    """Return a number with some significant digits and separated thousands: 2,620 for 2619.7."""
    if not _SMALL <= abs(value) < _LARGE:  # none of 0, and of what is not finite
        return f"{value:.{digits}g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, places):,.{max(places, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def quantity(value: float, unit: str, *, up: bool = False) -> str:
    """Return a quantity with two digits, by a prefix of its unit where it is small."""
    if value == 0.0:
        return f"0 m{unit}"
    prefixes = {"": 0.5, "m": 0.5e-4, "µ": 0.5e-7, "n": 0.0}
    prefix = next(name for name, least in prefixes.items() if abs(value) >= least)
    size = value * 10.0 ** (3 * list(prefixes).index(prefix))
    if up:
        step = 10.0 ** (math.floor(math.log10(size)) - 1)
        size = step * math.ceil(size / step - 1e-9)
    return f"{written(size, 2)} {prefix}{unit}"
