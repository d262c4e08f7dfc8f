# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every row of test/faults.md that reaches the pipeline: what a fault does, and what it must not.

A shift of three sites with the same tissue; the fault comes at the second one, or before. Held for
every row: all outputs finite and in order, no wrong number under a good status, the right counter,
a true status from a second after good data on, and at the third site what a shift without the
fault gives.
"""

from __future__ import annotations

import functools
import math
import pickle
import random
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from fault_helpers import (
    FRAMES,
    WARNING_FLAGS,
    Outcome,
    Place,
    Shift,
    Step,
    arm,
    assert_sound,
    bouncing,
    lies_of,
    outcome_of,
    shift,
    transforms,
    undisturbed,
)
from pipeline_helpers import Item, feed
from property_helpers import counts
from scipy.spatial.transform import Rotation

from fden_ros.core.outputs import Flag, Status
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import check, pipeline_config

TABLE = (Path(__file__).parent / "faults.md").read_text(encoding="utf-8")
FORCE, DISPLACEMENT = 0, 1
BOTH = (FORCE, DISPLACEMENT)
#: In the ramp of the second press, whose contact lasts from 9.06 s to 11.10 s.
BEGIN, END = 9.6, 10.4
IN_CONTACT, IN_AIR = 10.0, 12.5
#: Until then most rows have the samples of the shift: the first press and its air.
SHARED = 9.0
#: Seconds in which a status may be late after good data; edges of contacts are not looked at.
PATIENCE, EDGE = 1.0, 0.3

Change = Callable[[Item], Item]


@dataclass(frozen=True)
class Row:
    """One fault; its counters, flags and words stand in the table."""

    name: str  #: as in the table
    samples: Callable[[Shift], Iterable[Step]]  #: what arrives instead of the shift's samples
    good_from: float = END  #: when the data are good again [s]
    moved: float = 0.0  #: by how much the stamps then differ from the shift's [s]
    third_site: bool = True  #: whether the third site is seen, whole
    also: Status = Status.CONVERGED  #: what else the status may be, until the probe is lifted
    #: Number of blocks of 20 ms for which a number may be wrong before it is noticed.
    lies: int = 0
    parameters: dict[str, object] = field(default_factory=dict)
    fails: int = 0  #: how many exceptions the pipeline contained

    @functools.cached_property
    def said_by(self) -> str:
        """The last cell of the table's row."""
        (cell,) = re.findall(rf"(?m)^\| `{self.name}` \|.*\|([^|]*)\|$", TABLE)
        return str(cell)

    @property
    def counted(self) -> list[str]:
        """Counters that must have grown, and no other."""
        named = re.findall(r"`([a-z*]+\.\w+)`", self.said_by)
        return [
            f"{stream}.{name.split('.')[1]}" if name[0] == "*" else name
            for name in named
            for stream in (("force", "displacement") if name[0] == "*" else ("",))
        ]

    @property
    def flags(self) -> list[Flag]:
        """Of the second contact: one of them, at least."""
        return [Flag[name] for name in re.findall(r"`([A-Z_]+)`", self.said_by)]

    @property
    def words(self) -> list[str]:
        """Parts of warnings that must be there; what only the node says is left out."""
        named = [words.removesuffix(" ...") for words in re.findall(r'"([^"]+)"', self.said_by)]
        return [words for words in named if words not in ("2 publishers", "no pair")]


def within(shift_: Shift, item: Item, begin: float, end: float, streams: tuple[int, ...]) -> bool:
    return item.stream in streams and shift_.at(begin) <= item.stamp_ns < shift_.at(end)


def replaced(
    new: Callable[[Item], Iterable[Item]],
    begin: float = BEGIN,
    end: float = END,
    streams: tuple[int, ...] = BOTH,
) -> Callable[[Shift], list[Step]]:
    """Put others in the place of each sample of a stretch of time."""
    return lambda s: [
        one for i in s.items for one in (new(i) if within(s, i, begin, end, streams) else [i])
    ]


def each(change: Change, *where: Any, **named: Any) -> Callable[[Shift], list[Step]]:
    """Change every sample of a stretch of time."""
    return replaced(lambda item: [change(item)], *where, **named)


def some(
    change: Change, streams: tuple[int, ...] = BOTH, count: int = 6
) -> Callable[[Shift], list[Step]]:
    """Change a few samples in the second contact, of each stream in turn, never two in a row."""

    def samples(s: Shift) -> list[Step]:
        near = [k for k, i in enumerate(s.items) if within(s, i, BEGIN, END, streams)]
        step = len(near) // (count + 1) | 1  # odd: the streams alternate
        chosen = set(near[step::step][:count])
        return [change(item) if k in chosen else item for k, item in enumerate(s.items)]

    return samples


