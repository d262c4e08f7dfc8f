# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The slope of force over displacement as it is measured, by no law.

The truth is a spring, a parabola or an exponential, differentiated by hand.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from pipeline_helpers import begun
from property_helpers import counts

from fden_ros.control import LiveTissue
from fden_ros.core import ContactSummary, Pipeline, Status, TissueState
from fden_ros.core.measured_contacts import MeasuredContacts
from fden_ros.core.measured_stiffness import NOT_MEASURED, BothWays, MeasuredStiffness
from fden_ros.core.outputs import Output
from fden_ros.core.streams import NANOSECONDS, Pair
from fden_ros.parameters import check, pipeline_config
from fden_ros.ros.messages import estimate_message, state_of, summary_message, summary_of

START_NS = 1_000_000_000
RATE = 500.0
SPEED = 0.004
SPRING = 300.0
CONTINUOUS = {"contact.mode": "continuous"}


def way(*legs: tuple[float, float], rate: float = RATE) -> np.ndarray:
    """Return the displacement [m] along legs, each to a place [m] in a time [s]."""
    places, at = [], 0.0
    for to, duration in legs:
        places.append(np.linspace(at, to, max(round(duration * rate), 1), endpoint=False))
        at = to
    return np.concatenate(places)


def press(depth: float = 0.005, speed: float = SPEED) -> np.ndarray:
    """Return a press and its end [m]."""
    return way((depth, depth / speed), (0.0, depth / speed))


def slopes(
    places: np.ndarray, forces: np.ndarray, *, noise: float = 0.0, rate: float = RATE
) -> Iterator[BothWays]:
    """Give what is measured after each sample of one contact."""
    config = pipeline_config(check({"force.noise": noise}))
    measured = MeasuredContacts(config)
    for count, (place, force) in enumerate(zip(places.tolist(), forces.tolist(), strict=True)):
        stamp_ns = START_NS + round(count / rate * NANOSECONDS)
        measured.add(Pair(0, stamp_ns, force, place, None))
        measured.assign(1, in_contact=True)
        yield measured.newest


def last(places: np.ndarray, forces: np.ndarray, **options: float) -> BothWays:
    *_, found = slopes(places, forces, **options)
    return found


def outputs_of(
    places: np.ndarray, forces: np.ndarray, *, at_once: int = 1, **own: object
) -> tuple[Pipeline, list[Output]]:
    """Return what the pipeline puts out: so many samples of a stream come at once."""
    pipeline, outputs = begun(own)
    stamps = [START_NS + round(n / RATE * NANOSECONDS) for n in range(len(places))]
    for start in range(0, len(stamps), at_once):
        part = slice(start, start + at_once)
        for stamp_ns, place in zip(stamps[part], places[part].tolist(), strict=True):
            pipeline.add_displacement(stamp_ns, place)
        for stamp_ns, force in zip(stamps[part], forces[part].tolist(), strict=True):
            pipeline.add_force(stamp_ns, force)
    pipeline.finish()
    return pipeline, outputs


def states_of(outputs: list[Output]) -> list[TissueState]:
    return [output for output in outputs if isinstance(output, TissueState)]


def distinct(found: list[MeasuredStiffness | None]) -> list[MeasuredStiffness]:
    return [one for one, _ in itertools.groupby(found) if one is not None]


def test_spring_has_its_stiffness_at_every_depth():
    places = press()
    found = distinct([both.loading for both in slopes(places, SPRING * places)])
    assert len(found) > 50
    assert [one.value for one in found] == pytest.approx([SPRING] * len(found), rel=1e-9)
    assert max(one.sd for one in found) < 1e-3 * SPRING
    assert found[-1].depth + 0.5 * found[-1].width == pytest.approx(0.005, abs=2e-5)
    assert found[-1].stamp_ns == pytest.approx(START_NS + 1.25 * NANOSECONDS, abs=2e7)


@pytest.mark.parametrize("zero", [0.0, -7.0, 30.0])
def test_zeros_of_force_and_displacement_play_no_part(zero):
    places = press() + 0.1
    found = last(places, SPRING * places + zero).loading
    assert found.value == pytest.approx(SPRING, rel=1e-9)
    assert 0.1 < found.depth < 0.105


