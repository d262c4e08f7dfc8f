# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the motion's noise and its corners do to the stress."""

from __future__ import annotations

import numpy as np
import pytest

from fden_ros.core.estimation.motion_noise import MotionNoise

SLOPE, ORDER, STEP = 2000.0, 0.131, 0.01


def begun(white=0.0):
    """Return the noise of a motion that begins at 0."""
    motion = MotionNoise(white)
    motion.press(0.0, 0.0)
    return motion


def pressed(motion, compressions):
    for compression in compressions:
        motion.press(STEP, compression)


def taken(motion, size):
    return motion.take_block(size * STEP, size, SLOPE, ORDER)


def test_a_straight_motion_is_as_noisy_as_its_samples():
    motion = begun(white=1e-10)
    pressed(motion, 0.005 * np.arange(1, 11))
    own, before = taken(motion, 10)
    assert own == pytest.approx(1e-10 * 0.1 ** (-1.0 - 2.0 * ORDER) * SLOPE**2)
    assert before == pytest.approx(0.0, abs=1e-20)


def test_a_corner_spoils_its_block_most_and_those_after_it_less_and_less():
    motion = begun()
    pressed(motion, [0.005, 0.010, 0.015])
    assert taken(motion, 3) == pytest.approx((0.0, 0.0), abs=1e-20)
    pressed(motion, [0.020, 0.020, 0.020, 0.020])
    corner, before = taken(motion, 4)
    assert before == pytest.approx(0.0, abs=1e-20)
    # A quarter of the bend is the most that can be wrong; shared by four samples.
    assert 0.0 < corner**0.5 < 0.25 * 0.005 * SLOPE * STEP**-ORDER / 4
    variances = []
    for _ in range(3):
        pressed(motion, [0.020] * 4)
        variances.append(taken(motion, 4)[0])
    assert corner > variances[0] > variances[1] > variances[2] > 0.0


def test_a_corner_between_two_blocks_spoils_both():
    motion = begun()
    pressed(motion, [0.005, 0.010])
    taken(motion, 2)
    pressed(motion, [0.010, 0.010, 0.010])
    own, before = taken(motion, 3)
    assert own > 0.0 and before > 0.0


def test_noise_makes_no_corners():
    rng = np.random.default_rng(0)
    deviation = 1e-3
    motion = begun(deviation**2 * STEP)
    white, larger = 0.0, 0
    for _ in range(200):
        pressed(motion, deviation * rng.standard_normal(10))
        own, _ = taken(motion, 10)
        white = deviation**2 * STEP * 0.1 ** (-1.0 - 2.0 * ORDER) * SLOPE**2
        larger += own > 2.0 * white
    assert larger < 10


def test_what_was_before_an_interruption_is_no_corner():
    motion = begun()
    pressed(motion, [0.005, 0.010])
    taken(motion, 2)
    motion.interrupt()
    pressed(motion, [0.1, 0.105, 0.11])
    assert taken(motion, 3) == pytest.approx((0.0, 0.0), abs=1e-20)


def test_a_block_without_a_duration_is_told_nothing():
    motion = begun(1e-8)
    assert motion.take_block(0.0, 1, SLOPE, ORDER) == (0.0, 0.0)
