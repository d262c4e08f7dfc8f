# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Mass and centre of the tool, from orientations in the air.

A tool of mass m on the sensor shows as :math:`F = m R^T g + b`, with the orientation R of the
sensor, gravity g and the bias b; with the lever c of its centre of mass it twists by
:math:`c \times m R^T g`. Both are linear in what is unknown, which least squares over the turns
find, together with a drift, and with the delay of the poses behind the force. Where the poses are
of another frame than the sensor, :math:`F = M R^T e + b` with M a rotation times the weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.session import Mask, runs
from fden_ros.configure.statistics import noise_of
from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import Solution, linear
from fden_ros.parameters import Value

GRAVITY = 9.80665
#: The tool turns above this rate [rad/s]; rests between turns of up to 2 s count as turning.
_TURNING = 0.05
_REST = 2.0
#: Step in which turning is looked for, and what is left out at the ends of a stretch [s].
_STEP = 0.1
#: The delay of the poses is solved for in this many steps of Gauss and Newton.
_STEPS = 4
#: The mass is claimed from this relative deviation on: 2 % are then 2.5 deviations.
_LARGEST_PART = 0.008
#: A fit holds where it leaves less than 2.5 deviations of noise, or 3 % of the weight.
_MOST_NOISE = 2.5
_MOST_PART = 0.03
#: Gravity is upright within this angle [rad] or 3 deviations.
_UPRIGHT = math.radians(2.0)
#: Rate of a turn [rad/s] that the poses are interpolated in.
_USUAL_RATE = 1.0
#: The largest angle between orientations that is enough [rad].
_LEAST_TURN = math.radians(40.0)
#: Scatter of the orientations [1] below which all turns are about one axis: the weight along
#: it cannot be told from the bias. Turns by 28 degrees about a second axis give this much.
_LEAST_SPREAD = 0.02
#: Below this one, half a degree of wobble, least squares have no solution of their own.
_NO_SPREAD = 1e-5
#: The driver has taken the weight off if less than this is left [N], or less than 5 deviations.
_TAKEN_OFF = 0.05
#: The centre of mass is claimed up to this deviation [m].
_LARGEST_CENTRE = 0.005


@dataclass(frozen=True)
class Weight:
    """The tool's weight as the sensor shows it, in units of the recorded force.

    Parameters
    ----------
    matrix : Array
        M: force of the weight is ``matrix @ R.T @ down``, with `down` in the poses' frame (3, 3).
    down : Array
        Unit vector in the poses' frame along which the shown weight points (3,).
    weight, weight_sd : float
        Its size.
    turned_by : float
        Angle between sensor and poses [rad]; 0: the poses are the sensor's orientation.
    delay, delay_sd : float
        Of the poses' stamps behind the force's [s].
    left : float
        What the fit leaves, root mean square.
    seconds : tuple
    holds : bool
        Whether the weight explains the force in the turns.
    centre, centre_sd : Array, float
        Of mass in the sensor's frame [m]; infinite without torques.
    """

    matrix: Array
    down: Array
    weight: float
    weight_sd: float
    turned_by: float
    delay: float
    delay_sd: float
    left: float
    seconds: Seconds
    holds: bool
    centre: Array
    centre_sd: float = math.inf

    @property
    def is_clear(self) -> bool:
        """Whether the turns show more than a trace of it."""
        return self.holds and self.weight > 20.0 * self.weight_sd

    def load(self, streams: Streams) -> Array | None:
        """Return the force of the weight at the force's stamps (n, 3)."""
        turn = streams.rotation_at(streams.force_times + self.delay)
        if turn is None or not self.holds:
            return None
        return np.asarray(turn.inv().apply(self.down) @ self.matrix.T)


