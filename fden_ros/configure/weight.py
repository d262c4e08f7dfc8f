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
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.reading import Column, reading_of
from fden_ros.configure.session import Mask, runs
from fden_ros.configure.statistics import angle_between, inflation, noise_of
from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.reader import Topic
from fden_ros.recording.source import Selection

GRAVITY = 9.80665
#: The tool turns above this rate [rad/s]; rests between turns of up to 2 s count as turning.
_TURNING = 0.05
_REST = 2.0
#: Step in which turning is looked for [s], and what is left out at the ends of a stretch.
_STEP = 0.1
#: Poses are searched between these delays behind the force [s].
_EARLIEST, _LATEST = -0.03, 0.08
#: The mass is claimed from this relative deviation on: 2 % are then 2.5 deviations.
_LARGEST_SHARE = 0.008
#: A fit holds where it leaves less than 2.5 deviations of noise, or 3 % of the weight.
_MOST_NOISE = 2.5
_MOST_SHARE = 0.03
#: The sensor counts as turned against the poses from this angle [rad], beyond 4 deviations.
_TURNED = math.radians(2.0)
#: Rate of a turn [rad/s] that the poses are interpolated in.
_USUAL_RATE = 1.0
#: The largest angle between orientations that is enough [rad].
_LEAST_TURN = math.radians(40.0)
#: Share of the orientations' scatter below which all turns are about one axis: the weight along
#: it cannot be told from the bias. Turns by 28 degrees about a second axis give this much.
_LEAST_SPREAD = 0.02
#: Below this share, half a degree of wobble, least squares have no solution of their own.
_NO_SPREAD = 1e-5
#: The driver has taken the weight off if less than this is left [N], and less than 5 deviations.
_TAKEN_OFF_N = 0.05
#: What tells the weight.
MOTION = (
    "turn the tool in the air, slowly, through three orientations 60 degrees apart about two "
    "axes, with a second of rest at each"
)


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
    aligned : bool
        The poses are the sensor's orientation.
    turned_by : float
        Angle between sensor and poses [rad].
    delay, delay_sd : float
        Of the poses' stamps behind the force's [s].
    centre, centre_sd : Array, float
        Of mass in the sensor's frame [m]; NaN without torques.
    left : float
        What the fit leaves, root mean square.
    noise : float
        Of the force per sample.
    seconds : tuple
    holds : bool
        Whether the weight explains the force in the turns.
    """

    matrix: Array
    down: Array
    weight: float
    weight_sd: float
    aligned: bool
    turned_by: float
    delay: float
    delay_sd: float
    centre: Array
    centre_sd: float
    left: float
    noise: float
    seconds: Seconds
    holds: bool

    def load(self, streams: Streams) -> Array | None:
        """Return the force of the weight at the force's stamps (n, 3)."""
        turn = streams.rotation_at(streams.force_times + self.delay)
        if turn is None or not self.holds:
            return None
        return np.einsum("ij,nkj,k->ni", self.matrix, turn, self.down)


@dataclass(frozen=True)
class _Turns:
    """Samples in the turns of all recordings."""

    streams: Sequence[Streams]
    masks: Sequence[Mask]

    def rotations(self, delay: float) -> Array:
        parts = []
        for streams, mask in zip(self.streams, self.masks, strict=True):
            turn = streams.rotation_at(streams.force_times[mask] + delay)
            assert turn is not None
            parts.append(turn)
        return np.concatenate(parts)

    def values(self, *, torque: bool = False) -> Array:
        parts = []
        for streams, mask in zip(self.streams, self.masks, strict=True):
            of = streams.torque if torque else streams.force
            assert of is not None
            parts.append(of[mask])
        return np.concatenate(parts)

    def nuisance(self) -> Array:
        """Return columns of a bias and a drift for every recording (n, 2 count)."""
        columns = []
        for number, mask in enumerate(self.masks):
            times = self.streams[number].force_times[mask]
            centred = (times - times.mean()) / max(float(np.ptp(times)), 1e-9)
            block = np.zeros((times.size, 2 * len(self.masks)))
            block[:, 2 * number] = 1.0
            block[:, 2 * number + 1] = centred
            columns.append(block)
        return np.concatenate(columns)


