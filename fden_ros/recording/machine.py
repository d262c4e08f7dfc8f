# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a testing machine's recording needs: it begins at the touch, tared, with a known specimen.

There is no air in it, so nothing of it tells the force's bias, nor where the tissue begins: the
bias is 0, by the machine's tare, and the strain origin is the first sample's displacement.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.parameters import Parameters, Value
from fden_ros.recording.table import Row, TableReader
from fden_ros.recording.text import numeral
from fden_ros.recording.units import factor_of

#: A machine presses harder than a robot may: the largest of them have 600 kN.
_PLAUSIBLE_FORCE = 1e6

#: A force has risen when it is this many deviations of its noise, and this part of the largest,
#: above its first ...
_RISE, _RISE_PART = 20.0, 0.01
#: ... and it has risen from the touch on if it had this part of that rise at half of the way:
#: half of it on what is linear, a third under a sphere, nothing after as much air as tissue.
_PART_AT_HALF = 0.2
#: A tared force begins within so many deviations of its noise, or this part of the largest, of 0.
_ZERO, _ZERO_PART = 5.0, 0.01
#: A probe that goes back behind its first place, by this part of its way, comes from the air.
_BEHIND = 0.02
#: The noise is that of the quietest 12 of the first 48 rows; of a force that rises fast the others
#: show the curve. The force must have risen within 20,000 rows, which is 40 s at 500 Hz.
_LEAST_ROWS, _NOISE_ROWS, _MOST_ROWS = 12, 48, 20_000

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
) -> tuple[dict[str, Value], tuple[str, ...]]:
    """Return values of parameters that a table needs, and a line on each that was found in it.

    What is configured otherwise is left alone.

    Parameters
    ----------
    table : TableReader
    parameters : Parameters
    from_touch : bool, optional
        Whether it begins at the touch, tared; None: as it looks.
    """
    values = _stated_sizes(table.layout.preamble, parameters)
    lines = [f"{_shown(values)}, by what stands before the headings"] if values else []
    is_touched = _is_default(parameters) if from_touch is None else from_touch
    if not is_touched:
        return values, tuple(lines)
    rows = list(islice(table.rows(), _MOST_ROWS))
    places = [row.displacement for row in rows if isinstance(row.displacement, float)]
    sign = -1.0 if parameters.displacement.inverted else 1.0
    signs = sign, -1.0 if parameters.force.inverted else 1.0
    if not places or (from_touch is None and not begins_at_touch(rows, signs)):
        return values, tuple(lines)
    touched: dict[str, Value] = {
        "origin.source": "given",
        "origin.displacement": sign * places[0],
        "force.measure_bias": False,
        "plausibility.max_force": max(parameters.core.plausibility.most_force, _PLAUSIBLE_FORCE),
    }
    why = "by --from-touch"
    if from_touch is None:
        why = "because the force rises from zero with the first motion (or --no-from-touch)"
    return {**values, **touched}, (*lines, f"{_shown(touched)}, {why}")


def begins_at_touch(rows: Sequence[Row], signs: tuple[float, float] = (1.0, 1.0)) -> bool:
    """Return whether the force rises from zero as soon as the probe moves: there is no air.

    Nor does the probe leave for the air later.

    Parameters
    ----------
    rows : sequence of Row
        The first of a recording.
    signs : (float, float)
        Of displacement and force, which are to grow as the probe presses.
    """
    way, force = _streams(rows)
    if force.size < _LEAST_ROWS:
        return False
    noise, largest = _noise(force[:_NOISE_ROWS]), float(np.abs(force).max())
    is_tared = abs(force[0]) <= max(_ZERO * noise, _ZERO_PART * largest)
    rise = max(_RISE * noise, _RISE_PART * largest)
    way, force = (sign * (v - v[0]) for sign, v in zip(signs, (way, force), strict=True))
    if way.min() < -_BEHIND * way.max():
        return False
    risen = np.flatnonzero(force > rise)
    if not (is_tared and risen.size):
        return False
    length = way[risen[0]]
    if length <= 0.0:
        return False
    # What the force was before the probe moved says nothing of the way.
    order = np.argsort(way[: risen[0] + 1], kind="stable")
    halfway = np.interp(0.5 * length, way[order], force[order])
    return bool(halfway > _PART_AT_HALF * rise)


def _is_default(parameters: Parameters) -> bool:
    """Return whether neither the origin nor the force's bias was configured."""
    return (
        not parameters.core.is_continuous
        and parameters.core.contact_point is None
        and parameters.core.contact.measure_bias
    )


def _streams(rows: Iterable[Row]) -> tuple[Array, Array]:
    """Return displacement [m] and force [N] at the rows of the force, shape (n,) each."""
    place: float | None = None
    found: list[tuple[float, float]] = []
    for row in rows:
        place = row.displacement if isinstance(row.displacement, float) else place
        if isinstance(row.force, float) and place is not None:
            found.append((place, row.force))
    way, force = np.array(found, dtype=float).reshape(-1, 2).T
    return way, force


def _noise(force: Array) -> float:
    """Return the noise of a force [N] from its second differences, which leave a slope out.

    Half a step of the reading, at least.
    """
    second = np.abs(np.diff(force, n=2))
    quietest = min(
        float(np.median(second[begin : begin + _LEAST_ROWS - 2]))
        for begin in range(0, second.size - _LEAST_ROWS + 3, _LEAST_ROWS)
    )
    scatter = 1.4826 * quietest / math.sqrt(6.0)
    steps = np.abs(np.diff(force))
    least = float(steps[steps > 0.0].min(initial=math.inf))
    return max(scatter, 0.5 * least if math.isfinite(least) else 0.0, 1e-9)


def _stated_sizes(preamble: Sequence[str], parameters: Parameters) -> dict[str, Value]:
    """Return the sizes that a preamble states where the configuration has none."""
    geometry = parameters.geometry
    if geometry.kind != "flat_punch" or (geometry.area and geometry.thickness):
        return {}
    found = dict(_sizes(preamble))
    sizes: dict[str, Value] = {}
    area = found.get("area")
    if area is None and "diameter" in found:
        area = area_of(found["diameter"])
    if area and not geometry.area:
        sizes["geometry.area"] = area
    if "thickness" in found and not geometry.thickness:
        sizes["geometry.thickness"] = found["thickness"]
    return sizes


def area_of(diameter: float) -> float:
    """Return the area [m^2] of a circle of that diameter [m]."""
    return 0.25 * math.pi * diameter**2


def _sizes(preamble: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield area [m^2], diameter and thickness [m]; those of an indenter come last, and count."""
    found = [match for line in preamble for match in _SIZE.finditer(line)]
    found.sort(key=lambda match: any(word in match["name"].lower() for word in _FACE))
    for match in found:
        name = match["name"].lower()
        size = next((size for size, words in _WORDS.items() if _has(name, words)), None)
        unit = match["unit"] or match["before"]
        if size is None or unit is None:
            continue
        factor = factor_of("area" if size == "area" else "displacement", unit)
        if factor is not None:
            yield size, factor * float(numeral(match["number"], "," if "," in match[0] else "."))


def _has(name: str, words: Iterable[str]) -> bool:
    return any(re.search(rf"(?<!\w){word}(?!\w)|\w{{4,}}{word}$", name) for word in words)


def _shown(values: dict[str, Value]) -> str:
    """Return values as they would be set."""
    return ", ".join(
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {str(value).lower()}"
        for name, value in values.items()
    )