def value(new: float) -> Change:
    return lambda item: item._replace(value=new)


def plus(offset: float) -> Change:
    return lambda item: item._replace(value=item.value + offset)


def later(seconds: float) -> Change:
    return lambda item: item._replace(stamp_ns=item.stamp_ns + round(seconds * NANOSECONDS))


def without(*where: Any) -> Callable[[Shift], list[Step]]:
    return replaced(lambda item: [], *where)


def stuck(begin: float, end: float, stream: int) -> Callable[[Shift], list[Step]]:
    def samples(s: Shift) -> list[Step]:
        held: Item | None = None
        out: list[Step] = []
        for item in s.items:
            if within(s, item, begin, end, (stream,)):
                held = held or item
                item = item._replace(value=held.value, position=held.position)
            out.append(item)
        return out

    return samples


def shuffled(s: Shift) -> list[Step]:
    items: list[Step] = list(s.items)
    chosen = [k for k, i in enumerate(s.items) if within(s, i, BEGIN, END, BOTH)]
    generator = random.Random(3)
    for k in range(0, len(chosen) - 6, 6):
        places = chosen[k : k + 6]
        block = [items[j] for j in places]
        generator.shuffle(block)
        for j, item in zip(places, block, strict=True):
            items[j] = item
    return items


def twice(change: Change, streams: tuple[int, ...] = BOTH) -> Callable[[Shift], list[Step]]:
    """Let a second publisher add its own sample after each."""
    return replaced(lambda item: [item, change(item)], streams=streams)


def thinned(every: int, streams: tuple[int, ...]) -> Callable[[Shift], list[Step]]:
    """Keep one sample in `every` from the contact on."""

    counts = [0, 0]

    def kept(item: Item) -> list[Item]:
        counts[item.stream] += 1
        return [] if counts[item.stream] % every else [item]

    return replaced(kept, IN_CONTACT, 99.0, streams)


def called(action: Callable[[Pipeline], object], *seconds: float) -> Callable[[Shift], list[Step]]:
    """Call a service at some times."""

    def samples(s: Shift) -> list[Step]:
        times = [s.at(second) for second in seconds]
        out: list[Step] = []
        for item in s.items:
            while times and item.stamp_ns >= times[0]:
                out.append(action)
                times.pop(0)
            out.append(item)
        return out

    return samples


def from_then(second: float, change: Change, streams: tuple[int, ...] = BOTH) -> Any:
    return each(change, second, 99.0, streams)


def drift(begin: float, end: float, slope: float) -> Callable[[Shift], list[Step]]:
    return lambda s: each(
        lambda i: plus(slope * (s.second(i.stamp_ns) - begin))(i), begin, end, (FORCE,)
    )(s)


def chatter(begin: float) -> Callable[[Shift], list[Step]]:
    """Let the probe bounce on another site, in the air between two."""

    def samples(s: Shift) -> list[Step]:
        bounces = bouncing()
        offset = s.at(begin) - bounces[0].stamp_ns
        moved = [item._replace(stamp_ns=item.stamp_ns + offset) for item in bounces]
        before = [item for item in s.items if item.stamp_ns < moved[0].stamp_ns]
        return [*before, *moved, *(i for i in s.items if i.stamp_ns > moved[-1].stamp_ns)]

    return samples


def clipped(limit: float) -> Callable[[Shift], list[Step]]:
    return each(lambda i: i._replace(value=min(i.value, limit)), 0.0, 12.0, (FORCE,))


def break_estimator(pipeline: Pipeline) -> None:
    """Let the estimator of the site under the probe raise at its next block."""

    def add(*samples: object) -> None:
        raise ZeroDivisionError("on purpose")

    site = pipeline._session._sites.present  # type: ignore[union-attr]
    site._estimator.add = add


def arm_with(
    change: Callable[[Shift, Sequence[Place]], Sequence[Place]],
) -> Callable[[Shift], list[Step]]:
    """Let an arm that turns carry the probe, and something happen to its transforms."""
    return lambda s: list(arm(s, change(s, transforms(s))))


