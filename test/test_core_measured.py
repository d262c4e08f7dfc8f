# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The slope of force over displacement at the end of loading, as it is measured, by no law.

The truth is a spring, a parabola or an exponential, differentiated by hand.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pipeline_helpers import of_columns, states_of, stress_over_g, summaries_of
from property_helpers import counts
from scipy.signal import lfilter

from fden_ros.core import Status
from fden_ros.core.outputs import Flag, Output
from fden_ros.core.stiffness import (
    NOT_MEASURED,
    MeasuredSlope,
    MeasuredSlopes,
    Slopes,
    _accelerations,
)
from fden_ros.core.streams import NANOSECONDS, Pair
from fden_ros.offline.advice import shortfall
from fden_ros.parameters import check, pipeline_config
from fden_ros.ros.messages import estimate_message, state_of, summary_message, summary_of

START_NS = 1_000_000_000
RATE, SPRING = 500.0, 300.0
CONTINUOUS = {"contact.mode": "continuous"}


def way(*legs: tuple[float, float]) -> np.ndarray:
    """Return the displacement [m] along legs, each to a place [m] in a time [s]."""
    places, at = [], 0.0
    for to, duration in legs:
        places.append(np.linspace(at, to, max(round(duration * RATE), 1), endpoint=False))
        at = to
    return np.concatenate(places)


#: A press at 4 mm/s, and its end [m].
PRESS = way((0.005, 1.25), (0.0, 1.25))


def seconds(count: int) -> np.ndarray:
    return np.arange(count) / RATE


def after(times: np.ndarray, forces: np.ndarray, places: np.ndarray, **own: Any) -> MeasuredSlopes:
    """Return what has been measured after the samples of one contact."""
    surface, air = own.pop("surface", 0.0), (own.pop("bias", 0.0), own.pop("noise", 0.0), 0.0, 0.0)
    measured = MeasuredSlopes(pipeline_config(check({k.replace("__", "."): own[k] for k in own})))
    for time, force, place in zip(*(c.tolist() for c in (times, forces, places)), strict=True):
        measured.add(Pair(0, START_NS + round(time * NANOSECONDS), force, place, None))
        measured.assign(1, air, surface, in_contact=True)
    return measured


def last(places: np.ndarray, forces: np.ndarray, **options: float) -> Slopes:
    return after(seconds(places.size), forces, places, **options).newest


CURVES: dict[str, tuple[Callable, Callable]] = {
    "spring": (lambda x: SPRING * x, lambda x: SPRING),
    "parabola": (lambda x: 20.0 * x + 4e4 * x**2, lambda x: 20.0 + 8e4 * x),
    "exponential": (lambda x: 0.02 * np.exp(700.0 * x), lambda x: 14.0 * math.exp(700.0 * x)),
}


@pytest.mark.parametrize("name", CURVES)
def test_slope_is_that_of_the_curve_at_the_deepest_point(name):
    """With a tool of 1 mm/N before a sensor that reads 30 N in the air; unloading is apart."""
    curve, derivative = CURVES[name]
    is_before = np.arange(PRESS.size) <= int(np.argmax(PRESS))
    force = np.where(is_before, curve(PRESS), curve(0.005) + 700.0 * (PRESS - 0.005))
    read, own = 0.1 + PRESS + 1e-3 * force, {"displacement__compliance": 1e-3}
    loading, unloading = last(read, force + 30.0, surface=0.1, bias=30.0, **own)
    assert loading.value == pytest.approx(derivative(loading.depth), rel=5e-3)
    assert unloading.value == pytest.approx(700.0, rel=5e-3)
    for one in (loading, unloading):
        assert one.depth == pytest.approx(0.005, abs=4e-5)
        assert one.stamp_ns == pytest.approx(START_NS + 1.25 * NANOSECONDS, abs=1.5e7)


