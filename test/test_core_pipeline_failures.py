# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whatever the computation raises, or comes in, the pipeline goes on."""

from __future__ import annotations

import itertools
import math
import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, assert_sound, outcome_of, shift, undisturbed
from hypothesis import example, given
from hypothesis import strategies as st
from pipeline_helpers import Item, feed
from property_helpers import examples

from fden_ros.core.contact import ContactDetector
from fden_ros.core.outputs import Flag, Status, TissueState
from fden_ros.core.paper_filter import PaperFilter
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import Synchronizer
from fden_ros.parameters import check, pipeline_config

#: It takes a sixth of the time of the grid; test_faults.py has an exception of that.
PAPER = {"estimator.kind": "ekf"}

# Whatever the computation raises ends one contact and its site; all else goes on


class BrokenError(Exception):
    """What no code of the package raises or catches."""


def breaks(
    monkeypatch: pytest.MonkeyPatch, kind: type, name: str, when: Callable[[Any], bool]
) -> list[int]:
    """Let a method raise, or give no numbers, where `when` says so; return a list of its calls."""
    real, calls = getattr(kind, name), []

    def broken(self: Any, *arguments: Any, **named: Any) -> Any:
        calls.append(1)
        if not when(self):
            return real(self, *arguments, **named)
        if name != "estimate":
            raise BrokenError("on purpose")
        found = real(self)
        return found._replace(covariance=found.covariance * np.nan)

    monkeypatch.setattr(kind, name, broken)
    return calls


def of_first_site(after: int = 0) -> Callable[[PaperFilter], bool]:
    """Of the estimator that was called first, from a number of calls on."""
    seen: list[PaperFilter] = []

    def when(estimator: PaperFilter) -> bool:
        seen.append(estimator)
        return estimator is seen[0] and len(seen) > after

    return when


def with_paper(steps: Sequence[Any], **parameters: object) -> Outcome:
    outcome = outcome_of(steps, shift().parameters | PAPER | parameters)
    assert_sound(outcome.outputs)
    return outcome


RAISING = {"touch": 0, "add": 20, "release": 0}.items()


@pytest.mark.parametrize(
    ("name", "after", "reason", "place"),
    [
        *((name, after, "BrokenError: on purpose", "in broken") for name, after in RAISING),
        ("estimate", 20, "not finite", "in _check_finite"),
    ],
)
def test_an_exception_of_the_estimator_ends_its_contact_and_site_and_no_other(
    monkeypatch, name, after, reason, place
):
    clean = undisturbed(kind="ekf")
    breaks(monkeypatch, PaperFilter, name, of_first_site(after))
    outcome = with_paper(shift().items)
    first, *others = outcome.summaries
    assert first.flags & Flag.ESTIMATION_FAILED and not first.complete
    assert first.estimate is None and not first.converged
    assert repr(others) == repr(clean.summaries[1:])
    (failure,) = outcome.pipeline.failures
    assert (failure.site_id, failure.contact_id) == (1, 1)
    assert reason in failure.reason
    assert "Traceback" in failure.traceback and place in failure.traceback
    after_it = [x for x in outcome.states if x.site_id == 1 and x.stamp_ns > failure.stamp_ns]
    assert after_it and all(x.estimate is None for x in after_it)
    in_contact = [x for x in after_it if x.status is not Status.NO_CONTACT]
    assert all(x.status is Status.UNKNOWN for x in in_contact)
    assert all(x.flags & Flag.ESTIMATION_FAILED for x in in_contact)


@pytest.mark.parametrize("is_reset", [False, True])
def test_a_failed_site_stays_unusable_until_a_reset(monkeypatch, is_reset):
    breaks(monkeypatch, PaperFilter, "add", of_first_site(20))
    # All at one place: the second and third contact are of the same site.
    steps: list[Any] = [item._replace(position=None) for item in shift().items]
    if is_reset:
        steps.insert(sum(shift().second(item.stamp_ns) < 7.0 for item in steps), Pipeline.reset)
    outcome = with_paper(steps, **{"site.timeout": 100.0})
    first, *others = outcome.summaries
    assert first.flags & Flag.ESTIMATION_FAILED and not first.complete
    if is_reset:
        assert others[0].converged and not others[0].flags
        assert not outcome.pipeline.is_failed
    else:
        assert [c.site_id for c in others] == [1, 1] and outcome.pipeline.is_failed
        assert all(c.flags & Flag.ESTIMATION_FAILED and c.estimate is None for c in others)
        assert all(c.complete and c.max_force > 0.05 and c.sample_count > 100 for c in others)
        assert outcome.pipeline.failure_count == 1


@pytest.mark.parametrize("kind", [ContactDetector, Synchronizer])
def test_detector_and_synchronizer_begin_anew_after_an_exception(monkeypatch, kind):
    calls: list[int] = []
    name = "add" if kind is ContactDetector else "add_force"
    calls = breaks(monkeypatch, kind, name, lambda _: len(calls) == 500)
    outcome = with_paper(shift().items)
    assert outcome.pipeline.failure_count == 1
    assert outcome.summaries[-1].converged and outcome.summaries[-1].complete