def some_places(change: Callable[[Place], Place]) -> Callable[[Shift], list[Step]]:
    """Change a few transforms of one link in the second contact, never two in a row."""

    def changed(s: Shift, moving: Sequence[Place]) -> Sequence[Place]:
        near = [k for k, one in enumerate(moving) if s.at(BEGIN) <= one.stamp_ns < s.at(END)]
        chosen = set(near[10::33])
        return [change(one) if k in chosen else one for k, one in enumerate(moving)]

    return arm_with(changed)


def no_places(begin: float, end: float, child: str = "flange") -> Callable[[Shift], list[Step]]:
    return arm_with(
        lambda s, moving: [
            one
            for one in moving
            if one.child != child or not s.at(begin) <= one.stamp_ns < s.at(end)
        ]
    )


def late_arm(s: Shift) -> list[Step]:
    """The transforms of 0.1 s before, each with its own stamp, after the newer ones."""
    moving = transforms(s)
    late = [one for one in moving if s.at(BEGIN) <= one.stamp_ns < s.at(END)][::7]
    out: list[Step] = list(arm(s, moving))
    for one in late:
        newer = one.stamp_ns + NANOSECONDS // 10
        out.insert(next(k for k, other in enumerate(out) if other.stamp_ns > newer), one)  # type: ignore[union-attr]
    return out


def turned(one: Place) -> Place:
    """Off by 5 mm and a tenth of a radian."""
    x, y, z = one.translation
    turn = Rotation.from_quat(one.rotation) * Rotation.from_rotvec([0.1, 0.0, 0.0])
    a, b, c, d = map(float, turn.as_quat())
    return one._replace(translation=(x, y, z + 0.005), rotation=(a, b, c, d))


NAN_FORCE, NAN_DISPLACEMENT = (
    each(value(math.nan), streams=(stream,)) for stream in (FORCE, DISPLACEMENT)
)
UNSET = (0.0, 0.0, 0.0, 0.0)

ROWS = [
    # values
    Row("nan", some(value(math.nan))),
    Row("force_nan_run", NAN_FORCE),
    Row("displacement_nan_run", NAN_DISPLACEMENT),
    Row("infinite", some(value(-math.inf))),
    Row("absurd", some(value(1e300))),
    Row("denormal", some(value(5e-324))),
    Row("force_spike", some(plus(0.5), (FORCE,))),
    Row("force_spike_large", some(value(9e4), (FORCE,))),
    Row("displacement_spike", some(plus(0.002), (DISPLACEMENT,))),
    # stamps
    Row("stamp_zero", some(lambda i: i._replace(stamp_ns=0))),
    Row("stamp_duplicate", twice(lambda item: item)),
    Row("stamp_late", some(later(-0.1), (FORCE,))),
    Row("stamp_shuffled", shuffled),
    Row("stamp_future", some(later(100.0), (FORCE,))),
    Row("stamp_future_near", some(later(0.3), (FORCE,))),
    Row("clock_forward_contact", from_then(10.0, later(100.0)), moved=100.0),
    Row("clock_forward_air", from_then(12.5, later(100.0)), moved=100.0, good_from=IN_AIR),
    Row("clock_back_contact", from_then(10.0, later(-100.0)), moved=-100.0, also=Status.UNKNOWN),
    Row("clock_back_air", from_then(12.5, later(-3.0)), moved=-3.0, good_from=IN_AIR),
    Row("clock_of_one_stream", each(later(-3.0), 0.0, 9.0, (FORCE,)), good_from=9.0),
    Row("bag_loops", lambda s: [*s.items, *s.items], good_from=math.inf),
    # streams
    Row("dropout_10_ms", without(10.0, 10.01)),
    Row("dropout_100_ms", without(10.0, 10.1)),
    Row("dropout_300_ms_force", without(10.0, 10.3, (FORCE,))),
    Row("dropout_300_ms_displacement", without(10.0, 10.3, (DISPLACEMENT,))),
    Row("dropout_1_s", without(10.0, 11.0), good_from=11.0),
    Row("dropout_10_s", without(4.0, 14.0), good_from=14.0),
    Row("topic_stops", without(10.0, 99.0, (FORCE,)), good_from=math.inf, third_site=False),
    Row("topic_starts_late", without(0.0, 8.0, (DISPLACEMENT,)), good_from=8.0),
    Row("rate_changes", thinned(2, BOTH), good_from=IN_CONTACT),
    Row("rate_changes_of_one", thinned(4, (DISPLACEMENT,)), good_from=IN_CONTACT),
    Row("two_publishers_differ", twice(lambda i: later(0.002)(value(0.0)(i)), (FORCE,))),
    # sensors
    Row("force_saturated", clipped(0.04), good_from=12.0, lies=3),
    Row("force_stuck", stuck(9.8, 10.6, FORCE), good_from=10.6),
    Row("displacement_stuck", stuck(9.8, 10.3, DISPLACEMENT), lies=4),
    Row("force_drift", drift(0.0, 99.0, 0.002)),
    Row("drift_begins_in_contact", drift(10.0, 13.0, 0.01), lies=23),
    Row("tare_in_air", called(lambda p: p.tare(), 8.0)),
    Row("tare_under_load", called(lambda p: p.tare(), 9.3, 9.6, 10.0, 10.5)),
    Row(
        "force_wrong_sign",
        each(lambda i: i._replace(value=-i.value), 0.0, 12.0, (FORCE,)),
        good_from=13.0,
    ),
    Row("bias_steps", from_then(13.0, plus(0.05), (FORCE,)), good_from=15.0),
    # transforms
    Row("transform_turns", arm_with(lambda s, moving: moving), parameters=FRAMES),
    Row("transform_late", late_arm, parameters=FRAMES),
    Row("transform_jumps", some_places(turned), parameters=FRAMES),
    Row(
        "transform_unset", some_places(lambda one: one._replace(rotation=UNSET)), parameters=FRAMES
    ),
    Row("transform_dropout_300_ms", no_places(10.0, 10.3), parameters=FRAMES),
    Row("transform_starts_late", no_places(-1.0, 8.0), parameters=FRAMES, good_from=8.0),
    # contact
    Row("contact_at_start", without(0.0, 10.0), good_from=11.5),
    Row("reset_in_contact", called(lambda p: p.reset(), 9.3, 9.6, 10.0, 10.5)),
    Row("contact_chatter", chatter(6.0), good_from=8.0),
    # the computation
    Row("estimator_raises", called(break_estimator, 9.8), fails=1, also=Status.UNKNOWN),
    Row("reset_always", called(lambda p: p.reset(), *[0.1 * k for k in range(130)]), good_from=13),
]


