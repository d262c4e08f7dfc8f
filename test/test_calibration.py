# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement, on simulated and on measured oscillations."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from property_helpers import counts

from fden_ros.cli import main
from fden_ros.configure.oscillations import Samples, find_delay, find_oscillations
from fden_ros.errors import InputError
from fden_ros.recording.synthetic import write_recording
from fden_ros.simulation.scenario import load_scenario
from fden_ros.simulation.simulate import Recording, Stream, simulate

DATA = os.environ.get("FDEN_DATA")
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
    result = find_delay(*samples_of(recording))
    assert result.delay == pytest.approx(delay, abs=HALF_A_MILLISECOND)
    assert result.order == pytest.approx(order_of(recording), abs=0.005)
    assert not result.warnings


@pytest.mark.parametrize("seeds", counts(3, 8))
def test_deviation_that_is_told_holds_the_truth(seeds):
    normalized = []
    for seed in range(seeds):
        result = find_delay(*samples_of(recorded(seed=seed)))
        assert result.delay == pytest.approx(0.012, abs=HALF_A_MILLISECOND)
        normalized.append((result.delay - 0.012) / result.delay_sd)
    assert 0.2 < math.sqrt(np.mean(np.square(normalized))) < 2.0


def test_one_frequency_with_alpha_given_is_enough():
    recording = recorded(presses=1)
    result = find_delay(*samples_of(recording), order_of(recording))
    assert result.order_given
    assert result.delay == pytest.approx(0.012, abs=HALF_A_MILLISECOND)


def test_one_frequency_alone_leaves_the_delay_undecided():
    recording = recorded(presses=1)
    result = find_delay(*samples_of(recording))
    assert result.delay is None and result.order is None
    (oscillation,) = result.oscillations
    by_truth = oscillation.delay(order_of(recording))
    assert by_truth == pytest.approx(0.012, abs=HALF_A_MILLISECOND)


def test_oscillation_that_lifts_off_is_left_out_and_said():
    times = np.arange(0.0, 20.0, 0.002)
    displacement = Samples(times, 1e-3 * np.sin(2.0 * math.pi * times))
    force = Samples(times, np.maximum(displacement.values, 0.0))
    warnings: list[str] = []
    assert find_oscillations(force, displacement, warnings) == ()
    assert "lifts off" in warnings[0]


def test_ramp_says_what_to_record():
    times = np.arange(0.0, 2.0, 0.01)
    ramp = Samples(times, 1e-3 * times)
    with pytest.raises(InputError, match="no steady oscillation"):
        find_delay(ramp, ramp)


def test_command_prints_the_parameter_to_set(tmp_path, capsys):
    write_recording(recorded(), tmp_path / "sweep")
    assert main(["calibrate", "delay", str(tmp_path / "sweep"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["delay_s"] == pytest.approx(0.012, abs=HALF_A_MILLISECOND)
    assert main(["calibrate", "delay", str(tmp_path / "sweep")]) == 0
    assert f"displacement.delay: {result['delay_s']:.6f}" in capsys.readouterr().out


@pytest.mark.skipif(not DATA, reason="measured data: set FDEN_DATA to their folder")
def test_measured_robot_is_31_ms_out_of_step_if_alpha_is_0(capsys):
    table = Path(str(DATA)) / "robot_on_silicone_500hz.csv"
    if not table.is_file():
        pytest.skip(f"no {table.name} in FDEN_DATA")
    assert main(["calibrate", "delay", str(table), "--columns", "@500,5,3*1e-3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    (oscillation,) = result["oscillations"]
    assert result["delay_s"] is None
    assert oscillation["frequency_hz"] == pytest.approx(2.0, abs=0.01)
    assert oscillation["lead_deg"] == pytest.approx(22.0, abs=1.0)
    assert oscillation["delay_s_by_alpha"]["0.0"] == pytest.approx(0.031, abs=0.001)


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
        result = find_delay(*tones(slope, phase, delay, seed))
        assert result.slope == pytest.approx(slope, abs=4.0 * result.slope_sd)
        if share == 1.0:
            assert not result.explanations
            assert result.delay is not None
            errors.append((result.delay - delay) / result.delay_sd)
            continue
        assert result.delay is None and result.order is None
        constant, by_slope = result.explanations
        assert constant.delay == pytest.approx(delay, abs=4.0 * constant.delay_sd)
        assert by_slope.delay - delay > 5.0 * by_slope.delay_sd
    if errors:
        assert 0.4 < math.sqrt(np.mean(np.square(errors))) < 1.5


def test_a_given_alpha_that_the_phases_contradict_gives_no_delay(tmp_path, capsys) -> None:
    force, displacement = tones(0.15, 0.45, 0.01, 3)
    assert find_delay(force, displacement, 0.15, 0.005).delay is None
    # One frequency shows no contradiction: then it is said what the delay rests on.
    single = find_delay(*tones(0.15, 0.45, 0.01, 3, (2.0,)), 0.15, 0.005)
    assert single.delay is not None
    assert "a degree of it counts as 1.4 ms" in single.warnings[0]
    table = tmp_path / "tones.csv"
    at = np.interp(force.times, displacement.times, displacement.values)
    rows = np.column_stack([force.times, force.values, at])
    np.savetxt(table, rows, delimiter=",", header="time_s,force_N,depth_m", comments="")
    assert main(["calibrate", "delay", str(table)]) == 0
    printed = capsys.readouterr().out
    assert "to the power 0.15" in printed
    assert "cannot be told from a delay" in printed and "Parameter:" not in printed