def test_what_a_listener_raises_is_not_caught():
    def listen(output: object) -> None:
        raise BrokenError("the listener's")

    s = shift()
    pipeline = Pipeline(pipeline_config(check(s.parameters)), listen)
    with pytest.raises(BrokenError, match="the listener's"):
        feed(pipeline, s.items)
    assert not pipeline.failures


# What holds for the pipeline whatever comes in: arbitrary and damaged streams (hypothesis)


START_NS = 1_700_000_000_000_000_000

values = st.one_of(
    st.floats(-1.0, 1.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 5e-324, 1e300, -1e300, math.nan, math.inf, 9.9e4, 9.99]),
)
ODD_STEPS = [0, 1, 9_999, 10_000, 10**6, 10**9, 10**11, -1, -(10**6), -(10**9), -(10**12)]
steps = st.one_of(st.integers(1, 30_000_000), st.sampled_from(ODD_STEPS))
events = st.lists(st.tuples(st.integers(0, 1), steps, values, st.booleans()), max_size=300)
modes = st.sampled_from(
    [
        {},
        {"estimator.kind": "ekf"},
        {"geometry.kind": "sphere", "geometry.radius": 0.005},
        {"origin.source": "given", "force.measure_bias": False, "force.threshold": 0.01},
        {"displacement.delay": 0.01, "prior.nonlinear_stiffness_log_sd": 1.0},
    ]
)


def checked(items: Sequence[Item], parameters: dict[str, object]) -> Outcome:
    """Hold the invariants for one stream."""
    outcome = outcome_of(items, parameters)
    assert not outcome.pipeline.failures
    assert_sound(outcome.outputs)
    stamps = [o.stamp_ns for o in outcome.outputs if isinstance(o, TissueState)]
    back = sum(after <= before for before, after in itertools.pairwise(stamps))
    jumps = sum(n for words, n in outcome.pipeline.warnings.items() if "jumped back" in words)
    assert back <= jumps
    return outcome


@examples(60)
@example(
    [(0, 1, 0.0, False)] * 11
    + [(0, 9990, 0.0, False), (0, 10000, 5e-324, False), (0, 10000, 1.0, False)],
    {},
)
@given(events, modes)
def test_any_stream_gives_sound_and_repeatable_outputs(stream, parameters):
    items, now = [], START_NS
    for which, step, value, has_position in stream:
        now += step
        position = (value, 0.0, value) if has_position else None
        items.append(Item(which, now, value, position if which else None))
    parameters = {"geometry.area": 1e-4, "geometry.thickness": 0.02, **parameters}
    once, again = checked(items, parameters), checked(items, parameters)
    assert pickle.dumps(once.outputs) == pickle.dumps(again.outputs)


#: What a kind of damage makes of successive samples, by a value and a step of the stamp.
DAMAGE: dict[str, Callable[[list[Item], float, int], list[Item]]] = {
    "value": lambda part, value, step: [i._replace(value=value) for i in part],
    "add": lambda part, value, step: [i._replace(value=i.value + value) for i in part],
    "scale": lambda part, value, step: [i._replace(value=i.value * value) for i in part],
    "stamp": lambda part, value, step: [i._replace(stamp_ns=i.stamp_ns + step) for i in part],
    "drop": lambda part, value, step: [],
    "repeat": lambda part, value, step: [i for i in part for _ in range(2)],
    "swap": lambda part, value, step: part[::-1],
    "freeze": lambda part, value, step: [i._replace(value=part[0].value) for i in part],
}
damages = st.lists(
    st.tuples(
        st.sampled_from([*DAMAGE]), st.integers(0, 1199), st.integers(1, 120), values, steps
    ),
    max_size=8,
)


@examples(4)
@example([("add", 757, 45, 9.99, 101), ("value", 332, 1, 0.434, 1)], {})
@example(
    [
        ("value", 100, 12, 1e5 + 1, 1),
        *2 * [("repeat", 0, 53, 0.0, 1)],
        ("value", 688, 82, 1e5 + 1, 1),
    ],
    {"geometry.kind": "sphere", "geometry.radius": 0.005},
)
@given(damages, modes)
def test_any_damage_to_a_contact_gives_sound_outputs(done, parameters):
    s = shift()
    items = [i for i in s.items if 1.2 < s.second(i.stamp_ns) < 5.2]
    for kind, place, length, value, step in done:
        part = items[place : place + length]
        if part:
            items[place : place + length] = DAMAGE[kind](part, value, step)
    checked(items, dict(s.parameters) | parameters)


def test_stamps_that_are_no_whole_nanoseconds_and_arrays_for_samples_are_refused():
    pipeline = Pipeline(pipeline_config(check({})), lambda output: None)
    for add in (pipeline.add_force, pipeline.add_displacement):
        add(np.int64(1), np.float64(0.1))
        for stamp in (1.5, np.array([1]), "1"):
            with pytest.raises(TypeError, match="give whole nanoseconds"):
                add(stamp, 0.1)
        with pytest.raises(TypeError, match=r"^a sample is array.*one number at a time$"):
            add(2, np.arange(500.0))  # in one line