def test_an_unsure_delay_counts_where_the_curve_bends():
    places = way((0.005, 1.25))
    found = last(places, CURVES["exponential"][0](places), displacement__delay_sd=0.01).loading
    bend = 0.02 * 700.0**2 * math.exp(700.0 * found.depth)
    assert found.sd == pytest.approx(bend * 0.004 * 0.01, rel=0.1)


def noisy(seed: int, name: str) -> tuple[float, float, float]:
    """Return slope, deviation and slope of the curve there, of a noisy press."""
    draw, (curve, derivative) = np.random.default_rng(seed), CURVES[name]
    places = way((0.005, 1.25))
    read = places + 5e-6 * draw.standard_normal(places.size)
    found = last(read, curve(places) + 0.01 * draw.standard_normal(places.size)).loading
    return found.value, found.sd, derivative(found.depth)


@pytest.mark.parametrize("count", counts(20, 300))
@pytest.mark.parametrize("name", ["spring", "exponential"])
def test_interval_holds_the_true_slope(name, count):
    found = np.array([noisy(seed, name) for seed in range(count)])
    errors = (found[:, 0] - found[:, 2]) / found[:, 1]
    assert np.abs(errors).max() < 5.0
    assert np.mean(np.abs(errors) < 1.96) >= (0.9 if count > 20 else 0.8)


#: Motions whose last part is another: places, and the force at them.
HOLD = way((0.005, 1.25), (0.005, 5.0))
STEPS = way((0.003, 0.75), (0.003, 1.0), (0.005, 0.5))
CREEP = way((0.0048, 1.2), (0.00495, 3.0))
SECONDS = seconds(2000)
STROKES = np.r_[way((0.005, 1.25), (0.005, 1.0)), 0.005 + 2e-4 * np.sin(2.0 * np.pi * SECONDS)]
AT_FORCE = np.r_[way((0.005, 1.25)), 0.005 + 1e-3 * np.log1p(SECONDS) / np.log(5.0)]


@pytest.mark.parametrize(
    ("places", "forces", "slope", "depth"),
    [
        (HOLD, SPRING * HOLD - 0.3 * np.arange(-625, 2500).clip(0) ** 0.5 / 20.0, SPRING, 0.005),
        (STEPS, SPRING * STEPS + 200.0 * (STEPS - 0.003).clip(0), 500.0, 0.005),
        # The last 3 % of the way take longer than all before, and the tissue relaxes meanwhile.
        (CREEP, SPRING * np.minimum(CREEP, 48e-4) + 60.0 * (CREEP - 48e-4).clip(0), SPRING, 48e-4),
        # A load that is held: the depth creeps by a millimetre.
        (AT_FORCE, SPRING * np.minimum(AT_FORCE, 0.005), SPRING, 0.005),
        (STROKES, np.r_[SPRING * STROKES[:1125], 500.0 * STROKES[1125:] - 1], 500.0, 0.005),
    ],
    ids=["hold", "second ramp after a hold", "creeping end", "held load", "strokes after a hold"],
)  # fmt: skip
def test_loading_ends_where_the_force_no_longer_rises(places, forces, slope, depth):
    read = places + 2e-6 * np.random.default_rng(3).standard_normal(places.size)
    found = last(read, forces).loading
    assert found.value == pytest.approx(slope, rel=0.03)
    assert found.depth == pytest.approx(depth, abs=1e-4)


@pytest.mark.parametrize(
    ("places", "per_metre"),
    [
        (way((0.0, 4.0)), SPRING),  # at rest
        (way((2e-5, 4.0)), SPRING),  # 20 um against 10 mN
        (PRESS, 1.0),  # 5 mN against 10 mN
        (PRESS, -SPRING),  # the sign is wrong
        (PRESS, 0.0),  # in the air
    ],
)
def test_motion_that_tells_nothing_is_not_measured(places, per_metre):
    draw = np.random.default_rng(5)
    forces = per_metre * places + 0.01 * draw.standard_normal(places.size)
    assert last(places + 1e-6 * draw.standard_normal(places.size), forces) == NOT_MEASURED


