# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Mass of the tool, from orientations in the air.

A tool of mass m shows on the sensor as :math:`F = m R^T g + b`, with the orientation R of the
sensor, gravity g and the bias b. That is linear in the weight. Least squares over the turns
find it, together with a drift and with the delay of the poses behind the force. If the poses are
of another frame than the sensor, :math:`F = M R^T e + b` with M a rotation times the weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Mask, runs
from fden_ros.configure.streams import Streams, noise_of
from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import Solution, linear
from fden_ros.parameters import Value

GRAVITY = 9.80665
#: The tool turns above this rate [rad/s]; rests between turns of up to 2 s count as turning.
_TURNING, _REST = 0.05, 2.0
#: Step of the search for turns, and the margin at the ends of a stretch [s].
_STEP = 0.1
#: Steps of Gauss and Newton for the delay of the poses.
_STEPS = 4
#: The mass is claimed up to this relative deviation: 2 % are then 2.5 deviations.
_LARGEST_PART = 0.008
#: A fit holds with a residual below 2.5 deviations of noise, or 3 % of the weight.
_MOST_NOISE, _MOST_PART = 2.5, 0.03
#: Gravity is upright within this angle [rad] or 3 deviations.
_UPRIGHT = math.radians(2.0)
#: Rate of a turn [rad/s] that the poses are interpolated in.
_USUAL_RATE = 1.0
#: Sufficient largest angle between orientations [rad].
_LEAST_TURN = math.radians(40.0)
#: Scatter of the orientations [1] below which all turns are about one axis: the weight along
#: it cannot be separated from the bias. Turns by 28 degrees about a second axis give this much.
#: Below the second, half a degree of wobble, least squares have no solution of their own.
_LEAST_SPREAD, _NO_SPREAD = 0.02, 1e-5
#: The driver has subtracted the weight if less than this remains [N], or less than 5 deviations.
_SUBTRACTED = 0.05


@dataclass(frozen=True)
class Weight:
    """The tool's weight on the sensor, in units of the recorded force."""

    matrix: Array  #: the weight is ``matrix @ R.T @ down`` (3, 3)
    down: Array  #: unit vector along which it points, in the poses' frame (3,)
    size: float
    sd: float
    delay: float  #: of the poses' stamps behind the force's [s]
    delay_sd: float
    left: float  #: residual of the fit, root mean square
    holds: bool  #: whether it explains the force in the turns
    is_turned: bool  #: whether the poses are of another frame than the sensor's

    @property
    def is_clear(self) -> bool:
        """Whether the turns show more than a trace of it."""
        return self.holds and self.size > 20.0 * self.sd

    def load(self, streams: Streams) -> Array | None:
        """Return the force of the weight at the force's stamps (n, 3)."""
        turn = streams.rotation_at(streams.force_times + self.delay)
        if turn is None or not self.holds:
            return None
        return np.asarray(turn.inv().apply(self.down) @ self.matrix.T)


