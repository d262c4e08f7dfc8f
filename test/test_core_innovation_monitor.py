# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What innovations say of the model."""

from __future__ import annotations

import numpy as np

from fden_ros.core.estimation.innovation_monitor import InnovationMonitor


def monitored(innovations):
    monitor = InnovationMonitor()
    changes = []
    for index, value in enumerate(innovations):
        monitor.add(float(value))
        if monitor.change_window:
            changes.append(index)
    return monitor, changes


def test_white_innovations_raise_less_than_one_false_alarm_in_a_thousand_contacts():
    # The bound of one in a thousand, over 1,000 contacts of 1,000 blocks: more than 4 alarms would
    # come by chance in 1 of 270 runs only.
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(1000):
        monitor, changes = monitored(rng.standard_normal(1000))
        alarms += bool(monitor.mismatch_count or changes)
    assert alarms <= 4


def test_underestimated_noise_is_a_mismatch_and_inflates_by_its_variance():
    monitor, changes = monitored(2.0 * np.random.default_rng(1).standard_normal(2000))
    assert monitor.mismatch_count > 0
    assert not changes
    assert 3.0 < monitor.inflation < 12.0


def test_slow_deviations_below_the_noise_are_a_mismatch():
    time = np.arange(4000)
    slow = 0.5 * np.sin(2.0 * np.pi * time / 1000)
    monitor, _ = monitored(slow + np.random.default_rng(2).standard_normal(time.size))
    assert monitor.mismatch_count > 0
    assert monitor.inflation > 20.0


def test_jump_is_a_change_seen_within_a_few_innovations():
    innovations = np.random.default_rng(3).standard_normal(500)
    innovations[300:] += 5.0
    _, changes = monitored(innovations)
    assert 300 <= changes[0] < 310


def test_right_model_is_not_inflated():
    monitor, _ = monitored(np.random.default_rng(4).standard_normal(500))
    assert monitor.inflation == 1.0