@functools.cache
def pressed() -> list[Output]:
    """Return what comes of a press of a spring from the air, touched at 1 mm."""
    places = way((0.0, 1.0), (-0.002, 0.1), (0.005, 1.4), (0.005, 0.5), (-0.002, 1.4))
    places, draw = np.concatenate([places, np.full(500, -0.002)]), np.random.default_rng(2)
    read = places + 1e-3 + 1e-6 * draw.standard_normal(places.size)
    forces = SPRING * np.maximum(places, 0.0) + 1e-3 * draw.standard_normal(places.size)
    return of_columns({}, seconds(read.size), forces, read)[1]


def test_contact_has_the_slopes_where_it_was_deepest():
    (summary,) = summaries_of(pressed())
    for found in summary.measured:
        assert abs(found.value - SPRING) < 4.0 * found.sd < 0.3 * SPRING
        assert found.depth == pytest.approx(0.005, abs=1.5e-4)
    states = states_of(pressed())
    assert any(state.measured.loading for state in states)
    # After the release there is nothing to press.
    assert states[-1].status is Status.NO_CONTACT and states[-1].measured == NOT_MEASURED


def test_recording_that_begins_in_contact_is_measured():
    places = 0.002 + way((0.0, 0.5), (0.003, 0.75), (0.0, 0.5))
    forces = SPRING * places + 1e-3 * np.random.default_rng(2).standard_normal(places.size)
    pipeline, _ = of_columns({}, seconds(places.size), forces, places)
    found = pipeline.measured_unseen.loading
    assert abs(found.value - SPRING) < 4.0 * found.sd < 0.1 * SPRING


def test_continuous_contact_is_measured():
    times = seconds(6000)
    places = 0.004 + 5e-4 * np.sin(2.0 * np.pi * 1.5 * times)
    forces = SPRING * places - 7.0 + 1e-3 * np.random.default_rng(4).standard_normal(places.size)
    _, outputs = of_columns(CONTINUOUS, times, forces, places)
    states = [state.measured for state in states_of(outputs)[200:]]
    found = [one for both in states for one in both]
    assert all(one and abs(one.value - SPRING) < 5.0 * one.sd for one in found)
    assert np.median([one.value for one in found]) == pytest.approx(SPRING, rel=0.01)
    assert all(math.isnan(one.depth) for one in found)  # no surface is known


def test_missing_samples_are_not_bridged():
    """The force's zero is another after a gap, as if a sensor had been switched off and on."""
    places, kept = way((0.005, 1.25)), np.r_[:300, 360:625]
    forces = SPRING * places + np.where(np.arange(625) < 360, 0.0, 1.0)
    _, outputs = of_columns(CONTINUOUS, seconds(625)[kept], forces[kept], places[kept])
    values = [s.measured.loading.value for s in states_of(outputs) if s.measured.loading]
    assert len(values) > 10 and values == pytest.approx([SPRING] * len(values), rel=1e-6)


def test_messages_hold_what_is_measured():
    slopes_known = MeasuredSlope(301.0, 2.0, 0.0045, 7), MeasuredSlope(402.0, 3.0, 0.0043, 9)
    state = states_of(pressed())[-1]
    for both in (Slopes(*slopes_known), Slopes(slopes_known[0]), Slopes(None, slopes_known[1])):
        again = state_of(estimate_message(replace(state, measured=both), "tool"))
        assert again.measured == both
    (summary,) = summaries_of(pressed())
    assert summary_of(summary_message(summary, "tool")).measured == summary.measured


