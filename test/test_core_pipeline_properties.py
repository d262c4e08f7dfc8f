# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What holds for the pipeline whatever comes in: arbitrary and damaged streams (hypothesis)."""

from __future__ import annotations

import itertools
import math
import pickle
from collections.abc import Sequence

from fault_helpers import assert_sound, outcome_of, shift
from hypothesis import example, given
from hypothesis import strategies as st
from pipeline_helpers import Item
from property_helpers import examples

from fden_ros.core.outputs import TissueState

START_NS = 1_700_000_000_000_000_000

values = st.one_of(
    st.floats(-1.0, 1.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 5e-324, 1e300, -1e300, math.nan, math.inf, 9.9e4, 9.99]),
)
steps = st.one_of(
    st.integers(1, 30_000_000),
    st.sampled_from(
        [0, 1, 9_999, 10_000, 10**6, 10**9, 10**11, -1, -(10**6), -(10**9), -(10**12)]
    ),
)
events = st.lists(st.tuples(st.integers(0, 1), steps, values, st.booleans()), max_size=300)
modes = st.sampled_from(
    [
        {},
        {"estimator.observation": "fractional_stress"},
        {"geometry.kind": "sphere", "geometry.radius": 0.005},
        {"origin.source": "given", "force.measure_bias": False, "force.threshold": 0.01},
        {"displacement.delay": 0.01, "prior.nonlinear_stiffness_log_sd": 1.0},
    ]
)


def checked(items: Sequence[Item], parameters: dict[str, object]) -> None:
    """Hold the invariants for one stream, run twice."""
    parameters = {"geometry.area": 1e-4, "geometry.thickness": 0.02, **parameters}
    outcome, again = outcome_of(items, parameters), outcome_of(items, parameters)
    assert not outcome.pipeline.failures
    assert_sound(outcome.outputs)
    assert pickle.dumps(outcome.outputs) == pickle.dumps(again.outputs)
    stamps = [o.stamp_ns for o in outcome.outputs if isinstance(o, TissueState)]
    back = sum(after <= before for before, after in itertools.pairwise(stamps))
    jumps = sum(n for words, n in outcome.pipeline.warnings.items() if "jumped back" in words)
    assert back <= jumps
    assert outcome.pipeline._synchronizer.waiting < 50_000


@examples(100)
@example(
    [(0, 1, 0.0, False)] * 11
    + [(0, 9990, 0.0, False), (0, 10000, 5e-324, False), (0, 10000, 1.0, False)],
    {},
)
@example(
    [(0, 1, 0.0, False)] * 8
    + [(0, 9993, 5e-324, False), (0, 10000, 0.0, False), (0, 10000, 1.0, False)],
    {},
)
@example(
    [(0, 1, 0.0, False)] * 4
    + [(0, 1000000, 5e-324, False), (0, 1_000_000_000, 0.0, False)]
    + [(0, 5189, 0.0, False), (0, 5189, 0.9999999999999999, False)],
    {},
)
@given(events, modes)
def test_any_stream_gives_sound_and_repeatable_outputs(
    stream: list[tuple[int, int, float, bool]], parameters: dict[str, object]
) -> None:
    items, now = [], START_NS
    for which, step, value, has_position in stream:
        now += step
        position = (value, 0.0, value) if has_position else None
        items.append(Item(which, now, value, position if which else None))
    checked(items, parameters)


damages = st.lists(
    st.tuples(
        st.sampled_from(["value", "add", "scale", "stamp", "drop", "repeat", "swap", "freeze"]),
        st.integers(0, 1199),
        st.integers(1, 120),
        values,
        steps,
    ),
    max_size=8,
)


def damaged(kind: str, item: Item, first: Item, value: float, step: int) -> list[Item]:
    """Return what a kind of damage makes of one sample."""
    if kind == "drop":
        return []
    if kind == "repeat":
        return [item, item]
    if kind == "stamp":
        return [item._replace(stamp_ns=item.stamp_ns + step)]
    new = {
        "value": value,
        "add": item.value + value,
        "scale": item.value * value,
        "freeze": first.value,
    }
    return [item._replace(value=new.get(kind, item.value))]


@examples(8)
@example([("add", 757, 45, 9.99, 101), ("value", 332, 1, 0.434, 1)], {})
@example(
    [
        ("value", 100, 12, 100001.0, 1),
        ("repeat", 0, 53, 0.0, 1),
        ("repeat", 0, 53, 0.0, 1),
        ("value", 688, 82, 100001.0, 1),
    ],
    {"geometry.kind": "sphere", "geometry.radius": 0.005},
)
@example(
    [
        ("value", 0, 1, 0.0, 1),
        ("value", 0, 1, 0.0, 1),
        ("value", 0, 8, 0.0, 1),
        ("freeze", 1101, 11, 0.0, 1),
    ],
    {"estimator.observation": "fractional_stress"},
)
@given(damages, modes)
def test_any_damage_to_a_contact_gives_sound_and_repeatable_outputs(
    done: list[tuple[str, int, int, float, int]], parameters: dict[str, object]
) -> None:
    s = shift()
    items = [i for i in s.items if 1.2 < s.second(i.stamp_ns) < 5.2]
    for kind, place, length, value, step in done:
        part = items[place : place + length]
        if not part:
            continue
        new = [c for item in part for c in damaged(kind, item, part[0], value, step)]
        items[place : place + length] = new[::-1] if kind == "swap" else new
    checked(items, dict(s.parameters) | parameters)