#: What reaches the estimator is tested with the one that users have in each run, the rest with the
#: paper's recursion, which takes a sixth of the time, and with both by make statistics.
OFTEN = {
    *("bias_steps", "contact_chatter", "displacement_stuck", "dropout_100_ms", "force_drift"),
    *("drift_begins_in_contact", "estimator_raises", "force_wrong_sign", "tare_under_load"),
}
KINDS = [
    *(pytest.param(row, "ekf", id=row.name) for row in ROWS if row.name not in OFTEN),
    *(
        pytest.param(
            row,
            "grid",
            id=f"{row.name}, grid",
            marks=[] if row.name in OFTEN else pytest.mark.statistics,
        )
        for row in ROWS
    ),
]


@pytest.mark.parametrize(("row", "kind"), KINDS)
def test_fault(row, kind):
    s, parameters = shift(), row.parameters | {"estimator.kind": kind}
    steps = [*row.samples(s)]
    first = sum(getattr(step, "stamp_ns", math.inf) < s.at(SHARED) for step in steps)
    # An arm's pipeline cannot be kept.
    shared = 0 if row.parameters else first
    outcome = outcome_of(steps, s.parameters | parameters, shared)
    assert_sound(outcome.outputs)
    assert outcome.pipeline.failure_count == row.fails, outcome.pipeline.failures
    assert len(lies_of(outcome.outputs, s.sites[0])) <= row.lies
    assert_counted(row, outcome)
    assert_true_status(row, s, outcome)
    second = [c for c in outcome.summaries if s.second(c.start_ns) < row.good_from][-1:]
    for contact in second if row.flags else ():
        assert any(flag in contact.flags for flag in row.flags)
    if row.third_site:
        assert_third_site(s, outcome, undisturbed(kind=kind))


def assert_counted(row: Row, outcome: Outcome) -> None:
    rejected = {name for name, count in outcome.pipeline.rejected.items() if count}
    # A sample that is dropped may leave another without its partner.
    partner = {"force.unpaired", "force.displacement_gap", "force.no_transform"}
    assert set(row.counted) <= rejected <= set(row.counted) | partner
    for part in row.words:
        assert any(part in words for words in outcome.pipeline.warnings), part


