# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether what is measured can be what its units say: m, N, s and the sizes of the geometry.

A recording in mm, g or ms gives numbers that look like any others. This module reports values that
no tissue under a probe has, with the factor that would make them plausible.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from fden_ros.core.arrays import LIKELY, NOT_BY_CHANCE
from fden_ros.core.contact import SMALL, Onset
from fden_ros.core.estimation import Prior
from fden_ros.core.law import FlatPunch, Geometry, elastic_response
from fden_ros.core.parameter import TINY, parameter
from fden_ros.core.streams import BRIEF_NS, NANOSECONDS, USUAL_SAMPLES, StreamGuard
from fden_ros.written import written


@dataclass(frozen=True)
class PlausibilityConfig:
    """Limits of a contact in the right units."""

    most_force: float = parameter(
        "plausibility.max_force",
        200.0,
        "flat_punch, sphere: a contact with more force is implausible, and never converges.",
        "N",
        TINY,
        1e9,
    )
    #: A press strained slower than this and sampled slower than 2 Hz is implausible; 0: any is
    #: plausible [1/s].
    least_strain_rate: float = 0.001


#: Largest sizes, the unit that may have been meant, and its factor: of a face of 14 cm, a body, a
#: ball of 20 cm.
_MOST_SIZES = {
    "area": (0.02, "m^2", "cm^2", 1e-4),
    "thickness": (0.3, "m", "cm", 1e-2),
    "radius": (0.1, "m", "cm", 1e-2),
}
#: Area that stands for an unknown one [m^2]: the stress is in newtons.
UNKNOWN_AREA = 1.0
#: G lies within 5 standard deviations of its prior, or this factor where they are less, for any Gn
#: that is likely.
_PRIOR_FACTOR = 30.0
#: A contact is judged before its end from this strain on, which a press usually has: below it the
#: origin matters.
_LEAST_STRAIN = 0.05
#: A probe is tilted from this angle against the surface's normal [rad]; its cosine is 0.996.
_TILTED = math.radians(5.0)
#: No force sensor has samples closer than this [s].
_FASTEST_STEP = 5e-5
#: Likely values of a press, to choose a factor by: force [N], strain rate [1/s].
_LIKELY_FORCE, _LIKELY_RATE = (0.02, 50.0), (0.01, 100.0)

_LENGTHS = {"mm": 1e-3, "mm/10": 1e-4, "cm": 1e-2, "um": 1e-6}
_FORCES = {"g": 9.80665e-3, "mN": 1e-3}
_TIMES = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def stands_against(geometry: Geometry) -> str:
    """Return why no estimate with a geometry can be right, in one sentence; empty: it can."""
    if not geometry.is_stated:
        return (
            "the geometry is not stated, so nothing is converged: state probe and tissue in the "
            f"parameters, such as geometry: {{{geometry.example}}}, in m and m^2"
        )
    for name, (most, unit, other, factor) in _MOST_SIZES.items():
        value = getattr(geometry, name, 0.0)
        if most < value < math.inf and not (name == "area" and value >= UNKNOWN_AREA):
            return (
                f"geometry.{name} of {value:.3g} {unit} is implausible, so nothing is converged: "
                f"was {other} meant? With the factor {factor:g} it would be "
                f"{factor * value:.3g} {unit}"
            )
    return ""


class Tilt:
    """Counts touches of a tilted probe, and reports their cost."""

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._largest = 0.0
        self.count = 0  #: of those touches

    def see(self, tilt: float) -> None:
        """Add the angle between axis and normal at a touch [rad]."""
        self._largest = max(self._largest, tilt)
        self.count += tilt > _TILTED

    @property
    def words(self) -> str:
        """The tilt and its cost, in one sentence."""
        cost = f"only {math.cos(self._largest):.3f} of the motion along the tool is depth"
        if isinstance(self._geometry, FlatPunch):
            width = 2.0 * math.sqrt(self._geometry.area / math.pi)
            depth = width * math.tan(min(self._largest, 1.5))
            cost += f", and the flat face touches with its edge first, over {1e3 * depth:.1f} mm"
        return f"the probe was tilted by up to {math.degrees(self._largest):.0f} degrees: {cost}"