def find_weight(recordings: Sequence[Streams]) -> Weight | None:
    """Fit the tool's weight to the turns in the air; None where the tool does not turn."""
    streams, masks, seconds = [], [], []
    for one in recordings:
        if one.orientation is None or one.force.shape[1] != 3:
            continue
        mask = _turning(one)
        if mask.sum() < 20:
            continue
        streams.append(one)
        masks.append(mask)
        first = one.start
        times = one.force_times
        seconds += [(times[a] - first, times[b - 1] - first) for a, b in runs(mask)]
    if not streams:
        return None
    turns = _Turns(streams, masks)
    rotations = turns.rotations(0.0)
    if _largest_turn(rotations) < _LEAST_TURN or _one_axis(rotations)[1] < _NO_SPREAD:
        return None
    return _fit(turns, tuple((float(a), float(b)) for a, b in seconds))


def weight_finding(
    weight: Weight | None, recordings: Sequence[Streams], newton: float
) -> tuple[Finding, Finding]:
    """Return what to say of mass and centre; `newton` is one unit of the recorded force [N]."""
    names = ("tool mass", "tool centre of mass")
    if weight is None:
        reason, motion = _missing_turn(recordings) or ("the turns tell nothing", MOTION)
        return unknown(names[0], reason, motion), unknown(names[1], reason, motion)
    if not weight.holds:
        reason = (
            f"while it turned, the force does not follow from a weight: {newton * weight.left:.2g}"
            " N are left; was it in contact?"
        )
        return unknown(names[0], reason, MOTION), unknown(names[1], reason, MOTION)
    size, sd = newton * weight.weight, newton * weight.weight_sd
    if size < max(5.0 * sd, 0.0) or size < _TAKEN_OFF_N:
        limit = size + 2.0 * sd
        evidence = f"less than {limit:.2g} N goes with the turns: the driver has taken it off"
        nothing = Finding(
            names[0],
            True,
            0.0,
            (limit / GRAVITY) / 2.0,
            "kg",
            weight.seconds,
            evidence,
            parameters={"tool.mass": 0.0},
        )
        return nothing, unknown(names[1], evidence, "nothing: there is no weight to take off")
    mass, mass_sd = size / GRAVITY, sd / GRAVITY
    if mass_sd > _LARGEST_SHARE * mass:
        uncertain = f"{mass:.3g} ± {mass_sd:.2g} kg is too uncertain"
        why, motion = _missing_turn(recordings) or ("", MOTION)
        reason = f"{uncertain}: {why}" if why else uncertain
        return unknown(names[0], reason, motion), unknown(names[1], reason, motion)
    if not weight.aligned:
        turned = math.degrees(weight.turned_by)
        evidence = (
            f"the poses are not the sensor's orientation, which is turned by {turned:.1f} degrees "
            "against them: the weight can only be taken off once the poses are the sensor's"
        )
        return (
            Finding(names[0], True, mass, mass_sd, "kg", weight.seconds, evidence),
            unknown(names[1], evidence, "record the pose of the sensor's own frame"),
        )
    gravity = [round(float(v), 4) for v in GRAVITY * weight.down]
    evidence = f"least squares over the turns leave {newton * weight.left:.2g} N of {size:.3g} N"
    found = Finding(
        names[0],
        True,
        mass,
        mass_sd,
        "kg",
        weight.seconds,
        evidence,
        parameters={"tool.mass": round(mass, 5), "tool.gravity": gravity},
    )
    if not math.isfinite(weight.centre_sd) or weight.centre_sd > 0.005:
        reason = "the torques do not tell the centre within 5 mm"
        return found, unknown(names[1], reason, MOTION)
    centre = tuple(float(v) for v in weight.centre)
    return found, Finding(
        names[1],
        True,
        centre,
        weight.centre_sd,
        "m",
        weight.seconds,
        "from the torques in the same turns",
        parameters={"tool.centre_of_mass": [round(v, 5) for v in centre]},
    )


def _turning(streams: Streams) -> Mask:
    grid = np.arange(streams.start, streams.end, _STEP)
    turns = streams.rotation_at(grid)
    if turns is None or grid.size < 3:
        return np.zeros(streams.force_times.size, dtype=bool)
    cosine = 0.5 * (np.einsum("nij,nij->n", turns[1:], turns[:-1]) - 1.0)
    moving = np.arccos(np.clip(cosine, -1.0, 1.0)) / _STEP > _TURNING
    stretches: list[list[int]] = []
    for a, b in runs(moving):
        if stretches and (a - stretches[-1][1]) * _STEP < _REST:
            stretches[-1][1] = b
        else:
            stretches.append([a, b])
    mask = np.zeros(streams.force_times.size, dtype=bool)
    margin = 0.1
    for a, b in stretches:
        if (b - a) * _STEP < 0.5:
            continue
        low, high = grid[a] + margin, grid[b] - margin
        mask |= (streams.force_times >= low) & (streams.force_times <= high)
    return mask


