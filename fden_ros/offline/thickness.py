# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The cost of treating a layer as a thick tissue, or as a column: in one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from fden_ros.core.law import FlatPunch, Geometry, Sphere, hayes_factor
from fden_ros.core.plausibility import UNKNOWN_AREA
from fden_ros.written import quantity

#: Up to this error a tissue counts as thick [1].
_GOOD = 1.1
#: The shown change of the thickness: 2 mm, or this part of it where that is less [m, 1].
_CHANGE, _PART = 2e-3, 0.3
#: Hayes' factor applies up to this radius over the thickness [1].
_WIDEST = 4.0


def assumed(geometry: Geometry, deepest: float = 0.0) -> str:
    """Return the assumption about the layer, and its cost at the largest indentation [m].

    Empty for a stated layer that is no thinner than the contact is wide: it needs no assumption.
    """
    if geometry.is_stated and isinstance(geometry, Sphere) and math.isinf(geometry.thickness):
        return _of_sphere(geometry, deepest)
    if not isinstance(geometry, FlatPunch) or geometry.poisson_ratio is not None:
        return ""
    is_wide = 2.0 * geometry.probe_radius > geometry.thickness
    is_known = geometry.is_stated and geometry.area < UNKNOWN_AREA
    return _of_face(geometry) if is_wide and is_known else ""


def _of_sphere(sphere: Sphere, deepest: float) -> str:
    layer, shown = replace(sphere, thickness=sphere.radius), 2.0 * sphere.radius
    from scipy.optimize import brentq  # takes 0.2 s to import, and few probes need it

    ratio = float(brentq(lambda u: _raised(layer, u * layer.thickness) - _GOOD, 1e-9, 1.0))
    words = (
        "geometry.thickness is not stated, so the tissue counts as thick. On a rigid base this "
        f"is right to {100.0 * (_GOOD - 1.0):.0f} % up to an indentation of {ratio:.2g} h^2/R, "
        f"which is {quantity(ratio * shown**2 / sphere.radius, 'm')} for a thickness h of "
        f"{quantity(shown, 'm')}"
    )
    if deepest <= 0.0:
        return words
    least = quantity(math.sqrt(sphere.radius * deepest / ratio), "m")
    words += f"; the {quantity(deepest, 'm')} that was reached needs a thickness of {least}; at "
    return words + _around(shown, lambda h: _raised(replace(sphere, thickness=h), deepest))


def _of_face(punch: FlatPunch) -> str:
    def raised(thickness: float) -> float:
        ratio = min(punch.probe_radius / thickness, _WIDEST)
        return 2.0 * hayes_factor(ratio, 0.5, is_bonded=punch.is_bonded) / (0.75 * math.pi * ratio)

    return (
        "the face is wider than the tissue is thick and geometry.hayes is false, so G is that of "
        "a column with free sides. If the tissue is a layer that continues around the face, set "
        f"geometry.hayes: without it, at {_around(punch.thickness, raised)}"
    )


def _raised(layer: Sphere, depth: float) -> float:
    """Return the ratio of the force on a layer to that on a thick tissue [1]."""
    compression = min(depth, layer.thickness) / layer.radius
    return layer.strain(compression) / compression**layer.exponent


def _around(thickness: float, factor: Callable[[float], float]) -> str:
    change = min(_CHANGE, _PART * thickness)
    here, more, less = (f"{factor(thickness + by):.2g}" for by in (0.0, change, -change))
    times, by = f"G comes out {here} times too large", quantity(change, "m")
    return f"{quantity(thickness, 'm')}, {times} ({more} if {by} thicker, {less} if {by} thinner)"
