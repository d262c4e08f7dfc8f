# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Pairing two streams by stamp: the same pairs however samples arrive, every rejection counted."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples

from fden_ros.core.streams import SynchronizeConfig, Synchronizer, gap_before

MS = 1_000_000
START = 1_700_000_000_000_000_000
FORCE, DISPLACEMENT = "force", "displacement"


class Run:
    """A synchronizer with what it gave."""

    def __init__(self, **config):
        self.pairs, self.rejected = [], Counter()
        self.synchronizer = Synchronizer(
            SynchronizeConfig(**config), self.pairs.append, self.rejected
        )

    def add(self, stream, stamp_ns, value=0.0, *position):
        getattr(self.synchronizer, f"add_{stream}")(stamp_ns, value, *position)
        return self

    def both(self, stamp_ns, force=0.0):
        return self.add(DISPLACEMENT, stamp_ns).add(FORCE, stamp_ns, force)

    @property
    def stamps(self):
        return [(pair.stamp_ns - START) / MS for pair in self.pairs]


#: Steps between stamps [ns]: mostly sound ones, and everything that goes wrong.
steps = st.one_of(
    st.integers(MS // 10, 20 * MS),
    st.integers(MS // 10, 20 * MS),
    st.sampled_from([0, 1000, -1000, 9_999, 10_000]),
    st.integers(-400 * MS, -MS),
    st.integers(-3000 * MS, -600 * MS),
    st.integers(300 * MS, 3000 * MS),
)
values = st.one_of(st.floats(-5.0, 5.0), st.sampled_from([np.nan, 1e9]))
rows = st.lists(st.tuples(steps, values), max_size=60)


def samples(name, rows):
    stamps = itertools.accumulate(step for step, _ in rows)
    return [(name, START + s, value) for s, (_, value) in zip(stamps, rows, strict=True)]


@examples(100)
@given(forces=rows, displacements=rows, choices=st.randoms())
def test_pairs_do_not_depend_on_how_the_streams_are_interleaved(forces, displacements, choices):
    # A window that holds everything: what waits too long is another test's matter.
    a, b = samples(FORCE, forces), samples(DISPLACEMENT, displacements)
    later = iter(a), iter(b)
    turns = [*([0] * len(a)), *([1] * len(b))]
    choices.shuffle(turns)
    results = []
    for order in (a + b, b + a, [next(later[turn]) for turn in turns]):
        run = Run(max_wait=1e6)
        for sample in order:
            run.add(*sample)
        results.append((run.pairs, run.rejected))
    assert results[0] == results[1] == results[2]


@examples(40)
@given(
    jumps=st.lists(st.integers(-8000 * MS, -700 * MS), max_size=3),
    seed=st.integers(0, 2**32 - 1),
)
def test_arrival_within_the_window_does_not_matter_either_when_the_clock_jumps(jumps, seed):
    rng = np.random.default_rng(seed)
    offsets = np.cumsum([20_000 * MS, *jumps]).tolist()
    rows = [
        ((3000 * part + ms) * MS, name, START + (3000 * part + ms) * MS + offset, 1e-3 * ms)
        for part, offset in enumerate(offsets)
        for name, period in ((FORCE, 20), (DISPLACEMENT, 50))
        for ms in range(0, 3000, period)
    ]
    results = []
    for _ in range(3):
        lag = {FORCE: rng.uniform(0, 1000), DISPLACEMENT: rng.uniform(0, 1000)}
        run = Run()
        for _, *sample in sorted(rows, key=lambda r: r[0] + lag[r[1]] * MS):
            run.add(*sample)
        results.append((run.pairs, run.rejected))
    assert results[0] == results[1] == results[2]
    assert {pair.epoch for pair in results[0][0]} == set(range(len(offsets)))


@examples(100)
@given(
    start=st.floats(-1.0, 1.0),
    speed=st.floats(-1.0, 1.0),
    force_ms=st.lists(st.integers(1, 999), min_size=1, max_size=30, unique=True).map(sorted),
    delay_ms=st.integers(-50, 50),
)
def test_interpolation_of_a_linear_motion_is_exact(start, speed, force_ms, delay_ms):
    run = Run(displacement_delay=delay_ms * 1e-3)
    for ms in range(-100, 1101, 50):
        value = start + speed * ms * 1e-3
        run.add(DISPLACEMENT, START + (ms + delay_ms) * MS, value, (value, -value, 1.0))
    for ms in force_ms:
        run.add(FORCE, START + ms * MS, 1.0)
    assert run.stamps == force_ms
    for pair, ms in zip(run.pairs, force_ms, strict=True):
        exact = start + speed * ms * 1e-3
        assert pair.displacement == pytest.approx(exact, abs=1e-14)
        assert pair.position == pytest.approx((exact, -exact, 1.0), abs=1e-14)


def test_no_interpolation_over_a_gap_longer_than_allowed():
    run = Run(max_gap=0.25)
    run.add(DISPLACEMENT, START, 0.0)
    for ms in (0, 100, 200, 251):
        run.add(FORCE, START + ms * MS)
    run.add(DISPLACEMENT, START + 251 * MS, 1.0)
    assert run.rejected == {"force.displacement_gap": 2}
    assert run.stamps == [0, 251]
    run.add(FORCE, START + 400 * MS).add(DISPLACEMENT, START + 501 * MS, 1.0)
    assert run.stamps == [0, 251, 400]


def test_run_of_late_stamps_is_a_jump_of_the_clock_too():
    # A bag that loops after 0.4 s: each stamp is late by less than a jump.
    run = Run()
    for ms in 2 * [*range(0, 400, 4)]:
        run.both(START + ms * MS)
    # The first 19 of a run of 20 are taken for late ones.
    assert run.rejected == {"force.late_stamp": 19, "displacement.late_stamp": 19}
    assert [pair.epoch for pair in run.pairs] == [0] * 100 + [1] * 81


JITTER = np.random.default_rng(0).uniform(-1e3, 1e3, 120)
SLOW = {
    "every 5 s, with jitter": np.arange(0.0, 600e3, 5e3) + JITTER,
    "log-spaced, 5 a decade": np.geomspace(10.0, 1e6, 26),
    "100 Hz, then log-spaced": np.r_[0.0:5e3:10.0, 5e3 + np.geomspace(10.0, 1e6, 51)],
}


@pytest.mark.parametrize("times_ms", SLOW.values(), ids=SLOW)
def test_slow_and_log_spaced_samples_are_paired(times_ms):
    stamps = (START + np.round(times_ms * MS)).astype(int).tolist()
    same, apart = Run(), Run()
    for before, stamp in zip([START - 5_000 * MS, *stamps], stamps, strict=False):
        same.both(stamp)
        # The displacement lags the force by half a step.
        apart.add(DISPLACEMENT, (before + stamp) // 2).add(FORCE, stamp)
    # The last stamp is held until the next one confirms it.
    assert len(same.pairs) >= len(stamps) - 1 and not same.rejected
    # Of 5 a decade each is 1.6 times as far as the one before: too far to interpolate between.
    if stamps[-1] - stamps[-2] < 1.3 * (stamps[-2] - stamps[-3]):
        assert len(apart.pairs) >= len(stamps) - 5 and apart.rejected.total() <= 3


def test_one_of_a_hundred_samples_lost_at_2_khz_is_no_gap_and_20_ms_of_them_are():
    kept = np.random.default_rng(1).uniform(size=20_000) > 0.01
    # And a burst of 15 ms, as a middleware that is too slow loses them.
    kept[10_000:10_030] = False
    run = Run()
    stamps = (500_000 * np.flatnonzero(kept) + START).tolist()
    for stamp in [*stamps, stamps[-1] + 21 * MS, stamps[-1] + 22 * MS]:
        run.both(stamp)
    gaps = [gap_before(pair, before.stamp_ns) for before, pair in itertools.pairwise(run.pairs)]
    assert list(filter(None, gaps)) == [gaps[-2]] == [21 * MS]


def test_noise_is_no_spike_while_the_usual_change_is_hardly_known():
    for seed in range(100):
        run = Run()
        for n, force in enumerate(np.random.default_rng(seed).standard_normal(200).tolist()):
            run.both(START + n * MS, force)
        assert not run.rejected