@dataclass(frozen=True)
class _Turns:
    """Samples in the turns of all recordings."""

    streams: Sequence[Streams]
    masks: Sequence[Mask]

    def rotations(self, delay: float = 0.0) -> Rotation:
        parts = [s.rotation_at(s.force_times[m] + delay) for s, m in self._pairs()]
        return Rotation.concatenate([part for part in parts if part is not None])

    def force(self) -> Array:
        return np.concatenate([s.force[m] for s, m in self._pairs()])

    def torque(self) -> Array | None:
        parts = [s.torque[m] for s, m in self._pairs() if s.torque is not None]
        return np.concatenate(parts) if len(parts) == len(self.masks) else None

    def noise(self) -> float:
        return float(np.mean([noise_of(s.force_times, s.force).mean() for s in self.streams]))

    def without_drift(self, values: Array) -> Array:
        """Return values (n, ...) less a bias and a drift of every recording."""
        parts, first = [], 0
        for streams, mask in self._pairs():
            times = streams.force_times[mask]
            basis = np.linalg.qr(np.stack([np.ones(times.size), times - times.mean()], axis=1))[0]
            part = values[first : first + times.size]
            parts.append(part - np.tensordot(basis, np.tensordot(basis.T, part, 1), 1))
            first += times.size
        return np.concatenate(parts)

    def seconds(self) -> Seconds:
        return tuple(
            (float(s.force_times[a] - s.start), float(s.force_times[b - 1] - s.start))
            for s, mask in self._pairs()
            for a, b in runs(mask)
        )

    def lack(self) -> str:
        """Return in words what the orientations lack to tell a weight; empty: nothing."""
        if not self.streams:
            return "the tool did not turn in the air"
        turns = self.rotations()
        some = turns[:: max(len(turns) // 60, 1)]
        largest = max(float((some * one.inv()).magnitude().max()) for one in some)
        if largest < _LEAST_TURN:
            return f"the tool turned by {math.degrees(largest):.0f} degrees only"
        axis, spread = _one_axis(turns)
        if spread > _LEAST_SPREAD:
            return ""
        along = ", ".join(f"{v:.1f}" for v in axis + 0.0)
        return f"all turns were about one axis, ({along}) in the frame of the poses"

    def _pairs(self) -> list[tuple[Streams, Mask]]:
        return list(zip(self.streams, self.masks, strict=True))


def _turns_of(recordings: Sequence[Streams]) -> _Turns:
    """Return the turns of those recordings that have any."""
    seen = [(one, _turning(one)) for one in recordings if one.force.shape[1] == 3]
    seen = [(one, mask) for one, mask in seen if mask.sum() >= 20]
    return _Turns([one for one, _ in seen], [mask for _, mask in seen])


def _turning(streams: Streams) -> Mask:
    grid = np.arange(streams.start, streams.end, _STEP)
    mask = np.zeros(streams.force_times.size, dtype=bool)
    if streams.orientation is None or grid.size < 3:
        return mask
    stretches: list[list[int]] = []
    for a, b in runs(streams.turn_rates(grid) > _TURNING):
        if stretches and (a - stretches[-1][1]) * _STEP < _REST:
            stretches[-1][1] = b
        else:
            stretches.append([a, b])
    for a, b in stretches:
        if (b - a) * _STEP >= 0.5:
            low, high = grid[a] + _STEP, grid[b] - _STEP
            mask |= (streams.force_times >= low) & (streams.force_times <= high)
    return mask


def _one_axis(turns: Rotation) -> tuple[Array, float]:
    """Return the axis that the turns move least, in the poses' frame, and its scatter.

    A direction v of the poses' frame is seen from the tool as ``R.T v``; the scatter is the mean
    square of that less its mean, 0 where all turns are about v.
    """
    mean = turns.as_matrix().mean(axis=0)
    sizes, axes = np.linalg.eigh(np.eye(3) - mean @ mean.T)
    axis = axes[:, 0] * math.copysign(1.0, axes[np.argmax(np.abs(axes[:, 0])), 0])
    return axis, float(sizes[0])


def find_weight(recordings: Sequence[Streams]) -> Weight | None:
    """Fit the tool's weight to the turns in the air; None where the tool does not turn."""
    turns = _turns_of(recordings)
    lack = turns.lack()
    if lack and (not lack.startswith("all") or _one_axis(turns.rotations())[1] < _NO_SPREAD):
        return None
    aligned, free = _fit(turns, _aligned_columns), _fit(turns, _free_columns)
    # The poses are the sensor's where a rotation of its own explains hardly more.
    better = (aligned.fit.rms / max(free.fit.rms, 1e-300)) ** 2 - 1.0
    size = float(np.linalg.norm(aligned.values))
    is_aligned = better < 60.0 / len(turns.force()) + 1e-3 or aligned.fit.rms < 0.004 * size
    found = _as_aligned(turns, aligned) if is_aligned else _as_turned(turns, free)
    # Lines between the poses miss this part of a turn.
    step = max(float(np.median(np.diff(one.motion_times))) for one in turns.streams)
    sd = math.hypot(found.weight_sd, found.weight * (step * _USUAL_RATE) ** 2 / 8.0)
    limit = max(_MOST_NOISE * turns.noise(), _MOST_PART * found.weight)
    found = replace(found, weight_sd=sd, holds=found.left < limit)
    return _with_centre(turns, found) if found.is_clear else found


def _aligned_columns(turns: Rotation) -> Array:
    """Return the design of F = R.T w in three components, (n, 3, 3)."""
    return np.swapaxes(turns.as_matrix(), 1, 2)


def _free_columns(turns: Rotation) -> Array:
    """Return the design of F = M u with u = R.T (-z), (n, 3, 9)."""
    down = turns.inv().apply([0.0, 0.0, -1.0])
    return np.einsum("ij,nk->nijk", np.eye(3), down).reshape(-1, 3, 9)


class _Solved(NamedTuple):
    """A model fitted to the turns, with the delay as one more unknown, the last."""

    fit: Solution
    delay: float

    @property
    def values(self) -> Array:
        """What is sought without the delay (p,)."""
        return self.fit.values[:-1]


def _fit(turns: _Turns, columns: Callable[[Rotation], Array]) -> _Solved:
    """Fit a linear model of the force, and the delay of the poses with it."""
    force = turns.without_drift(turns.force())
    delay, step = 0.0, 1e-3
    for _ in range(_STEPS):
        design = columns(turns.rotations(delay))
        ahead = columns(turns.rotations(delay + step))
        slope = (ahead - design) @ _solved(turns, design, force).values / step
        found = _solved(turns, np.concatenate([design, slope[:, :, None]], axis=2), force)
        delay += float(found.values[-1])
    return _Solved(found, delay)


def _solved(turns: _Turns, design: Array, values: Array) -> Solution:
    """Fit values (n, 3) by columns (n, 3, p), component after component."""
    flat = turns.without_drift(design).swapaxes(0, 1).reshape(-1, design.shape[2])
    return linear(flat, values.T.reshape(-1))


def _as_aligned(turns: _Turns, found: _Solved) -> Weight:
    """Return the weight of a sensor whose orientation the poses are."""
    size = float(np.linalg.norm(found.values))
    down = found.values / max(size, 1e-300)
    along = math.sqrt(float(down @ found.fit.covariance[:3, :3] @ down))
    across = float(np.mean(found.fit.sds[:3]))
    upright = np.array([0.0, 0.0, math.copysign(1.0, down[2])])
    angle = math.acos(min(abs(float(down[2])), 1.0))
    if angle < max(_UPRIGHT, 3.0 * across / max(size, 1e-300)):
        down = upright
    # What lies across adds to the length, by half its square.
    sd = math.hypot(along, across**2 / max(size, 1e-300))
    return _weight(turns, found, np.eye(3) * size, down, size, sd)


def _as_turned(turns: _Turns, found: _Solved) -> Weight:
    """Return the weight of a sensor that is turned against the poses."""
    matrix = found.values.reshape(3, 3)
    left, sizes, right = np.linalg.svd(matrix)
    size, sd = float(np.mean(sizes)), float(np.sqrt(np.mean(found.fit.sds[:9] ** 2)))
    turn = left @ right * (float(np.sign(np.linalg.det(left @ right))) or 1.0)
    weight = _weight(turns, found, matrix, np.array([0.0, 0.0, -1.0]), size, sd)
    # A weight turns as a whole: other stretches in different directions are something else.
    is_whole = float(np.ptp(sizes)) < max(8.0 * sd, 0.05 * size)
    return replace(
        weight,
        turned_by=float(Rotation.from_matrix(turn).magnitude()),
        left=weight.left if is_whole else math.inf,
    )


def _weight(
    turns: _Turns, found: _Solved, matrix: Array, down: Array, size: float, sd: float
) -> Weight:
    delay_sd, left = float(found.fit.sds[-1]), found.fit.rms
    nowhere = np.full(3, np.nan)
    return Weight(
        matrix, down, size, sd, 0.0, found.delay, delay_sd, left, turns.seconds(), True, nowhere
    )


def _with_centre(turns: _Turns, weight: Weight) -> Weight:
    torque = turns.torque()
    if torque is None:
        return weight
    force = turns.rotations(weight.delay).inv().apply(weight.down) @ weight.matrix.T
    # c x F is the sum of c_j (e_j x F).
    columns = np.stack([np.cross(axis, force) for axis in np.eye(3)], axis=2)
    found = _solved(turns, columns, turns.without_drift(torque))
    centre = found.values
    # A weight that is off moves the centre along its own direction by the same part.
    moved = float(np.linalg.norm(centre)) * weight.weight_sd / weight.weight
    sd = math.hypot(math.sqrt(float(np.mean(np.diag(found.covariance)))), moved)
    return replace(weight, centre=centre, centre_sd=sd)


def weight_findings(
    weight: Weight | None, recordings: Sequence[Streams]
) -> tuple[Finding, Finding]:
    """Return what to say of mass and centre; the force is in newtons."""
    if weight is None or not weight.holds:
        return _unknown(weight, recordings)
    size, sd = weight.weight, weight.weight_sd
    mass, mass_sd = size / GRAVITY, sd / GRAVITY
    if size < max(5.0 * sd, _TAKEN_OFF):
        limit = size + 2.0 * sd
        evidence = f"less than {limit:.2g} N goes with the turns: the driver subtracts it"
        none = Finding(
            "tool mass",
            0.0,
            limit / GRAVITY / 2.0,
            evidence,
            weight.seconds,
            parameters={"tool.mass": 0.0},
        )
        nothing = "nothing: there is no weight to subtract"
        return none, unknown("tool centre of mass", evidence, nothing)
    if mass_sd > _LARGEST_PART * mass:
        return _unknown(weight, recordings)
    if weight.turned_by > 0.0:
        turned = math.degrees(weight.turned_by)
        evidence = (
            f"the poses are not the sensor's orientation, which is turned by {turned:.1f} degrees "
            "against them: the weight can be subtracted only if the poses are the sensor's"
        )
        found = Finding("tool mass", mass, mass_sd, evidence, weight.seconds)
        motion = "record the pose of the sensor's own frame"
        return found, unknown("tool centre of mass", evidence, motion)
    gravity = [round(float(v), 4) for v in GRAVITY * weight.down]
    evidence = f"least squares over the turns leave {weight.left:.2g} N of {size:.3g} N"
    values: dict[str, Value] = {"tool.mass": round(mass, 5), "tool.gravity": gravity}
    found = Finding("tool mass", mass, mass_sd, evidence, weight.seconds, parameters=values)
    return found, _centre_finding(weight)


def _centre_finding(weight: Weight) -> Finding:
    if weight.centre_sd > _LARGEST_CENTRE:
        return unknown("tool centre of mass", "the torques do not tell the centre within 5 mm")
    centre = tuple(float(v) for v in weight.centre)
    return Finding(
        "tool centre of mass",
        centre,
        weight.centre_sd,
        "from the torques in the same turns",
        weight.seconds,
        parameters={"tool.centre_of_mass": [round(v, 5) for v in centre]},
    )


def _unknown(weight: Weight | None, recordings: Sequence[Streams]) -> tuple[Finding, Finding]:
    """Say why mass and centre are not known, and what would tell them."""
    why, motion = _turns_of(recordings).lack(), ""
    if all(one.orientation is None for one in recordings):
        why = "the recording holds no orientation of the tool"
    elif weight is not None and not weight.holds:
        why = (
            f"while it turned, the force does not follow from a weight: {weight.left:.2g} N are "
            "left; was it in contact?"
        )
    elif weight is not None:
        mass, sd = weight.weight / GRAVITY, weight.weight_sd / GRAVITY
        why = f"{mass:.3g} ± {sd:.2g} kg is too uncertain" + (f": {why}" if why else "")
    if "about one axis" in why:
        motion = (
            "turn the tool in the air about another axis, across that one, by 60 degrees, too, "
            "slowly, with a second of rest"
        )
    why = why or "the turns show nothing"
    return unknown("tool mass", why, motion), unknown("tool centre of mass", why, motion)
