# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A shift of three sites, what faults do to its samples, and what must hold afterwards."""

from __future__ import annotations

import ast
import dataclasses
import functools
import math
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from geometry_msgs.msg import TransformStamped, WrenchStamped
from pipeline_helpers import FORCE, Item, begun, feed, items_of, parameters_of, summaries_of
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import (
    WITHHELD,
    Classification,
    ContactSummary,
    Flag,
    Output,
    Status,
    TissueState,
)
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.stiffness import MeasuredSlope
from fden_ros.core.streams import NANOSECONDS
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.writer import BagWriter
from fden_ros.ros.messages import to_stamp
from simulation.bag import PARAMETER_FILE
from simulation.scenario import DisplacementSensor, Scenario, Site, Tissue, ramp_scenario
from simulation.simulate import Recording, simulate
from simulation.trajectory import Palpation, RampHold

RATE = 200.0
#: What a number must come with so that no controller relies on it.
WARNING_FLAGS = (
    Flag.GAP
    | Flag.MODEL_MISMATCH
    | Flag.TOUCH_NOT_OBSERVED
    | Flag.TISSUE_CHANGED
    | Flag.SATURATED
    | Flag.ESTIMATION_FAILED
    | Flag.FORCE_DRIFTED
    | Flag.RIG_PRIOR_CONFLICT
    | Flag.ALPHA_PRIOR_CONFLICT
    | WITHHELD
    | Flag.AT_PRIOR_LIMIT
)
#: A number under a good status is wrong beyond so many standard deviations and so much of ln G.
_DEVIATIONS, _SLACK = 5.0, 0.02


@dataclass(frozen=True, eq=False)
class Shift:
    """Samples of three sites, and the truth behind them."""

    items: tuple[Item, ...]
    parameters: dict[str, object]
    sites: tuple[dict[str, Any], ...]
    contacts: tuple[dict[str, Any], ...]

    def second(self, stamp_ns: int) -> float:
        """Seconds since the first sample."""
        return (stamp_ns - self.items[0].stamp_ns) / NANOSECONDS

    def at(self, second: float) -> int:
        """Stamp so many seconds after the first sample."""
        return self.items[0].stamp_ns + round(second * NANOSECONDS)

    def press(self, number: int) -> tuple[float, float]:
        """Beginning and end [s] of a contact, from 0."""
        contact = self.contacts[number]
        return self.second(contact["start_ns"]), self.second(contact["end_ns"])


#: The same everywhere, and not what the prior says.
TISSUE = Tissue(640.0, 7.4, 0.131)


@functools.cache
def shift() -> Shift:
    """Return three sites, each pressed and held once."""
    press = RampHold(0.2, 0.26, 0.6)
    sites = tuple(Site(TISSUE, (press,), (0.02 * k, 0.0)) for k in range(3))
    return shift_of(_recorded(3, sites), **{"estimate.period": 0.02})


def shift_of(recording: Recording, **parameters: object) -> Shift:
    """Return the samples of a recording, and the parameters that fit it."""
    truth = recording.truth
    own = parameters_of(recording) | parameters
    return Shift(tuple(items_of(recording)), own, tuple(truth["sites"]), tuple(truth["contacts"]))


@functools.cache
def first_press() -> Shift:
    """The shift up to half a second after its first contact."""
    whole = shift()
    end_ns = whole.at(whole.press(0)[1] + 0.5)
    items = tuple(item for item in whole.items if item.stamp_ns < end_ns)
    return replace(whole, items=items, contacts=whole.contacts[:1])


@functools.cache
def undisturbed(make: Callable[[], Shift] = shift, kind: str = "grid") -> Outcome:
    """What the pipeline makes of a shift without a fault."""
    s = make()
    return outcome_of(s.items, s.parameters | {"estimator.kind": kind})


