# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement, on simulated and on measured oscillations."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from property_helpers import counts

from fden_ros.cli import main
from fden_ros.configure.delay import Phases, Samples, find_oscillations, phases_of
from fden_ros.recording.synthetic import write_recording
from fden_ros.simulation.scenario import load_scenario
from fden_ros.simulation.simulate import Recording, Stream, simulate

SCENARIO = Path(__file__).parents[1] / "bags" / "delay_two_frequencies.yaml"
HALF_A_MILLISECOND = 5e-4


def recorded(delay: float = 0.012, seed: int = 9, presses: int = 2) -> Recording:
    scenario = load_scenario(SCENARIO)
    site = scenario.sites[0]
    return simulate(
        replace(
            scenario,
            sites=(replace(site, presses=site.presses[:presses]),),
            displacement=replace(scenario.displacement, delay_s=delay),
        ),
        seed,
    )


def samples_of(recording: Recording) -> tuple[Samples, Samples]:
    first = min(int(recording.force.stamp_ns[0]), int(recording.displacement.stamp_ns[0]))

    def samples(stream: Stream) -> Samples:
        return Samples((stream.stamp_ns - first) * 1e-9, stream.value)

    return samples(recording.force), samples(recording.displacement)


def order_of(recording: Recording) -> float:
    return float(recording.truth["sites"][0]["fractional_order"])


@pytest.mark.parametrize("delay", [-0.008, 0.0, 0.012, 0.035])
def test_delay_and_alpha_are_told_apart_by_two_frequencies(delay):
    recording = recorded(delay)
    result = phases_of(*samples_of(recording))
    assert result.delay.value == pytest.approx(delay, abs=HALF_A_MILLISECOND)
    assert result.order.value == pytest.approx(order_of(recording), abs=0.005)
    assert result.by_slope is None


@pytest.mark.parametrize("seeds", counts(3, 8))
def test_deviation_that_is_told_holds_the_truth(seeds):
    normalized = []
    for seed in range(seeds):
        delay, sd = phases_of(*samples_of(recorded(seed=seed))).delay
        assert delay == pytest.approx(0.012, abs=HALF_A_MILLISECOND)
        normalized.append((delay - 0.012) / sd)
    assert 0.2 < math.sqrt(np.mean(np.square(normalized))) < 2.0


def test_one_frequency_alone_leaves_the_delay_undecided():
    recording = recorded(presses=1)
    result = phases_of(*samples_of(recording))
    assert result.delay is None and result.order is None
    (oscillation,) = result.oscillations
    by_truth = oscillation.delay(order_of(recording))
    assert by_truth == pytest.approx(0.012, abs=HALF_A_MILLISECOND)


def test_an_oscillation_that_lifts_off_and_a_ramp_are_none():
    times = np.arange(0.0, 20.0, 0.002)
    displacement = Samples(times, 1e-3 * np.sin(2.0 * math.pi * times))
    force = Samples(times, np.maximum(displacement.values, 0.0))
    assert find_oscillations(force, displacement) == ()
    ramp = Samples(times, 1e-3 * times)
    assert phases_of(ramp, ramp) == Phases(())


def delay_told(capsys, *arguments) -> dict:
    assert main(["configure", *map(str, arguments), "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)["findings"]
    return next(finding for finding in findings if finding["subject"] == "delay")


def test_command_finds_the_delay_of_a_recording(tmp_path, capsys):
    write_recording(recorded(), tmp_path / "sweep")
    found = delay_told(capsys, tmp_path / "sweep")
    assert found["claim"]
    assert found["value"] == pytest.approx(0.012, abs=HALF_A_MILLISECOND)


def test_command_says_that_one_frequency_cannot_tell(tmp_path, capsys):
    write_recording(recorded(presses=1), tmp_path / "sine")
    found = delay_told(capsys, tmp_path / "sine")
    assert not found["claim"] and "if alpha is 0" in found["evidence"]
    assert "a second frequency" in found["motion"]


def tones(
    slope: float,
    phase: float,
    delay: float,
    seed: int,
    frequencies: tuple[float, ...] = (1.0, 4.0),
) -> tuple[Samples, Samples]:
    """Sines one after the other about one depth on tissue of a slope and a phase of its own."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 30.0, 0.002)
    depth, force = np.full(times.size, 4e-3), np.full(times.size, 1.5)
    begin = 3.0
    for frequency in frequencies:
        omega = 2.0 * math.pi * frequency
        inside = (times >= begin) & (times < begin + 10.0 / frequency)
        since = times[inside] - begin
        depth[inside] += 5e-4 * np.sin(omega * since)
        force[inside] += 5e-4 * 300.0 * omega**slope * np.sin(omega * since + phase)
        begin += 10.0 / frequency + 1.0
    force += rng.normal(0.0, 2e-3, times.size)
    depth += rng.normal(0.0, 2e-6, times.size)
    return Samples(times, force), Samples(times + delay, depth)


@pytest.mark.parametrize("seeds", counts(8, 20))
@pytest.mark.parametrize("share", [1.0, 1.6, 2.5])
def test_a_phase_beyond_that_of_the_slope_is_not_told_from_a_delay(
    share: float, seeds: int
) -> None:
    errors = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        slope, delay = rng.uniform(0.08, 0.25), rng.uniform(-0.005, 0.02)
        phase = share * 0.5 * math.pi * slope
        result = phases_of(*tones(slope, phase, delay, seed))
        assert result.slope is not None and result.delay is not None
        assert result.slope.value == pytest.approx(slope, abs=4.0 * result.slope.sd)
        errors.append((result.delay.value - delay) / result.delay.sd)
        if share == 1.0:
            assert result.by_slope is None
            continue
        assert result.by_slope is not None
        assert result.by_slope.value - delay > 5.0 * result.by_slope.sd
    assert 0.4 < math.sqrt(np.mean(np.square(errors))) < 1.5


def test_the_command_states_no_delay_where_slope_and_phase_differ(tmp_path, capsys) -> None:
    force, displacement = tones(0.15, 0.45, 0.01, 3)
    table = tmp_path / "tones.csv"
    at = np.interp(force.times, displacement.times, displacement.values)
    rows = np.column_stack([force.times, force.values, at])
    np.savetxt(table, rows, delimiter=",", header="time_s,force_N,depth_m", comments="")
    found = delay_told(capsys, table)
    assert not found["claim"]
    assert "to the power 0.15" in found["evidence"]
