# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The noise of the measured motion, where it comes in steps as coarse as that of an encoder."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from benchmark.presses import CASES, trial_of
from fden_ros.core.estimation.motion_jitter import MotionJitter
from fden_ros.core.streams.samples import ReadingNoise

STEP, SAMPLE = 2.5e-3, 0.002
COARSE = ReadingNoise(STEP**2 / 3.0 * SAMPLE, STEP)


def read(motion):
    """Return a motion as an encoder reads it."""
    return STEP * np.round(motion / STEP)


def off_the_line(motion, noise=COARSE):
    jitter = MotionJitter(noise)
    return np.array([jitter.press(SAMPLE, float(place)) for place in motion])


def test_a_halt_of_a_coarse_motion_is_no_noise_of_several_steps():
    moving = 0.25 * SAMPLE * np.arange(500)
    for place in np.linspace(0.0, STEP, 7):
        motion = np.concatenate([moving, np.full(100, moving[-1])]) + place
        assert np.max(np.abs(off_the_line(read(motion)))) <= 1.5 * STEP


def test_a_reading_that_flickers_between_two_steps_stays_on_one_line():
    rng = np.random.default_rng(0)
    for place in (0.4, 0.5, 0.6):
        reading = read(place * STEP + 0.1 * STEP * rng.standard_normal(2000))
        off = off_the_line(reading)[200:]
        # What is left on the line is slow: a few hundredths of the variance.
        assert np.var(reading[200:] - off) < 0.1 * np.var(reading[200:])


def test_alpha_is_within_its_interval_where_a_hold_lies_at_the_edge_of_an_encoders_step():
    case = CASES["encoder_50um"]
    squares = []
    for number in range(20, 30):
        (contact,) = trial_of(case, number, {}).contacts
        assert not contact.is_silent
        squares.append((contact.error[2] / contact.deviation[2]) ** 2)
    assert sum(squares) < chi2.ppf(0.9999, len(squares)), squares