def bouncing() -> list[Item]:
    """A probe that bounces on a fourth site, twenty times in two seconds."""
    press = Palpation(2.0, 0.06, 0.0, retract_rate=2.0, presses=20, lift_m=4e-4, pause_s=0.01)
    recording = _recorded(4, (Site(TISSUE, (press,), (0.1, 0.0)),))
    contacts = recording.truth["contacts"]
    begin, end = contacts[0]["start_ns"] - 50_000_000, contacts[-1]["end_ns"] + 50_000_000
    return [item for item in items_of(recording) if begin <= item.stamp_ns < end]


def _recorded(seed: int, sites: tuple[Site, ...]) -> Recording:
    scenario: Scenario = replace(
        ramp_scenario(rate_hz=RATE, seed=seed),
        sites=sites,
        displacement=DisplacementSensor(rate_hz=RATE, message="pose", noise_m=1e-6),
    )
    return simulate(scenario)


def turn_of(second: float) -> Rotation:
    """How a tool turns: tens of degrees, some of it in each contact."""
    angles = (0.5 * math.sin(0.4 * second), 0.7 * math.sin(0.3 * second), 0.3 * second)
    return Rotation.from_euler("xyz", angles)


@dataclass(frozen=True)
class Outcome:
    """What a pipeline made of samples."""

    pipeline: Pipeline
    outputs: tuple[Output, ...]

    @property
    def states(self) -> list[TissueState]:
        return [output for output in self.outputs if isinstance(output, TissueState)]

    @property
    def summaries(self) -> list[ContactSummary]:
        return summaries_of(self.outputs)


Step = Item | Callable[[Pipeline], object]


def outcome_of(items: Iterable[Step], parameters: dict[str, object], shared: int = 0) -> Outcome:
    """Feed samples, and call what stands between them with the pipeline.

    The first `shared` of them are fed once for all that begin alike.
    """
    steps = tuple(items)
    if shared:
        pipeline, outputs = pickle.loads(_begun(steps[:shared], repr(parameters)))
    else:
        pipeline, outputs = begun(parameters)
    _feed(pipeline, steps[shared:])
    pipeline.finish()
    return Outcome(pipeline, tuple(outputs))


@functools.lru_cache(maxsize=4)
def _begun(steps: tuple[Step, ...], parameters: str) -> bytes:
    """Return a pipeline that has been fed, and its outputs."""
    pipeline, outputs = begun(ast.literal_eval(parameters))
    _feed(pipeline, steps)
    return pickle.dumps((pipeline, outputs))


def _feed(pipeline: Pipeline, steps: Iterable[Step]) -> None:
    for step in steps:
        if isinstance(step, Item):
            feed(pipeline, [step])
        else:
            step(pipeline)


def numbers_of(value: object) -> Iterator[float]:
    """Give every floating-point number of an output."""
    if isinstance(value, Estimate):
        # Where the law has no error it is not known how probable another is. The nodes are not
        # published.
        value = tuple(value._replace(plateau_probability=0.0, small_motions=()))
    if isinstance(value, MeasuredSlope):
        # Where no surface was seen there is no depth below it.
        value = tuple(value._replace(depth=0.0))
    if isinstance(value, np.ndarray):
        yield from value.ravel().tolist()
    elif isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from numbers_of(part)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from numbers_of(getattr(value, field.name))


def assert_sound(outputs: Sequence[Output]) -> None:
    """Everything is finite, covariances are positive semidefinite, stamps go on."""
    newest = -math.inf
    for output in outputs:
        assert all(map(math.isfinite, numbers_of(output))), output
        estimate = getattr(output, "estimate", None)
        if estimate is not None:
            covariance = estimate.covariance
            assert np.array_equal(covariance, covariance.T), output
            least = float(np.linalg.eigvalsh(covariance)[0])
            assert least >= -1e-12 * float(np.trace(covariance)), output
        if isinstance(output, Classification | ContactSummary):
            continue
        # A clock that jumps back takes the stamps along; the jump ends a contact or a site.
        assert output.stamp_ns != newest, output
        newest = output.stamp_ns