def clipped(seed: int, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, forces and displacements of a press of the paper's law, by its own convolution.

    The force is cut off at a `part` of its peak; the noise is added after that.
    """
    draw, rate = np.random.default_rng(seed), (100.0, 200.0, 500.0)[seed % 3]
    time, speed = np.arange(0.0, 7.0, 1.0 / rate), draw.uniform(4e-3, 16e-3)
    alpha, gn, travel = draw.uniform(0.05, 0.3), draw.uniform(5.0, 11.0), 0.008
    corners = np.cumsum([2.0, travel / speed, draw.uniform(0.2, 2.0), travel / speed])
    places = np.interp(time, corners, [-0.003, 0.005, 0.005, -0.003])
    force = stress_over_g(np.maximum(places, 0.0) / 0.02, 1.0 / rate, gn, alpha)
    force *= 0.2 / force.max()
    read = np.minimum(force, part * force.max()) + 8e-4 * draw.standard_normal(time.size)
    return time, read, places + 1e-6 * draw.standard_normal(time.size)


@pytest.mark.parametrize("count", counts(8, 200))
@pytest.mark.parametrize(("part", "size"), [(1.0, 1.0), (0.6, 1.0), (0.75, 1.0), (1.0, 1e-4)])
def test_a_force_whose_envelope_stands_still_while_the_probe_goes_on_is_saturated(
    part, size, count
):
    """Of an atomic force microscope's bead too, on the way of a micrometre."""
    found = []
    for seed in range(count):
        times, forces, places = clipped(seed, part)
        probe = {"geometry__thickness": 0.02 * size, "force__noise_floor": 1e-5 * size**2}
        found.append(after(times, size**2 * forces, size * places, **probe))
    is_cut_off = [measured.is_saturated for measured in found]
    assert np.mean(is_cut_off) >= 0.9 if part < 1.0 else not any(is_cut_off)
    assert all(one.of(1) == NOT_MEASURED for one in found if one.is_saturated)


def test_nothing_is_claimed_of_a_saturated_contact():
    parameters = {"geometry.area": 3.14e-4, "geometry.thickness": 0.02}
    (found,) = summaries_of(of_columns(parameters, *clipped(1, 0.75))[1])
    assert Flag.SATURATED in found.flags
    assert not found.converged and found.estimate is None and found.apparent_stiffness is None
    assert found.measured == NOT_MEASURED
    assert "press less" in shortfall(found, pipeline_config(check(parameters)))


def test_a_bend_that_narrower_windows_show_counts_in_wider_ones():
    """What a cubic changes vanishes by chance at some width: a slope was 20 +- 4 for 35."""
    places, share = np.arange(0.0, 0.005, 2.5e-5), 0.12
    forces, known = 0.005 * np.expm1(600.0 * places), 0
    for seed in range(8):
        noise = 0.01 * np.random.default_rng(seed).standard_normal(places.size + 200)
        noise = lfilter([share], [1.0, share - 1.0], noise)[200:]
        times = np.arange(places.size) / 200.0
        found = after(times, forces + noise, places, noise=0.01).of(1).loading
        if found is not None:
            true = 0.005 * 600.0 * math.exp(600.0 * found.depth)
            assert abs(found.value - true) < 3.0 * found.sd
            known += 1
    assert known >= 4


def test_two_pieces_at_one_time_have_no_acceleration_between_them():
    columns = np.zeros((8, 10))
    columns[0], columns[1], columns[2] = 1e-3, 0.1, np.repeat(np.arange(5.0), 2)
    columns[0, 4:] = 2e-3
    found = _accelerations(columns)
    assert np.all(np.isfinite(found)) and found.max() == pytest.approx(0.5 * 0.01)


def test_depth_in_a_dent_is_below_the_surface_of_the_first_touch():
    times = np.arange(0.0, 5.4, 0.005)
    corners = [2.0, 2.75, 3.2, 3.6, 4.0, 4.6]
    places = np.interp(times, corners, [-0.002, 0.004, 0.004, 0.0, 0.004, -0.002])
    surfaces = np.where(times < 3.2, 0.0, 0.002)
    forces = SPRING * np.maximum(places - surfaces, 0.0)
    forces += 1e-3 * np.random.default_rng(6).standard_normal(times.size)
    parameters = {"geometry.area": 3.14e-4, "geometry.thickness": 0.02}
    found = summaries_of(of_columns(parameters, times, forces, places)[1])
    assert [one.site_id for one in found] == [1, 1]
    for one in found:
        assert one.measured.loading.depth == pytest.approx(0.004, abs=3e-4)