class Plausibility:
    """Judges contacts and streams."""

    def __init__(self, config: PlausibilityConfig, geometry: Geometry, prior: Prior) -> None:
        self._config, self._geometry, self._prior = config, geometry, prior
        #: Why no estimate can be right, as :func:`stands_against`; then no contact is judged.
        self.standing = stands_against(geometry)
        self._spread = max(NOT_BY_CHANCE * prior.linear_stiffness_log_sd, math.log(_PRIOR_FACTOR))
        self._words: dict[str, str] = {}
        #: Contacts that were found implausible, by the kind of reason.
        self.counts: Counter[str] = Counter()
        self._start_ns = 0
        self._step = 0.0
        self._judged_strain = 0.0
        self._kind = ""
        self._is_first = False

    @property
    def found(self) -> dict[str, int]:
        """What was implausible about contacts, the first of each kind in words, with counts."""
        return {words: self.counts[kind] for kind, words in self._words.items()}

    def begin(self, onset: Onset) -> None:
        """Begin with a contact."""
        samples = onset.samples
        self._start_ns = samples[0].stamp_ns
        whole = (samples[-1].stamp_ns - self._start_ns) / NANOSECONDS
        self._step = whole / max(len(samples) - 1, 1)
        self._judged_strain = 0.0
        self._kind = ""

    def is_implausible(
        self, stamp_ns: int, strain: float, force: float, stress: float, *, is_over: bool = False
    ) -> bool:
        """Judge a contact by its largest strain [1], force [N] and stress [Pa] until a stamp.

        An implausible one is judged again only when it `is_over`, for a better message.
        """
        if self.standing:
            return False
        if self._kind and not is_over:
            return True
        elapsed = (stamp_ns - self._start_ns) / NANOSECONDS
        for kind, words in (
            ("strain", self._of_strain(strain)),
            ("force", self._of_force(force)),
            ("rate", self._of_rate(strain, elapsed)),
            ("stiffness", self._of_stiffness(strain, stress, is_over=is_over)),
        ):
            if words:
                self._find(kind, words)
                break
        return bool(self._kind)

    def _find(self, kind: str, words: str) -> None:
        if self._kind:
            self.counts[self._kind] -= 1
            if self._is_first:
                del self._words[self._kind]
        self._kind, self._is_first = kind, kind not in self._words
        self.counts[kind] += 1
        self._words.setdefault(kind, words)

    def _of_strain(self, strain: float) -> str:
        most, geometry = self._geometry.most_strain, self._geometry
        if strain <= most:
            return ""
        depth, deepest = geometry.compression(strain), geometry.compression(most)
        suggested = _suggested(_LENGTHS, lambda f: geometry.strain(depth * f), _LEAST_STRAIN, most)
        if not suggested:
            factor = 10.0 ** -math.ceil(math.log10(depth / deepest))
            then = geometry.strain(depth * factor)
            suggested = f"another unit (factor {factor:.3g}: {written(then, 2)})"
        return (
            f"a contact reached a strain of {written(strain, 3)}, at most {written(most, 3)} is "
            f"plausible: is the displacement in {suggested}, not m? Or is the geometry wrong?"
        )

    def _of_force(self, force: float) -> str:
        most = self._config.most_force
        if force <= most or self._geometry.unit != "N":
            return ""
        suggested = _suggested(_FORCES, lambda f: force * f, *_LIKELY_FORCE)
        return (
            f"a contact reached {written(force, 3)} N, more than plausibility.max_force "
            f"({most:g} N): is the force in {suggested or 'N'}? If it is that large, set "
            f"plausibility.max_force to {10.0 ** math.ceil(math.log10(force)):g} in the parameter "
            "file"
        )

    def _of_rate(self, strain: float, elapsed: float) -> str:
        if 0.0 < self._step < _FASTEST_STEP:
            return too_fast(self._step)
        # It is judged anew when it has grown.
        if strain <= (1.0 + SMALL) * self._judged_strain or strain < _LEAST_STRAIN:
            return ""
        self._judged_strain = strain
        least = self._config.least_strain_rate
        if self._step < BRIEF_NS / NANOSECONDS or strain >= least * elapsed:
            return ""
        suggested = _suggested(_TIMES, lambda f: strain / elapsed / f, *_LIKELY_RATE)
        return (
            f"a strain of {strain:.2g} took {written(elapsed, 3)} s, slower than "
            f"{least:g} 1/s, and samples come every {self._step:.2g} s: is the time in "
            f"{suggested or 's'}?"
        )

    def _of_stiffness(self, strain: float, stress: float, *, is_over: bool) -> str:
        if strain <= (0.0 if is_over else _LEAST_STRAIN) or stress <= 0.0:
            return ""
        prior, g = self._prior, self._prior.linear_stiffness
        spread = LIKELY * prior.nonlinear_stiffness_log_sd
        middle = math.log(prior.nonlinear_stiffness)
        least, most = (
            math.log(stress / elastic_response(strain, g, math.exp(middle + one)).value)
            for one in (spread, -spread)
        )
        if least <= self._spread and most >= -self._spread:
            return ""
        ratio = math.exp(0.5 * (least + most))
        units, likely = {**_FORCES, "kN": 1e3}, (1.0 / _PRIOR_FACTOR, _PRIOR_FACTOR)
        suggested = _suggested(units, lambda f: ratio * f, *likely, is_shown=False)
        if ratio > 1.0 and strain < _LEAST_STRAIN:
            suggested = f"{suggested or 'N'}, or the displacement in m already (factor 1e3)"
        return (
            f"the stress at a strain of {strain:.2g} is some {written(ratio, 2)} times that of "
            f"prior.linear_stiffness: is the force in {suggested or 'N'}? If not, state the prior"
        )