def _missing_turn(recordings: Sequence[Streams]) -> tuple[str, str] | None:
    """Return what the orientations lack to tell a weight, and the motion that brings it."""
    turned = [(s, _turning(s)) for s in recordings if s.orientation is not None]
    if not turned:
        return "the recording holds no orientation of the tool", MOTION
    if max(int(mask.sum()) for _, mask in turned) < 20:
        return "the tool did not turn in the air", MOTION
    rotations = _Turns([s for s, _ in turned], [mask for _, mask in turned]).rotations(0.0)
    largest = _largest_turn(rotations)
    if largest < _LEAST_TURN:
        return f"the tool turned by {math.degrees(largest):.0f} degrees only", MOTION
    axis, spread = _one_axis(rotations)
    if spread > _LEAST_SPREAD:
        return None
    along = ", ".join(f"{v:.1f}" for v in axis + 0.0)
    return (
        f"all turns were about one axis, ({along}) in the frame of the poses",
        "turn the tool in the air about another axis, across that one, by 60 degrees, too, "
        "slowly, with a second of rest",
    )


def _one_axis(turns: Array) -> tuple[Array, float]:
    """Return the axis that the turns (n, 3, 3) move least, in the poses' frame, and its scatter.

    A direction v of the poses' frame is seen from the tool as ``R.T v``; the scatter is the mean
    square of that less its mean, 0 where all turns are about v.
    """
    mean = turns.mean(axis=0)
    sizes, axes = np.linalg.eigh(np.eye(3) - mean @ mean.T)
    axis = axes[:, 0] * math.copysign(1.0, axes[np.argmax(np.abs(axes[:, 0])), 0])
    return axis, float(sizes[0])