def test_parabola_has_its_slope_at_the_depth_that_is_stated():
    places = press()
    curve = 20.0 * places + 4e4 * places**2
    for found in distinct([both.loading for both in slopes(places, curve)]):
        assert found.value == pytest.approx(20.0 + 8e4 * found.depth, rel=2e-3)


def test_exponential_is_straight_enough_over_a_quarter_of_its_force():
    places, scale = press(), 800.0
    found = last(places, 0.02 * np.exp(scale * places)).loading
    true = 0.02 * scale * math.exp(scale * found.depth)
    assert found.value == pytest.approx(true, rel=5e-3)
    assert abs(found.value - true) < 2.0 * found.sd
    assert found.depth > 0.0044


def noisy(seed: int, curve: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float, float]:
    """Return slope, deviation and slope of the curve there, of a noisy press."""
    draw = np.random.default_rng(seed)
    places = press()[: round(0.005 / SPEED * RATE)]
    read = places + 5e-6 * draw.standard_normal(places.size)
    forces = curve(places) + 0.01 * draw.standard_normal(places.size)
    found = last(read, forces).loading
    low, high = (found.depth + side * found.width for side in (-0.5, 0.5))
    fine = np.linspace(low, high, 500)
    return found.value, found.sd, float(np.polyfit(fine, curve(fine), 1)[0])


@pytest.mark.parametrize("count", counts(1, 300))
@pytest.mark.parametrize("shape", ["spring", "exponential"])
def test_interval_holds_the_true_slope(shape, count):
    curves = {"spring": lambda x: SPRING * x, "exponential": lambda x: 0.02 * np.exp(700.0 * x)}
    found = np.array([noisy(seed, curves[shape]) for seed in range(count)])
    errors = (found[:, 0] - found[:, 2]) / found[:, 1]
    assert np.abs(errors).max() < 5.0
    if count > 1:
        assert 0.9 <= np.mean(np.abs(errors) < 1.96) <= 0.995
        assert abs(np.median(errors)) < 0.4


def test_stated_noise_is_the_least_that_counts():
    places = press()
    quiet, noisy_one = (last(places, SPRING * places, noise=noise).loading for noise in (0, 0.01))
    assert noisy_one.sd > 10.0 * quiet.sd
    assert noisy_one.value == pytest.approx(SPRING, rel=1e-6)


def test_slow_samples_are_enough():
    places = way((0.005, 30.0), rate=10.0)
    found = last(places, SPRING * places, rate=10.0).loading
    assert found.value == pytest.approx(SPRING, rel=1e-9)


def test_unloading_is_apart_from_loading():
    places = press()
    turn = int(np.argmax(places))
    forces = np.where(
        np.arange(places.size) <= turn, SPRING * places, 1.5 + 450.0 * (places - 0.005)
    )
    found = last(places, forces)
    assert found.loading.value == pytest.approx(SPRING, rel=1e-3)
    assert found.unloading.value == pytest.approx(450.0, rel=1e-3)


def test_hold_is_no_motion():
    """A relaxing force at rest, with noise of the displacement, is no slope."""
    draw = np.random.default_rng(3)
    places = way((0.005, 1.25), (0.005, 5.0))
    forces = (
        SPRING * places - 0.3 * np.clip(np.arange(places.size) / RATE - 1.25, 0.0, None) ** 0.5
    )
    read = places + 2e-6 * draw.standard_normal(places.size)
    found = distinct([both.loading for both in slopes(read, forces)])
    assert [one.value for one in found[10:]] == pytest.approx([SPRING] * len(found[10:]), rel=0.02)
    assert found[-1].stamp_ns < START_NS + 1.3 * NANOSECONDS


def test_second_ramp_after_a_hold_is_measured_by_itself():
    places = way((0.003, 0.75), (0.003, 1.0), (0.005, 0.5))
    after = np.arange(places.size) / RATE > 1.75
    forces = np.where(after, 0.7 + 500.0 * (places - 0.003), SPRING * places)
    assert last(places, forces).loading.value == pytest.approx(500.0, rel=1e-3)