def of_stream(name: str, guard: StreamGuard, limit: float) -> str:
    """Return what is implausible about a stream, `force` or `displacement`, in words; or empty.

    `limit` is that of its magnitude [N, m].
    """
    if guard.too_large > max(USUAL_SAMPLES, guard.usual.count):
        units = _FORCES if name == "force" else _LENGTHS
        unit = "N" if name == "force" else "m"
        words = " or ".join(f"{u} (factor {units[u]:.3g})" for u in list(units)[:2])
        return (
            f"most samples of the {name} are beyond {name}.limit ({limit:g} {unit}), up to "
            f"{written(guard.largest, 3)}: is it in {words}, not {unit}?"
        )
    if 2 * guard.too_close > max(USUAL_SAMPLES, guard.usual.count):
        return too_fast(guard.close_step)
    usual_step = guard.usual.value / NANOSECONDS
    if guard.usual.is_known and usual_step < _FASTEST_STEP:
        return too_fast(usual_step)
    return ""


def too_fast(step: float) -> str:
    """Return that samples come faster than a sensor measures, every `step` seconds."""
    return (
        f"samples come every {step:.2g} s, faster than a force sensor measures: is the time in s "
        f"already? With the factor 1e3 it would be every {1e3 * step:.2g} s"
    )


def _suggested(
    factors: dict[str, float],
    value: Callable[[float], float],
    low: float,
    high: float,
    *,
    is_shown: bool = True,
) -> str:
    """Return the units whose value is likely, each with its factor and, if shown, its value."""
    return " or ".join(
        f"{name} (factor {factor:.3g}" + (f": {value(factor):.2g})" if is_shown else ")")
        for name, factor in factors.items()
        if low <= value(factor) <= high
    )