def assert_true_status(row: Row, s: Shift, outcome: Outcome) -> None:
    presses = [s.press(number) for number in range(3)]
    states = outcome.states
    back = [k for k in range(1, len(states)) if states[k].stamp_ns < states[k - 1].stamp_ns]
    for state in states[back[-1] if back else 0 :]:
        now = s.second(state.stamp_ns) - row.moved
        if now < row.good_from + PATIENCE:
            continue
        inside = any(begin + EDGE < now < end - EDGE for begin, end in presses)
        outside = all(now < begin - EDGE or now > end + EDGE for begin, end in presses)
        if outside:
            assert state.status is Status.NO_CONTACT, now
        if inside:
            assert state.status in (Status.CONVERGING, Status.CONVERGED, row.also), now


def assert_third_site(s: Shift, outcome: Outcome, clean: Outcome) -> None:
    """What a shift without the fault gives, by one standard deviation.

    Where fewer samples know less, by two of what the others would add.
    """
    found, expected = outcome.summaries[-1], clean.summaries[-1]
    assert found.estimate is not None and expected.estimate is not None
    assert found.converged and found.complete
    assert not found.flags & (WARNING_FLAGS | Flag.INPUT_REJECTED)
    variances = expected.estimate.covariance[0, 0], found.estimate.covariance[0, 0]
    sd = math.sqrt(max(*variances, 4.0 * abs(variances[1] - variances[0])))
    difference = found.estimate.log_linear_stiffness - expected.estimate.log_linear_stiffness
    assert abs(difference) < sd


@pytest.mark.parametrize("minutes", counts(3, 60))
def test_a_contact_of_an_hour_is_one_contact_in_constant_memory(minutes):
    """At 10 Hz, pressed and held, a block a second."""
    count = 600 * minutes
    s = shift()
    begin, _ = s.press(1)
    held = [item for item in s.items if s.second(item.stamp_ns) < begin + 1.8]
    pipeline = Pipeline(pipeline_config(check(s.parameters | {"estimate.period": 1.0})), ignored)
    feed(pipeline, held)
    force, displacement = (
        next(item for item in reversed(held) if item.stream == stream) for stream in BOTH
    )
    generator = random.Random(5)
    sizes = []
    for k in range(1, count):
        stamp = force.stamp_ns + k * NANOSECONDS // 10
        # A hold relaxes with the time since the middle of its ramp to the power -alpha.
        relaxed = force.value * (1.0 + 0.1 * k / 1.15) ** -0.131
        pipeline.add_displacement(stamp, displacement.value, displacement.position)
        pipeline.add_force(stamp, relaxed + generator.gauss(0.0, 1e-3))
        if k % (count // 30) == 0:
            sizes.append(len(pickle.dumps(pipeline)))
    assert pipeline.contact_count == 2
    assert not pipeline.rejected
    # A press has 40 to 72 cells, and at times a second grid.
    assert max(sizes[15:]) < 1.1 * max(sizes[:15])


def ignored(output: object) -> None:
    """Take an output and forget it."""


def test_the_table_of_faults_has_every_row_that_is_tested_and_no_other():
    listed = re.findall(r"(?m)^\| `(\w+)` \|", TABLE)
    assert len(set(listed)) == len(listed)
    assert set(listed) == {row.name for row in ROWS} | node_rows()


def node_rows() -> set[str]:
    """Names of the rows that the node's own tests mark."""
    source = (Path(__file__).parent / "test_faults_node.py").read_text(encoding="utf-8")
    return set(re.findall(r'@row\("(\w+)"\)', source))


@pytest.mark.parametrize(
    ("count", "kind"), [(8, "ekf"), pytest.param(100, "grid", marks=pytest.mark.statistics)]
)
def test_shift_after_shift_leaves_the_memory_as_it_was(count, kind):
    """From as many sites on as are remembered: 16."""
    s = shift()
    pipeline = Pipeline(pipeline_config(check(s.parameters | {"estimator.kind": kind})), ignored)
    sizes = []
    for number in range(count):
        later = round(number * (s.second(s.items[-1].stamp_ns) + 0.5) * NANOSECONDS)
        # A quarter of the samples, which come in pairs.
        for item in (item for k, item in enumerate(s.items) if k % 8 < 2):
            place = item.position and (item.position[0] + 0.5 * number, *item.position[1:])
            feed(pipeline, [item._replace(stamp_ns=item.stamp_ns + later, position=place)])
        sizes.append(len(pickle.dumps(pipeline)))
    assert pipeline.contact_count == pipeline.site_count == 3 * count
    assert max(sizes[6:]) < 1.02 * sizes[5], sizes