def test_creeping_end_of_a_press_is_no_new_loading():
    """The last 3 % of the way take longer than all before, and the tissue relaxes meanwhile."""
    places = way((0.0048, 1.2), (0.00495, 3.0))
    force = SPRING * np.minimum(places, 0.0048) + 60.0 * np.maximum(places - 0.0048, 0.0)
    assert last(places, force).loading.value == pytest.approx(SPRING, rel=1e-3)


def test_strokes_after_a_hold_are_measured():
    seconds = np.arange(0.0, 4.0, 1.0 / RATE)
    stroke = 0.005 + 2e-4 * np.sin(2.0 * np.pi * seconds)
    places = np.concatenate([way((0.005, 1.25), (0.005, 1.0)), stroke])
    forces = np.where(np.arange(places.size) / RATE < 2.25, SPRING, 500.0) * (places - 0.005)
    found = last(places, forces)
    assert found.loading.value == pytest.approx(500.0, rel=1e-3)
    assert found.unloading.value == pytest.approx(500.0, rel=1e-3)


@pytest.mark.parametrize(
    ("places", "per_metre"),
    [
        (way((0.0, 4.0)), SPRING),  # at rest
        (way((2e-5, 4.0)), SPRING),  # 20 um against 10 mN
        (press(), 1.0),  # 5 mN against 10 mN
        (press(), -SPRING),  # the sign is wrong
        (press(), 0.0),  # in the air
    ],
)
def test_motion_that_tells_nothing_is_not_measured(places, per_metre):
    draw = np.random.default_rng(5)
    forces = per_metre * places + 0.01 * draw.standard_normal(places.size)
    assert last(places + 1e-6 * draw.standard_normal(places.size), forces) == NOT_MEASURED


def test_steps_of_an_encoder_are_no_turns():
    draw = np.random.default_rng(8)
    places = press()
    forces = SPRING * places + 0.002 * draw.standard_normal(places.size)
    found = last(np.round(places / 5e-5) * 5e-5, forces)
    assert found.loading.value == pytest.approx(SPRING, rel=0.03)
    assert found.unloading.value == pytest.approx(SPRING, rel=0.03)


def test_long_run_takes_no_more_memory():
    config = pipeline_config(check({}))
    measured = MeasuredContacts(config)
    counted = []
    for count in range(40_000):
        place = count * 1e-5
        measured.add(Pair(0, START_NS + count * 2_000_000, SPRING * place, place, None))
        if count in (10_000, 39_999):
            counted.append(len(measured._meter._run.pieces()))
    assert counted[1] <= counted[0] + 30 < 200