def assert_alike(found: Outcome, expected: Outcome) -> None:
    """As the other, by a third of a standard deviation."""
    assert len(found.summaries) == len(expected.summaries) == 1
    for a, b in zip(found.summaries, expected.summaries, strict=True):
        assert a.estimate is not None and b.estimate is not None
        assert a.converged and a.complete
        assert a.flags == b.flags and a.site_id == b.site_id
        sd = np.sqrt(np.diag(b.estimate.covariance)) + 1e-12
        assert np.all(np.abs(a.estimate.mean - b.estimate.mean) < sd / 3.0)


def lies_of(outputs: Iterable[Output], truth: dict[str, Any]) -> list[Output]:
    """Outputs with a number that is wrong under a good status."""
    return [output for output in outputs if is_good(output) and is_wrong(output, truth)]


def is_good(output: Output) -> bool:
    """Whether a controller would rely on it."""
    if not isinstance(output, TissueState | ContactSummary) or output.estimate is None:
        return False
    if isinstance(output, TissueState) and output.status is not Status.CONVERGED:
        return False
    return output.estimate.converged and not output.flags & WARNING_FLAGS


def is_wrong(output: Any, truth: dict[str, Any]) -> bool:
    """Whether ln G or ln Gn is."""
    true = np.log([truth["linear_stiffness"], truth["nonlinear_stiffness"]])
    most = _DEVIATIONS * output.estimate.deviations[:2] + _SLACK
    return bool(np.any(np.abs(output.estimate.mean[:2] - true) > most))


# The shift whose probe hangs on an arm that turns: forces in the sensor's frame, and transforms


FRAMES = {"frames.base": "base", "frames.probe": "tip", "displacement.message": "tf"}
#: Of the sensor in the arm's flange, and of the tip in the sensor's frame.
MOUNT = (np.array([0.01, -0.02, 0.06]), Rotation.from_euler("xyz", [0.1, -0.2, 0.7]))
TIP = (np.array([0.0, 0.03, 0.12]), Rotation.from_euler("xyz", [0.0, 0.4, 0.0]))
#: Transforms come at this rate [Hz], and at other stamps than the forces.
TRANSFORM_RATE = 100.0


class Place(NamedTuple):
    """Where a frame is in its parent, as it arrives."""

    stamp_ns: int
    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    is_static: bool = False

    def __call__(self, pipeline: Pipeline) -> None:
        pipeline.add_transform(
            self.stamp_ns,
            self.parent,
            self.child,
            self.translation,
            self.rotation,
            is_static=self.is_static,
        )


class Vector(NamedTuple):
    """A force in the sensor's frame, as it arrives."""

    stamp_ns: int
    force: tuple[float, float, float]
    frame: str = "sensor"

    def __call__(self, pipeline: Pipeline) -> None:
        pipeline.add_force_vector(self.stamp_ns, self.frame, self.force)


def place(
    stamp_ns: int, parent: str, child: str, at: np.ndarray, turn: Rotation, static: bool = False
) -> Place:
    x, y, z = map(float, at)
    a, b, c, d = map(float, turn.as_quat())
    return Place(stamp_ns, parent, child, (x, y, z), (a, b, c, d), static)


def statics() -> list[Place]:
    return [
        place(1, "flange", "sensor", *MOUNT, static=True),
        place(1, "sensor", "tip", *TIP, static=True),
        # Beside the chain.
        place(1, "flange", "camera", *TIP, static=True),
    ]


def link_of(second: float) -> tuple[np.ndarray, Rotation]:
    """Return where the first link is in the base."""
    turn = Rotation.from_euler("zyx", [0.5 * math.sin(0.5 * second), 0.2, 0.1 * second])
    return np.array([0.3, 0.1 * math.cos(0.4 * second), 0.5]), turn


def places(s: Shift, instant_ns: int, stamp_ns: int | None = None) -> list[Place]:
    """Return the two moving links at an instant, so that the tip is where the shift says."""
    stamp = instant_ns if stamp_ns is None else stamp_ns
    second = s.second(instant_ns)
    tip_turn, tip_at = turn_of(second), tip_position(instant_ns)
    sensor_turn = tip_turn * TIP[1].inv()
    sensor_at = tip_at - sensor_turn.apply(TIP[0])
    flange_turn = sensor_turn * MOUNT[1].inv()
    flange_at = sensor_at - flange_turn.apply(MOUNT[0])
    at, turn = link_of(second)
    return [
        place(stamp, "base", "link", at, turn),
        place(stamp, "link", "flange", turn.inv().apply(flange_at - at), turn.inv() * flange_turn),
    ]