def _largest_turn(turns: Array) -> float:
    some = turns[:: max(turns.shape[0] // 60, 1)]
    cosine = 0.5 * (np.einsum("aij,bij->ab", some, some) - 1.0)
    return float(np.arccos(np.clip(cosine.min(), -1.0, 1.0)))


def _interpolation_error(turns: _Turns) -> float:
    """Return what lines between the poses miss of a turn, relative to the weight."""
    worst = 0.0
    for streams in turns.streams:
        step = float(np.median(np.diff(streams.motion_times)))
        worst = max(worst, (step * _USUAL_RATE) ** 2 / 8.0)
    return worst


def _aligned_columns(turns: Array) -> Array:
    """Return the design of F = R.T w in three components, (n, 3, 3)."""
    return np.swapaxes(turns, 1, 2)


def _free_columns(turns: Array) -> Array:
    """Return the design of F = M u with u = R.T (-z), (n, 3, 9)."""
    down = -turns[:, 2, :]
    design = np.zeros((turns.shape[0], 3, 9))
    for row in range(3):
        design[:, row, 3 * row : 3 * row + 3] = down
    return design


def _solve(columns: Array, nuisance: Array, values: Array) -> tuple[Array, Array, Array]:
    """Return solution, covariance and residual (n, 3)."""
    count, _, width = columns.shape
    extra = nuisance.shape[1]
    design = np.zeros((count, 3, width + 3 * extra))
    design[:, :, :width] = columns
    for row in range(3):
        design[:, row, width + row * extra : width + (row + 1) * extra] = nuisance
    flat, target = design.reshape(3 * count, -1), values.reshape(-1)
    normal = flat.T @ flat
    inverse = np.linalg.pinv(normal)
    solution = inverse @ (flat.T @ target)
    residual = (target - flat @ solution).reshape(count, 3)
    freedom = max(3 * count - flat.shape[1], 1)
    variance = float(np.sum(residual**2)) / freedom
    spread = max(inflation(residual[:, row]) for row in range(3))
    return solution, inverse * variance * spread, residual


def _fit(turns: _Turns, seconds: Seconds) -> Weight:
    values, nuisance = turns.values(), turns.nuisance()
    aligned = _fit_one(turns, values, nuisance, _aligned_columns)
    free = _fit_one(turns, values, nuisance, _free_columns)
    noise = float(np.mean([noise_of(s.force_times, s.force).mean() for s in turns.streams]))
    weight, aligned_sd = _size(aligned.solution[:3], aligned.covariance[:3, :3])
    strained = math.sqrt(float(np.mean(aligned.residual**2)))
    relaxed = math.sqrt(float(np.mean(free.residual**2)))
    # The poses are the sensor's where a rotation of its own explains hardly more.
    better = (strained / max(relaxed, 1e-300)) ** 2 - 1.0
    is_aligned = better < 60.0 / values.shape[0] + 1e-3 or strained < 0.004 * weight
    if is_aligned:
        vector = aligned.solution[:3]
        sd = aligned_sd
        direction_sd = math.sqrt(float(np.mean(np.diag(aligned.covariance)[:3])))
        matrix, down = np.eye(3) * weight, vector / max(weight, 1e-300)
        chosen, turned_by = aligned, 0.0
        upright = np.array([0.0, 0.0, math.copysign(1.0, down[2])])
        if angle_between(down, upright) < max(_TURNED, 3.0 * direction_sd / max(weight, 1e-300)):
            down = upright
    else:
        free_matrix = free.solution[:9].reshape(3, 3)
        left, sizes, right = np.linalg.svd(free_matrix)
        sign = float(np.sign(np.linalg.det(left @ right))) or 1.0
        weight = float(np.mean(sizes))
        sd = math.sqrt(float(np.mean(np.diag(free.covariance)[:9])))
        turn = sign * (left @ right)
        turned_by = math.acos(min(max(0.5 * (float(np.trace(turn)) - 1.0), -1.0), 1.0))
        matrix, down = free_matrix, np.array([0.0, 0.0, -1.0])
        chosen = free
        strained = relaxed
        # A weight turns as a whole: other stretches in different directions are something else.
        if float(np.ptp(sizes)) > max(8.0 * sd, 0.05 * weight):
            strained = math.inf
    sd = math.hypot(sd, weight * _interpolation_error(turns))
    holds = strained < max(_MOST_NOISE * noise, _MOST_SHARE * weight)
    if holds and weight > 20.0 * sd:
        centre, centre_sd = _centre(turns, chosen.delay, matrix, down)
        # A weight that is off moves the centre along its own direction by the same share.
        centre_sd = math.hypot(centre_sd, float(np.linalg.norm(centre)) * sd / weight)
    else:
        centre, centre_sd = np.full(3, np.nan), math.nan
    return Weight(
        matrix,
        down,
        weight,
        sd,
        is_aligned,
        turned_by,
        chosen.delay,
        chosen.delay_sd,
        centre,
        centre_sd,
        strained,
        noise,
        seconds,
        holds,
    )


@dataclass(frozen=True)
class _One:
    solution: Array
    covariance: Array
    residual: Array
    delay: float
    delay_sd: float


def _fit_one(turns: _Turns, values: Array, nuisance: Array, columns: object) -> _One:
    assert callable(columns)
    thin = max(values.shape[0] // 4000, 1)

    def misfit(delay: float) -> float:
        design = columns(turns.rotations(delay)[::thin])
        residual = _solve(design, nuisance[::thin], values[::thin])[2]
        return float(np.sum(residual**2))

    grid = np.linspace(_EARLIEST, _LATEST, 12)
    misfits = [misfit(float(delay)) for delay in grid]
    best = int(np.argmin(misfits))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    found = minimize_scalar(
        misfit, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-5}
    )
    delay = float(found.x)
    rotations = turns.rotations(delay)
    design = columns(rotations)
    solution, _, _ = _solve(design, nuisance, values)
    width = design.shape[2]
    # How the fitted force changes with the delay: one more unknown.
    step = 1e-3
    ahead = np.einsum("nij,j->ni", columns(turns.rotations(delay + step)), solution[:width])
    behind = np.einsum("nij,j->ni", columns(turns.rotations(delay - step)), solution[:width])
    slope = (ahead - behind) / (2.0 * step)
    whole = np.concatenate([design, slope[:, :, None]], axis=2)
    solution, covariance, residual = _solve(whole, nuisance, values)
    return _One(solution, covariance, residual, delay, math.sqrt(float(covariance[width, width])))


def _size(vector: Array, covariance: Array) -> tuple[float, float]:
    """Return the length of a vector (3,) and its deviation, from its covariance (3, 3)."""
    size = float(np.linalg.norm(vector))
    along = vector / max(size, 1e-300)
    variance = float(along @ covariance @ along)
    # What lies across adds to the length, by half its square.
    across = max(float(np.trace(covariance)) - variance, 0.0) / (2.0 * max(size, 1e-300))
    return size, math.hypot(math.sqrt(max(variance, 0.0)), across)


def _centre(turns: _Turns, delay: float, matrix: Array, down: Array) -> tuple[Array, float]:
    if any(streams.torque is None for streams in turns.streams):
        return np.full(3, np.nan), math.nan
    torque = turns.values(torque=True)
    force = np.einsum("ij,nkj,k->ni", matrix, turns.rotations(delay), down)
    # c x F = -F x c, linear in c.
    columns = np.zeros((force.shape[0], 3, 3))
    x, y, z = force.T
    columns[:, 0, 1], columns[:, 0, 2] = z, -y
    columns[:, 1, 0], columns[:, 1, 2] = -z, x
    columns[:, 2, 0], columns[:, 2, 1] = y, -x
    solution, covariance, _ = _solve(columns, turns.nuisance(), torque)
    return solution[:3], math.sqrt(float(np.mean(np.diag(covariance)[:3])))


@dataclass(frozen=True)
class ToolAnswer:
    """What the turns tell of the tool by now.

    Parameters
    ----------
    is_known : bool
        ``tool.*`` can be set by it.
    words : str
        The answer in one line; where it is not known, why, and the motion that would tell.
    mass, centre : Finding, optional
        Of all that the sensor carries [kg], and of its mass in the sensor's frame [m].
    """

    is_known: bool
    words: str
    mass: Finding | None = None
    centre: Finding | None = None


class ToolCollection:
    """Forces and orientations since the collection began.

    Parameters
    ----------
    force, displacement : Topic
        Where they come from: a wrench, and a pose or a transform of the sensor.
    needs_centre : bool
        Whether the centre of mass counts, as for a torque.

    Raises
    ------
    InputError
        If one of the types says nothing of a tool's weight.
    """

    def __init__(self, force: Topic, displacement: Topic, *, needs_centre: bool) -> None:
        needed = {
            force: ("geometry_msgs/msg/WrenchStamped",),
            displacement: ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"),
        }
        for topic, types in needed.items():
            if topic.type_name not in types:
                raise InputError(
                    f"{topic.name} is a {topic.type_name.replace('/msg/', '/')}: the tool's "
                    "weight wants a wrench and the orientation of a pose or transform "
                    "(force.message, displacement.message)"
                )
        self._needs_centre = needs_centre
        self._columns = {
            "force": Column(force, None, "force"),
            "displacement": Column(displacement, None, "displacement"),
        }

    def add(self, what: str, data: bytes) -> None:
        """Take a message of ``force`` or ``displacement`` as CDR bytes."""
        self._columns[what].add(data, 0)

    @property
    def seconds(self) -> float:
        """From the first stamp of the force to its last [s]."""
        stamps = self._columns["force"].stamps
        return 1e-9 * (stamps[-1] - stamps[0]) if stamps else 0.0

    def answer(self) -> ToolAnswer:
        """Return what is known by now."""
        force, displacement = self._columns["force"], self._columns["displacement"]
        inputs = {what: column.topic.name for what, column in self._columns.items()}
        try:
            reading = reading_of(Path("live"), force, displacement, Selection(), inputs)
        except InputError as error:
            return ToolAnswer(False, f"{error}".removeprefix("live: "))
        streams = [reading.streams]
        mass, centre = weight_finding(find_weight(streams), streams, 1.0)
        if not mass.claim:
            return ToolAnswer(False, f"{mass.evidence}: {mass.motion}; then ask again")
        if not mass.parameters:
            return ToolAnswer(False, mass.evidence, mass)
        if not mass.value:
            return ToolAnswer(True, f"tool.mass: 0 kg; {mass.evidence}", mass)
        if self._needs_centre and not centre.claim:
            words = f"{_words(mass)}, but {centre.evidence}: {centre.motion}; then ask again"
            return ToolAnswer(False, words, mass)
        said = [_words(mass), *([_words(centre)] if centre.claim else [])]
        words = f"{', '.join(said)}: put them into the parameter file and configure anew"
        return ToolAnswer(True, words, mass, centre if centre.claim else None)


def _words(finding: Finding) -> str:
    """Return the parameters that a finding sets, as in ``tool.mass: 0.3 ± 0.001 kg``."""
    said = []
    for name, value in finding.parameters.items():
        is_own = name != "tool.gravity"
        said.append(f"{name}: {value}" + (f" ± {finding.deviation:.2g}" if is_own else ""))
        said[-1] += f" {finding.unit if is_own else 'm/s^2'}"
    return ", ".join(said)