class _Turns:
    """Samples in the turns of those recordings that have any."""

    def __init__(self, recordings: Sequence[Streams]) -> None:
        seen = [(one, _turning(one)) for one in recordings if one.force.shape[1] == 3]
        self.parts = [(one, mask) for one, mask in seen if mask.sum() >= 20]

    def rotations(self, delay: float = 0.0) -> Rotation:
        turns = [s.rotation_at(s.force_times[mask] + delay) for s, mask in self.parts]
        return Rotation.concatenate([turn for turn in turns if turn is not None])

    def without_drift(self, values: Array) -> Array:
        """Return values (n, ...) less a bias and a drift of every recording."""
        parts, first = [], 0
        for streams, mask in self.parts:
            times = streams.force_times[mask]
            basis = np.linalg.qr(np.stack([np.ones(times.size), times - times.mean()], axis=1))[0]
            part = values[first : first + times.size]
            parts.append(part - np.tensordot(basis, np.tensordot(basis.T, part, 1), 1))
            first += times.size
        return np.concatenate(parts)

    def lack(self) -> tuple[str, float]:
        """Return what the orientations lack to show a weight, or nothing, and their scatter."""
        if not self.parts:
            return "the tool did not turn in the air, or no orientation of it was recorded", 0.0
        turns = self.rotations()
        some = turns[:: max(len(turns) // 60, 1)]
        largest = max(float((some * one.inv()).magnitude().max()) for one in some)
        if largest < _LEAST_TURN:
            return f"the tool turned by {math.degrees(largest):.0f} degrees only", 0.0
        # A direction v of the poses' frame is R.T v in the tool's frame. The scatter is its mean
        # square less its squared mean, 0 where all turns are about v.
        mean = turns.as_matrix().mean(axis=0)
        sizes, axes = np.linalg.eigh(np.eye(3) - mean @ mean.T)
        axis = axes[:, 0] * math.copysign(1.0, axes[np.argmax(np.abs(axes[:, 0])), 0])
        along = ", ".join(f"{v:.1f}" for v in axis + 0.0)
        words = f"all turns were about one axis, ({along}) in the frame of the poses"
        return "" if sizes[0] > _LEAST_SPREAD else words, float(sizes[0])


def _turning(streams: Streams) -> Mask:
    grid = np.arange(streams.start, streams.end, _STEP)
    mask = np.zeros(streams.force_times.size, dtype=bool)
    if streams.orientation is None or grid.size < 3:
        return mask
    turning = streams.turn_rates(grid) > _TURNING
    for a, b in runs(~turning):
        turning[a:b] = a > 0 and b < turning.size and (b - a) * _STEP < _REST
    for a, b in runs(turning):
        if (b - a) * _STEP >= 0.5:
            low, high = grid[a] + _STEP, grid[b] - _STEP
            mask |= (streams.force_times >= low) & (streams.force_times <= high)
    return mask


def find_weight(recordings: Sequence[Streams]) -> Weight | None:
    """Fit the tool's weight to the turns in the air; None where they do not show it."""
    turns = _Turns(recordings)
    why, spread = turns.lack()
    if why and spread < _NO_SPREAD:
        return None
    own, delay = _fit(turns, _own_columns)
    free, free_delay = _fit(turns, _free_columns)
    vector = own.values[:3]
    size = float(np.linalg.norm(vector))
    down = vector / max(size, 1e-300)
    # The poses are the sensor's where a rotation of its own hardly improves the fit.
    better = (own.rms / max(free.rms, 1e-300)) ** 2 - 1.0
    is_turned = better >= 60.0 / (own.residuals.size / 3) + 1e-3 and own.rms >= 0.004 * size
    if is_turned:
        found, delay, matrix = free, free_delay, free.values[:9].reshape(3, 3)
        sizes = np.linalg.svd(matrix)[1]
        size, sd = float(np.mean(sizes)), float(np.sqrt(np.mean(found.sds[:9] ** 2)))
        down = np.array([0.0, 0.0, -1.0])
        # A weight turns as a whole: stretches in different directions have another cause.
        is_whole = float(np.ptp(sizes)) < max(8.0 * sd, 0.05 * size)
    else:
        found, matrix, is_whole = own, size * np.eye(3), True
        along = math.sqrt(float(down @ found.covariance[:3, :3] @ down))
        across = float(np.mean(found.sds[:3])) / max(size, 1e-300)
        if math.acos(min(abs(float(down[2])), 1.0)) < max(_UPRIGHT, 3.0 * across):
            down = np.array([0.0, 0.0, math.copysign(1.0, down[2])])
        # A perpendicular part adds half its square to the length.
        sd = math.hypot(along, across**2 * size)
    # Lines between the poses miss a part of a turn.
    step = max(float(np.median(np.diff(one.motion_times))) for one, _ in turns.parts)
    sd = math.hypot(sd, size * (step * _USUAL_RATE) ** 2 / 8.0)
    noise = float(np.mean([noise_of(s.force_times, s.force).mean() for s, _ in turns.parts]))
    holds = is_whole and found.rms < max(_MOST_NOISE * noise, _MOST_PART * size)
    return Weight(matrix, down, size, sd, delay, float(found.sds[-1]), found.rms, holds, is_turned)


def _own_columns(turns: Rotation) -> Array:
    """Return the design of F = R.T w in three components, (n, 3, 3)."""
    return np.swapaxes(turns.as_matrix(), 1, 2)


def _free_columns(turns: Rotation) -> Array:
    """Return the design of F = M u with u = R.T (-z), (n, 3, 9)."""
    down = turns.inv().apply([0.0, 0.0, -1.0])
    return np.einsum("ij,nk->nijk", np.eye(3), down).reshape(-1, 3, 9)


def _fit(turns: _Turns, columns: Callable[[Rotation], Array]) -> tuple[Solution, float]:
    """Fit a linear model of the force with a step of the delay; return the delay [s] too."""
    force = turns.without_drift(np.concatenate([s.force[mask] for s, mask in turns.parts]))

    def solved(design: Array) -> Solution:
        flat = turns.without_drift(design).swapaxes(0, 1).reshape(-1, design.shape[2])
        return linear(flat, force.T.reshape(-1))

    delay, step = 0.0, 1e-3
    for _ in range(_STEPS):
        design, ahead = (columns(turns.rotations(late)) for late in (delay, delay + step))
        slope = (ahead - design) @ solved(design).values / step
        found = solved(np.concatenate([design, slope[:, :, None]], axis=2))
        delay += float(found.values[-1])
    return found, delay


def weight_finding(weight: Weight | None, recordings: Sequence[Streams]) -> Finding:
    """Return what to report of the mass; the force is in newtons."""
    why = _Turns(recordings).lack()[0]
    if weight is None:
        return unknown("tool mass", why)
    mass, sd = weight.size / GRAVITY, weight.sd / GRAVITY
    if not weight.holds:
        words = f"while it turned, {weight.left:.2g} N of the force do not fit a weight"
        return unknown("tool mass", f"{words}; was it in contact?")
    if weight.size < max(5.0 * weight.sd, _SUBTRACTED):
        limit = mass + 2.0 * sd
        evidence = f"less than {limit:.2g} kg follows the turns: the driver subtracts it"
        return Finding("tool mass", 0.0, limit / 2.0, evidence, parameters={"tool.mass": 0.0})
    if weight.is_turned:
        words = f"{mass:.3g} kg, but the poses are not of the sensor's own frame"
        return unknown("tool mass", words, "record the pose of the sensor's own frame")
    if sd > _LARGEST_PART * mass:
        words = f"{mass:.3g} ± {sd:.2g} kg is too uncertain"
        return unknown("tool mass", f"{words}: {why}" if why else words)
    gravity = [round(float(v), 4) for v in GRAVITY * weight.down]
    evidence = f"least squares over the turns leave {weight.left:.2g} N of {weight.size:.3g} N"
    values: dict[str, Value] = {"tool.mass": round(mass, 5), "tool.gravity": gravity}
    return Finding("tool mass", mass, sd, evidence, parameters=values)
