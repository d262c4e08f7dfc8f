# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A testing machine's recording: it begins at the touch, tared, with a known specimen.

It has no air, so it shows neither the force's bias nor the contact point. The bias is 0, by the
machine's tare, and the contact point is the first sample's displacement. This applies where
the preamble states a specimen, or with ``--from-touch``; it is never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from fden_ros.parameters import Parameters, Value
from fden_ros.recording.headings import factor_of
from fden_ros.recording.table import TableReader

#: A machine presses harder than a robot may: the largest of them have 600 kN.
_PLAUSIBLE_FORCE = 1e6
#: A table seems to begin at the touch where its force is 0 before the probe has moved, within
#: this part of the largest, and where at this part of the path it has this part, and this many
#: deviations: a tenth of the path is 3 % of a sphere's force, .5 % where the tissue stiffens.
_AT_REST, _AT_ZERO, _WAY, _RISEN, _RISEN_SD = 0.01, 0.01, 0.1, 0.005, 4.0
#: Fewer rows show nothing; medians are over this many.
_LEAST_ROWS, _MEDIAN = 12, 5
_SIZE = re.compile(
    r"(?P<name>[^\W\d_][^\d:=;,\t]*?)[\s\"]*(?:[(\[]\s*(?P<before>[^)\]\d]+\d?)\s*[)\]])?"
    r"[\s\":=;,\t]+(?P<number>\d+(?:[.,]\d+)?)[\s\";,\t(\[]*(?P<unit>[^\W\d_]+[²2]?)?"
)
_FACE = ("indenter", "probe", "punch", "tip", "stempel", "anvil")
_WORDS = {
    "area": ("area", "cross section", "fläche", "querschnitt"),
    "diameter": ("diameter", "durchmesser", "dia"),
    "thickness": ("height", "thickness", "höhe", "dicke"),
}


def machine_values(
    table: TableReader, parameters: Parameters, from_touch: bool | None
) -> tuple[dict[str, Value], tuple[str, ...], tuple[str, ...]]:
    """Return values of parameters that a table states, a line on each, and open questions.

    Parameters that are already configured stay. `from_touch` states whether the table begins at
    the touch, tared; None: as its preamble states.
    """
    sizes = sizes_of(table.layout.preamble)
    values = _unstated(sizes, parameters)
    lines = [f"{_shown(values)}, by the preamble"] if values else []
    way = table.displacement[~np.isnan(table.displacement)]
    core = parameters.core
    is_default = core.contact_point is None and core.contact.measure_bias
    may_begin = (
        from_touch is None and is_default and not core.is_continuous and _begins_at_touch(table)
    )
    if way.size and (from_touch or (may_begin and "thickness" in sizes)):
        sign = -1.0 if parameters.displacement.inverted else 1.0
        most = max(core.plausibility.most_force, _PLAUSIBLE_FORCE)
        touched: dict[str, Value] = {
            "origin.source": "given",
            "origin.displacement": sign * float(way[0]),
            "force.measure_bias": False,
            "plausibility.max_force": most,
        }
        why = "by --from-touch" if from_touch else "because of the specimen before the headings"
        return {**values, **touched}, (*lines, f"{_shown(touched)}, {why}"), ()
    question = (
        f"the force in {table.path.name} changes as soon as the probe moves: if it begins at the "
        "touch, give --from-touch; if friction, a cable or a drape pulls on the tool, free it; "
        "otherwise give --no-from-touch"
    )
    return values, tuple(lines), (question,) if may_begin else ()


def _begins_at_touch(table: TableReader) -> bool:
    """Return whether the force grows from zero as soon as the probe moves."""
    both = ~np.isnan(table.force) & ~np.isnan(table.displacement)
    if np.count_nonzero(both) < _LEAST_ROWS:
        return False
    way = np.abs(table.displacement[both] - table.displacement[both][0])
    force = table.force[both]
    most = float(np.abs(force).max())
    until = int(np.argmax(way > _WAY * way.max()))
    before = force[:until][way[:until] <= _AT_REST * way.max()]
    if before.size == 0 or abs(float(np.median(before))) > _AT_ZERO * most:
        return False
    risen = abs(float(np.median(force[until : until + _MEDIAN]) - np.median(before)))
    return risen > max(_RISEN * most, _RISEN_SD * float(before.std()))


def _unstated(sizes: dict[str, float], parameters: Parameters) -> dict[str, Value]:
    """Return the sizes that a preamble states where the configuration has none."""
    geometry = parameters.geometry
    if geometry.kind != "flat_punch":
        return {}
    area = sizes.get("area") or area_of(sizes.get("diameter", 0.0))
    values: dict[str, Value] = {}
    if area and not geometry.area:
        values["geometry.area"] = area
    if "thickness" in sizes and not geometry.thickness:
        values["geometry.thickness"] = sizes["thickness"]
    return values


def area_of(diameter: float) -> float:
    """Return the area [m^2] of a circle of that diameter [m]."""
    return 0.25 * math.pi * diameter**2


def sizes_of(preamble: Sequence[str]) -> dict[str, float]:
    """Return area [m^2], diameter and thickness [m] of a preamble; an indenter's count."""
    matches = [match for line in preamble for match in _SIZE.finditer(line)]
    matches.sort(key=lambda match: any(word in match["name"].lower() for word in _FACE))
    found = {}
    for match in matches:
        name = match["name"].lower()
        size = next((size for size, words in _WORDS.items() if _has(name, words)), None)
        unit = match["unit"] or match["before"]
        if size is None or unit is None:
            continue
        factor = factor_of("area" if size == "area" else "displacement", unit)
        if factor is not None:
            found[size] = factor * float(match["number"].replace(",", "."))
    return found


def _has(name: str, words: Sequence[str]) -> bool:
    return any(re.search(rf"(?<!\w){word}(?!\w)|\w{{4,}}{word}$", name) for word in words)


def _shown(values: dict[str, Value]) -> str:
    """Return values as they would be set."""
    return ", ".join(
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {str(value).lower()}"
        for name, value in values.items()
    )