def air_and_press(*, from_contact: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and force of a spring, touched at 0."""
    if from_contact:
        places = 0.002 + way((0.0, 0.5), (0.003, 0.75), (0.0, 0.5))
    else:
        places = way((0.0, 1.0), (-0.002, 0.1), (0.005, 1.4), (0.005, 0.5), (-0.002, 1.4))
        places = np.concatenate([places, np.full(500, -0.002)])
    draw = np.random.default_rng(2)
    read = places + 1e-6 * draw.standard_normal(places.size)
    return read, SPRING * np.maximum(places, 0.0) + 1e-3 * draw.standard_normal(places.size)


@functools.cache
def pressed() -> list[Output]:
    """Return what comes of a press from the air."""
    return outputs_of(*air_and_press())[1]


def test_contact_has_the_slopes_where_it_was_deepest():
    outputs = pressed()
    (summary,) = (output for output in outputs if isinstance(output, ContactSummary))
    for found in summary.measured:
        assert abs(found.value - SPRING) < 4.0 * found.sd < 0.1 * SPRING
        assert found.depth + 0.5 * found.width == pytest.approx(0.005, abs=1.5e-4)
    states = states_of(outputs)
    assert any(state.measured.loading for state in states)
    # After the release there is nothing to press.
    assert states[-1].status is Status.NO_CONTACT
    assert states[-1].measured == NOT_MEASURED


def test_recording_that_begins_in_contact_is_measured():
    pipeline, outputs = outputs_of(*air_and_press(from_contact=True))
    newest = states_of(outputs)[-1].measured
    found = newest.loading or pipeline.measured_unseen.loading
    assert abs(found.value - SPRING) < 4.0 * found.sd < 0.1 * SPRING
    assert not any(isinstance(o, ContactSummary) and o.converged for o in outputs)


def test_continuous_contact_is_measured():
    seconds = np.arange(0.0, 12.0, 1.0 / RATE)
    places = 0.004 + 5e-4 * np.sin(2.0 * np.pi * 1.5 * seconds)
    forces = SPRING * places - 7.0 + 1e-3 * np.random.default_rng(4).standard_normal(places.size)
    _, outputs = outputs_of(places, forces, **CONTINUOUS)
    states = [state.measured for state in states_of(outputs) if state.stamp_ns > 2 * START_NS]
    assert all(both.loading is not None and both.unloading is not None for both in states)
    for found in (found for both in states for found in both):
        assert abs(found.value - SPRING) < 5.0 * found.sd
        assert 4.0 * found.sd < found.value
    assert np.median([both.loading.value for both in states]) == pytest.approx(SPRING, rel=0.01)
    (summary,) = (output for output in outputs if isinstance(output, ContactSummary))
    assert summary.measured.loading.value == pytest.approx(SPRING, rel=0.05)


@pytest.mark.parametrize("at_once", [7, 50])
def test_how_samples_come_makes_no_difference(at_once):
    places, forces = air_and_press()
    alone, together = (
        [
            (output.stamp_ns, output.measured)
            for output in outputs
            if isinstance(output, TissueState | ContactSummary)
        ]
        for outputs in (pressed(), outputs_of(places, forces, at_once=at_once)[1])
    )
    assert alone == together


def test_missing_samples_are_not_bridged():
    """The force's zero is another after a gap, as if a sensor had been switched off and on."""
    places, forces = way((0.005, 1.25)), SPRING * way((0.005, 1.25))
    keep = np.ones(places.size, dtype=bool)
    keep[300:360] = False
    pipeline, outputs = begun(CONTINUOUS)
    for count in np.flatnonzero(keep).tolist():
        stamp_ns = START_NS + round(count / RATE * NANOSECONDS)
        pipeline.add_displacement(stamp_ns, float(places[count]))
        pipeline.add_force(stamp_ns, float(forces[count]) + (1.0 if count >= 360 else 0.0))
    found = [state.measured.loading for state in states_of(outputs)]
    values = [one.value for one in distinct(found)]
    assert values == pytest.approx([SPRING] * len(values), rel=1e-6)


def test_nothing_that_is_published_is_infinite():
    draw = np.random.default_rng(6)
    records = [
        (press(1e-9, 1e-9), press(1e-9, 1e-9)),
        (press(10.0, 100.0), 1e6 * press(10.0, 100.0)),
        (draw.standard_normal(2000), draw.standard_normal(2000)),
        (np.repeat(press(), 3), np.repeat(SPRING * press() ** 2, 3)),
    ]
    for (places, forces), own in itertools.product(records, ({}, CONTINUOUS)):
        for output in outputs_of(places, forces, **own)[1]:
            if not isinstance(output, TissueState | ContactSummary):
                continue
            for found in output.measured:
                assert found is None or all(map(math.isfinite, found))
                assert found is None or (found.value > 0.0 and found.sd >= 0.0)


def test_messages_hold_what_is_measured():
    found = BothWays(
        MeasuredStiffness(301.0, 2.0, 0.0045, 0.001, 1_500_000_001),
        MeasuredStiffness(402.0, 3.0, 0.0043, 0.002, 2_500_000_001),
    )
    outputs = pressed()
    state = states_of(outputs)[-1]
    for both in (found, found._replace(unloading=None), found._replace(loading=None)):
        again = state_of(estimate_message(replace(state, measured=both), "tool"))
        assert again.measured == both
    (summary,) = (output for output in outputs if isinstance(output, ContactSummary))
    assert summary_of(summary_message(summary, "tool")).measured == summary.measured


def test_controller_has_what_is_measured_before_anything_converges():
    outputs = pressed()
    live = LiveTissue(deadline=0.1)
    assert live.measured(0.0) == NOT_MEASURED
    first = next(state for state in states_of(outputs) if state.measured.loading)
    now = first.stamp_ns / NANOSECONDS
    live.add(first, now)
    assert live.reading(now) is None
    assert live.measured(now) == first.measured
    assert live.measured(now + 1.0) == NOT_MEASURED