def tip_position(instant_ns: int) -> np.ndarray:
    """Return where the tip is, linear between the samples of the shift."""
    stamps, positions = _path()
    return np.array(
        [np.interp(instant_ns - stamps[0], stamps - stamps[0], positions[:, k]) for k in range(3)]
    )


@functools.cache
def _path() -> tuple[np.ndarray, np.ndarray]:
    moved = [item for item in shift().items if item.stream != FORCE]
    return (
        np.array([item.stamp_ns for item in moved]),
        np.array([item.position for item in moved]),
    )


@functools.cache
def forces(s: Shift) -> tuple[Vector, ...]:
    """Return the forces in the sensor's frame."""
    vectors = []
    for item in s.items:
        if item.stream == FORCE:
            second = s.second(item.stamp_ns)
            turn = turn_of(second) * TIP[1].inv()
            x, y, z = map(float, turn.inv().apply([0.0, 0.0, item.value]))
            vectors.append(Vector(item.stamp_ns, (x, y, z)))
    return tuple(vectors)


@functools.cache
def transforms(s: Shift) -> tuple[Place, ...]:
    """Return the transforms of a shift, three milliseconds off the samples."""
    step, first = round(NANOSECONDS / TRANSFORM_RATE), s.items[0].stamp_ns - 2_000_000
    instants = range(first, s.items[-1].stamp_ns + step, step)
    return tuple(one for instant in instants for one in places(s, instant))


def arm(s: Shift, moving: Iterable[Place] | None = None) -> list[Vector | Place]:
    """Return what arrives of an arm, in order; `moving` in place of its transforms."""
    links = transforms(s) if moving is None else list(moving)
    timed = [(one.stamp_ns, k, one) for k, one in enumerate(links)]
    timed += [(one.stamp_ns, len(links), one) for one in forces(s)]
    return [*statics(), *(one for *_, one in sorted(timed, key=lambda entry: entry[:2]))]


def write_bag(folder: Path, samples: list[Vector | Place]) -> Path:
    """Write what arrives of an arm as a robot records it, with the parameters beside."""
    first = next(one.stamp_ns for one in samples if isinstance(one, Vector))
    fixed = TFMessage(transforms=[stamped(one) for one in samples if is_static(one)])
    with BagWriter(folder) as bag:
        bag.add_topic("/ft/wrench", "geometry_msgs/msg/WrenchStamped", RELIABLE)
        bag.add_topic("/tf", "tf2_msgs/msg/TFMessage", RELIABLE)
        bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        bag.write("/tf_static", fixed, first)
        for one in samples:
            if isinstance(one, Vector):
                message = WrenchStamped()
                message.header.stamp, message.header.frame_id = to_stamp(one.stamp_ns), one.frame
                force = message.wrench.force
                force.x, force.y, force.z = one.force
                bag.write("/ft/wrench", message, max(one.stamp_ns, first))
            elif not one.is_static:
                message = TFMessage(transforms=[stamped(one)])
                bag.write("/tf", message, max(one.stamp_ns, first))
        parameters = {"/**": {"ros__parameters": shift().parameters | FRAMES}}
        (bag.folder / PARAMETER_FILE).write_text(yaml.safe_dump(parameters))
    return folder


def is_static(one: Vector | Place) -> bool:
    return isinstance(one, Place) and one.is_static


def stamped(one: Vector | Place) -> TransformStamped:
    assert isinstance(one, Place)
    message = TransformStamped(child_frame_id=one.child)
    message.header.stamp, message.header.frame_id = to_stamp(one.stamp_ns), one.parent
    at, turn = message.transform.translation, message.transform.rotation
    at.x, at.y, at.z = one.translation
    turn.x, turn.y, turn.z, turn.w = one.rotation
    return message
