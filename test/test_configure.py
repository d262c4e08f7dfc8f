# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What `fden configure` finds on simulated rigs, and says where a recording cannot tell."""

from __future__ import annotations

import functools
import math
import re
import shlex
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_helpers import answer, fden
from fault_helpers import arm, first_press, write_bag
from property_helpers import counts, first
from scipy import signal
from unknown_rigs import RigBag, SimulatedRig, judge, simulate_rig

from benchmark.trial import elapsed
from fden_ros.cli import main
from fden_ros.configure.reading import read
from fden_ros.configure.robots import robot_named
from fden_ros.configure.sampling import find_filter
from fden_ros.configure.streams import Streams
from fden_ros.configure.survey import Survey, survey
from fden_ros.configure.units import NOT_STATED, STATED_SI, unit_of
from fden_ros.nodes.running import written_remaps
from fden_ros.parameters import live_topics, read_parameter_file
from fden_ros.shipped import robot_names
from simulation.disturbance import Disturbances
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Preload,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import Recording, simulate
from simulation.trajectory import Approach, RampHold, Sinusoid, Trajectory

ROOT = Path(__file__).parents[1]
CONFIG, PRESS = ROOT / "config", ROOT / "examples" / "press.csv"
#: Whole recordings: turns, a plate and tissue.
WHOLE: dict[str, Any] = {
    **dict.fromkeys(("turns", "rigid", "tissue", "leaves"), True),
    **dict.fromkeys(("force_step", "displacement_step", "breathing"), 0.0),
    **{"compliance": 3e-4, "mass": 0.4, "delay": 0.012, "force_noise": 0.01},
    **{"force_rate": 200.0, "displacement_rate": 150.0, "displacement_noise": 5e-6},
}


def whole_rig(seed: int = 7, **chosen: Any) -> SimulatedRig:
    return simulate_rig(seed, along_tool=True, **{**WHOLE, **chosen})


def look(rig: SimulatedRig, **options: Any) -> Survey:
    return survey([rig.streams], {"kind": "flat_punch", "area": rig.truth.area}, **options)


def bag_rig(**chosen: Any) -> SimulatedRig:
    rates = {"force_rate": 100.0, "displacement_rate": 100.0}
    return whole_rig(10, **{"presses": 2, **chosen}, **rates, force_noise=0.003)


@pytest.mark.parametrize(
    ("seed", "chosen"), [(1025, {"tissue": False}), (1071, {"leaves": False})]
)
def test_what_is_stated_of_an_unknown_rig_is_right(seed, chosen, tmp_path):
    rig = simulate_rig(seed, **chosen)
    path = RigBag(rig.streams).write(tmp_path / "bag")
    reading = read(path)
    judged = judge(survey([reading.streams]), rig.truth)
    assert not judged.misses
    assert not judged.unfounded
    worst = {name: max(map(abs, errors)) for name, errors in judged.errors.items()}
    assert all(error < 4.0 for error in worst.values()), worst


@pytest.mark.statistics
def test_of_200_other_rigs_nothing_is_stated_wrongly_and_intervals_hold():
    judged = []
    for seed in range(5000, 5200):
        rig = simulate_rig(seed)
        judged.append(judge(survey([rig.streams]), rig.truth))
    assert [one.seed for one in judged if one.misses] == []
    assert [one.seed for one in judged if one.unfounded] == []
    for name in judged[0].subjects:
        errors = np.array([error for one in judged for error in one.errors.get(name, [])])
        if errors.size >= 40:
            assert 0.9 <= np.mean(np.abs(errors) <= 1.96) <= 1.0, name


def test_a_whole_recording_tells_everything():
    rig = whole_rig(presses=6)
    found = look(rig)
    assert [f.subject for f in found.findings if not f.claim] == []
    judged = judge(found, rig.truth)
    assert not judged.misses
    assert set(judged.errors) >= {"delay", "compliance", "tool mass", "force axis"}
    assert max(abs(error) for errors in judged.errors.values() for error in errors) < 4.0


@pytest.mark.parametrize(
    ("left_out", "silent"), [("turns", {"tool mass"}), ("rigid", {"compliance"})]
)
def test_what_was_not_done_is_not_stated_but_asked_for(left_out, silent):
    found = look(whole_rig(**{left_out: False}))
    for name in silent:
        finding = found.finding(name)
        assert finding.motion and not finding.claim and not finding.parameters


#: Units of a force, and of each the tissue's stiffness in N/m of a rig from 1 mN to 200 N.
FORCES = {"N": 1.0, "mN": 1e-3, "g": 9.80665e-3, "kgf": 9.80665, "lbf": 4.44822}


def pressed(largest: float, noise: float, seed: int) -> Streams:
    """Three presses by 4 mm, to `largest` [N], in newtons and metres."""
    draw, times = np.random.default_rng(seed), np.arange(0.0, 24.0, 0.005)
    depth = 0.004 * np.clip(2.0 - 4.0 * np.abs((times / 8.0) % 1.0 - 0.5) - 0.5, -0.5, 1.0)
    force = largest * (np.maximum(depth, 0.0) / 0.004) ** 1.5
    force += noise * largest * draw.normal(size=times.size) + draw.normal(0.0, 0.3 * largest)
    depth = depth + draw.normal(0.0, 2e-6, times.size)
    return Streams("press", times, force[:, None], times, depth[:, None])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.statistics)])
@pytest.mark.parametrize("largest", [1e-3, 200.0])
def test_no_unit_of_a_force_is_asserted_from_sizes(largest, seed):
    for name, factor in FORCES.items():
        one = pressed(largest, (0.001, 0.015)[seed], seed)
        unstated = replace(one, force=one.force / factor)
        found = survey([unstated], units={**STATED_SI, "force": NOT_STATED})
        unit, noise = found.finding("force unit"), found.finding("force noise")
        assert not unit.claim and unit.value is None
        # Each stands with what it would make: the true one with the true stiffness.
        said = dict(re.findall(r"(\w+) ([\d.,e+-]+) N/m", unit.evidence))
        assert set(said) == set(FORCES)
        true = largest / 0.004
        assert float(said[name].replace(",", "")) == pytest.approx(true, rel=0.15)
        assert noise.unit == "units" and not found.finding("compliance").claim
        expected = (0.001, 0.015)[seed] * largest / factor
        assert noise.value == pytest.approx(expected, rel=0.1)


def test_noise_is_in_the_recordings_own_unit():
    one = pressed(0.05, 0.01, 0)
    found = survey([one], units={**STATED_SI, "force": unit_of("force", 1e-3)})
    assert found.finding("force unit").value == "mN"
    noise = found.finding("force noise")
    assert noise.unit == "mN" and noise.value == pytest.approx(0.5, rel=0.1)
    assert found.finding("force bias").unit == "mN"


def test_noise_alone_is_no_contact():
    draw = np.random.default_rng(3)
    times = np.arange(0.0, 20.0, 0.005)
    streams = Streams(
        "air",
        times,
        draw.normal(0.0, 0.01, (times.size, 3)),
        times,
        draw.normal(0.0, 1e-5, (times.size, 3)) + np.sin(times)[:, None] * [0.0, 0.0, 0.02],
    )
    found = survey([streams])
    assert not any(found.finding(f"{what} axis").claim for what in ("force", "displacement"))
    assert not found.finding("lift-off").claim


FACE = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
BALL = Geometry("sphere", radius_m=0.01)


def late(
    delay: float,
    *motions: Trajectory,
    seed: int = 0,
    geometry: Geometry = FACE,
    play: float = 0.0,
) -> Streams:
    """Presses of simulated tissue, the displacement stamped late by `delay` [s].

    `play`: of the drive [m].
    """
    scenario = Scenario(
        geometry=geometry,
        sites=(Site(Tissue(4000.0, 8.0, 0.1 + 0.05 * seed), motions),),
        force=ForceSensor(200.0, noise_n=0.005),
        displacement=DisplacementSensor(200.0, noise_m=5e-6, delay_s=delay),
        approach=Approach(distance_m=0.004, speed_m_per_s=0.005, start_pause_s=2.0),
        disturbances=Disturbances(backlash_m=play),
    )
    recording = simulate(scenario, seed)
    force, moved = recording.force, recording.displacement
    times, motion_times = times_of(recording)
    return Streams("late", times, force.value[:, None], motion_times, moved.value[:, None])


def times_of(recording: Recording) -> list[np.ndarray]:
    """Return the times of force and displacement [s]."""
    return [elapsed(one.stamp_ns) for one in (recording.force, recording.displacement)]


HOLD = (RampHold(0.3, 0.25, 2.0, 0.6),)
SINES = (Sinusoid(0.3, 0.2, 0.02, 1.0, 12, 0.3), Sinusoid(0.3, 0.2, 0.02, 4.0, 40, 0.3))


@pytest.mark.parametrize("seed", first(0, 1, 2))
@pytest.mark.parametrize("delay", first(0.05, 0.0, 0.1))
@pytest.mark.parametrize(("geometry", "motions"), [(FACE, HOLD), (BALL, HOLD), (FACE, SINES)])
def test_presses_of_tissue_tell_a_delay_by_their_bends(geometry, motions, delay, seed):
    finding = survey([late(delay, *motions, seed=seed, geometry=geometry)]).finding("delay")
    # 0.1 s are nearly half a period of the faster sine.
    assert finding.claim == (motions is HOLD or delay < 0.1)
    assert ("displacement.delay" in finding.parameters) == (finding.claim and delay > 0.03)
    if finding.claim:
        assert f"bends of {len(motions)} press" in finding.evidence
        assert finding.value == pytest.approx(delay, abs=3.0 * finding.deviation)
        assert finding.deviation < 0.01


@pytest.mark.parametrize("seed", first(0, 1, 2))
@pytest.mark.parametrize("play", first(5e-4, 3e-4))
def test_play_of_the_drive_is_no_delay(play, seed):
    """It was written as a delay of -50 ms, and N/m was then 26 for 40, without a flag."""
    one = late(0.0, *[RampHold(0.2, 0.25, 1.0, 0.3)] * 2, seed=seed, play=play)
    assert "displacement.delay" not in survey([one]).finding("delay").parameters


def filtered(cutoff: float, seed: int = 0) -> tuple[Streams, float]:
    """Two presses whose force went through a low-pass; the delay of that [s]."""
    one = late(0.0, *[RampHold(0.3, 0.2, 2.0, 0.6)] * 2, seed=seed)
    rate = 1.0 / float(np.median(np.diff(one.force_times)))
    draw = np.random.default_rng(seed)
    noisy = one.force + 0.02 * draw.normal(size=one.force.shape)
    passed = signal.lfilter(*signal.butter(2, cutoff, fs=rate), noisy, axis=0)
    return replace(one, force=passed), math.sqrt(2.0) / (2.0 * math.pi * cutoff)


@pytest.mark.parametrize("cutoff", first(5.0, 4.0, 10.0))
def test_a_filter_on_the_force_is_named_and_part_of_the_delay(cutoff):
    streams, delay = filtered(cutoff)
    found = survey([streams])
    named = found.finding("force filter")
    assert named.value == pytest.approx(delay, abs=2.5 * named.deviation)
    assert "the sensor or driver filters the force" in named.evidence
    late_by = found.finding("delay")
    assert late_by.claim and late_by.value == pytest.approx(-delay, abs=3.0 * late_by.deviation)
    assert late_by.parameters["displacement.delay"] == pytest.approx(late_by.value, abs=1e-6)


@pytest.mark.parametrize("kind", ["white", "drift", "vibration", "pink"])
def test_noise_of_no_filter_is_taken_for_none(kind):
    taken = []
    for seed in range(20):
        draw = np.random.default_rng(seed)
        white = draw.normal(size=(4, 1000))
        frequencies = np.fft.rfftfreq(1000)
        frequencies[0] = 1.0
        pink = np.fft.irfft(np.fft.rfft(white) * frequencies**-0.5)
        swing = np.sin(2.0 * np.pi * (0.04 * np.arange(1000) + draw.random((4, 1))))
        rest = {
            "white": white,
            "drift": white + np.cumsum(0.3 * draw.normal(size=white.shape), axis=1),
            "vibration": 0.2 * white + swing,
            "pink": pink,
        }[kind]
        taken.append(find_filter(list(rest), 200.0) is not None)
    assert not any(taken)


INDENTER = ["--flat-punch", "3.14e-4", "--thickness", "0.02"]


def test_a_file_holds_the_columns(tmp_path, capsys):
    table, output = tmp_path / "recorder 1.log", tmp_path / "probe.yaml"
    # Up to the air after the first press.
    rows = "\n".join(PRESS.read_text(encoding="utf-8").splitlines()[1:1250])
    table.write_text(f"zeit;kraft;tiefe\n{rows.replace(',', ';').replace('.', ',')}\n")
    columns = ("--columns", "zeit,kraft*1,tiefe*1e-3")
    assert fden("configure", table, *columns, *INDENTER, "-o", output) == 0
    capsys.readouterr()
    assert len(answer(capsys, "replay", table, "--config", output)["contacts"]) == 1
    assert read_parameter_file(output).core.synchronize.displacement_delay == 0.0


def test_the_file_replays_on_presses_of_the_same_rig(tmp_path, capsys):
    streams, truth = bag_rig()
    bag = RigBag(streams).write(tmp_path / "bag")
    output = tmp_path / "probe.yaml"
    indenter = ["--flat-punch", truth.area, "--thickness", truth.thickness]
    assert fden("configure", bag, "-o", output, *indenter) == 0
    assert "ATTENTION" not in capsys.readouterr().out
    parameters = read_parameter_file(output)
    assert parameters.tool.mass == pytest.approx(truth.mass, rel=0.02)
    assert parameters.core.synchronize.displacement_delay == pytest.approx(truth.delay, abs=1e-3)
    assert parameters.core.contact.series_compliance == pytest.approx(truth.compliance, rel=0.1)
    # The plate is left out: what is no tissue takes long to be told so.
    presses = RigBag(bag_rig(rigid=False, presses=1).streams).write(tmp_path / "presses")
    contacts = answer(capsys, "replay", presses, "--config", output)["contacts"]
    converged = [contact for contact in contacts if contact["converged"]]
    assert converged
    for one in converged:
        assert one["g"] == pytest.approx(truth.linear_stiffness, abs=4.0 * one["g_sd"])
        assert one["g_n"] == pytest.approx(truth.nonlinear_stiffness, abs=4.0 * one["g_n_sd"])


def test_a_table_whose_units_are_not_stated_lists_what_each_would_make(tmp_path, capsys):
    table = tmp_path / "press.csv"
    # A press, at a fifth of its rate.
    rows = PRESS.read_text(encoding="utf-8").replace("depth_mm", "depth", 1).splitlines()
    table.write_text("\n".join([rows[0], *rows[1:1250:5]]))
    columns = ("--columns", "time_s,force_N,depth")
    found = answer(capsys, "configure", table, *columns, *INDENTER)
    assert found["parameters"]["force.inverted"] is False
    units = {f["subject"]: f for f in found["findings"] if f["subject"].endswith("unit")}
    assert units["force unit"]["value"] == "N" and not units["displacement unit"]["claim"]
    said = re.search(
        r"modulus .*: m ([\d.]+) Pa, mm 1,\d00 Pa", units["displacement unit"]["evidence"]
    )
    assert said is not None and 1.0 < float(said[1]) < 1.5
    assert any("displacement unit" in problem for problem in found["problems"])


def test_signs_that_the_data_leave_open_are_said_with_their_probability_by_the_replay_too(
    tmp_path, capsys
):
    # A spring that is never left: pushed one way it answers as pulled the other.
    times = np.arange(0.0, 12.0, 0.01)
    depth = 2.0 + 1.5 * np.sin(0.4 * np.pi * times)
    force = 0.3 * depth + np.random.default_rng(1).normal(0.0, 0.002, times.size)
    table, probe = tmp_path / "spring.csv", tmp_path / "probe.yaml"
    rows = np.stack([times, force, depth], axis=1)
    np.savetxt(table, rows, "%.6f", ",", header="time_s,force_N,depth_mm", comments="")
    answered = answer(capsys, "configure", table, *INDENTER, "-o", probe)
    axes = [f for f in answered["findings"] if f["subject"].endswith("axis")]
    assert [f["claim"] for f in axes] == [False, False]
    assert 0.5 < axes[0]["probability"] == axes[1]["probability"] < 0.99
    assert not {"force.inverted", "displacement.inverted"} & answered["parameters"].keys()
    words = f"(a probability of {axes[0]['probability']:.2f})"
    fden("replay", table, "--config", probe)
    assert words in capsys.readouterr().err


def test_a_probe_in_transforms_alone_is_set_up_by_hand(tmp_path, capsys):
    bag = write_bag(tmp_path / "arm", arm(first_press()))
    assert fden("configure", bag) == 1
    assert "set frames.base" in capsys.readouterr().err


#: Robot: topics, kind of the displacement, the sign of what its sensor shows (1: what acts on the
#: tool), and whether its driver takes the tool's weight off.
LAYOUTS: dict[str, tuple[str, str, str, float, bool]] = {
    "crtk": ("/PSM1/body/measured_cf", "/PSM1/measured_cp", "pose", 1.0, False),
    "ur": ("/force_torque_sensor_broadcaster/wrench", "/tcp_pose_broadcaster/pose",
           "pose", 1.0, True),
    "franka": ("/NS_1/franka_robot_state_broadcaster/external_wrench_in_stiffness_frame",
               "/NS_1/franka_robot_state_broadcaster/current_pose", "pose", -1.0, True),
    "kuka_iiwa": ("/lbr/force_torque_broadcaster/wrench", "/lbr/pose_broadcaster/pose",
                  "pose", -1.0, True),
    "xarm": ("/xarm/uf_ftsensor_ext_states", "/xarm/robot_states", "xarm", 1.0, True),
    "ros2_control": ("/fts_broadcaster/wrench", "/tool_broadcaster/pose", "pose", 1.0, False),
}  # fmt: skip


@functools.cache
def rig_of(sign: float, compensated: bool) -> SimulatedRig:
    mass, rates = 0.0 if compensated else 0.4, {"force_rate": 120.0, "displacement_rate": 100.0}
    return whole_rig(presses=1, sensor_sign=sign, mass=mass, **rates)


def test_every_robot_has_a_layout_here_and_names_its_sources():
    assert set(robot_names()) == set(LAYOUTS)
    for name in robot_names():
        robot = robot_named(name)
        assert robot.convention
        assert "sources:\n  - " in (CONFIG / "robots" / f"{name}.yaml").read_text()
        for patterns, topic in zip(robot.topics.values(), LAYOUTS[name], strict=False):
            assert any(fnmatch(topic, pattern) for pattern in patterns)


#: Another type, another sign and a weight are looked at in each run, what is alike is not.
OTHERS = ("crtk", "franka", "xarm")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in OTHERS else pytest.mark.statistics) for n in LAYOUTS]
)
def test_topics_signs_and_weight_are_found_in_the_layout_of(name, tmp_path, capsys):
    force, displacement, kind, sign, compensated = LAYOUTS[name]
    rig = rig_of(sign, compensated)
    bag = RigBag(rig.streams, force, displacement, kind).write(tmp_path / "bag")
    answered = answer(capsys, "configure", bag, "--robot", name)
    assert answered["inputs"][0]["force"] == force
    assert answered["inputs"][0]["displacement"].startswith(displacement)
    axis = answered["parameters"]["force.axis"]
    assert np.allclose(axis, [0.0, 0.0, -sign], atol=0.02)
    convention = robot_named(name).axis
    if convention is not None:
        assert np.allclose(axis, convention, atol=0.02)
    found = {finding["subject"]: finding for finding in answered["findings"]}
    if kind == "xarm":
        # A field of a type of its own states no unit.
        assert not found["displacement unit"]["claim"]
        return
    into = answered["parameters"]["displacement.axis"]
    assert np.allclose(into, rig.truth.displacement_axis, atol=0.02)
    mass = found["tool mass"]
    assert mass["value"] == pytest.approx(rig.truth.mass, rel=0.02, abs=1e-3)


def test_a_sign_against_the_convention_is_told_and_the_recording_wins(tmp_path, capsys):
    force, displacement, kind, sign, compensated = LAYOUTS["ur"]
    rig = rig_of(-sign, compensated)
    bag = RigBag(rig.streams, force, displacement, kind).write(tmp_path / "bag")
    output = tmp_path / "probe.yaml"
    assert fden("configure", bag, "--robot", "ur", "-o", output) == 0
    assert "OPPOSITE" in capsys.readouterr().out
    assert read_parameter_file(output).force.axis[2] > 0.9


def test_the_topics_of_a_file_are_those_of_the_node_unless_it_is_told_others(tmp_path):
    path = tmp_path / "probe.yaml"
    path.write_text("# Live: -r force:=/ft/wrench -r displacement:=/tcp/pose\n")
    assert list(live_topics(path).values()) == ["/ft/wrench", "/tcp/pose"]
    given = ["identifier", "--ros-args", "--params-file", str(path)]
    remap = "displacement:=/tcp/pose"
    assert written_remaps(given) == ["--ros-args", "-r", "force:=/ft/wrench", "-r", remap]
    assert written_remaps([*given, "-r", "force:=/ft"]) == ["--ros-args", "-r", remap]
    assert written_remaps(["identifier"]) == []


# Signs of slow presses


def axis_of(draw: np.random.Generator) -> np.ndarray:
    if draw.random() < 0.5:
        return np.array([draw.choice([-1.0, 1.0])])
    vector = draw.normal(0.0, 1.0, 3)
    return np.asarray(vector / np.linalg.norm(vector))


def verdict(seed: int) -> tuple[list[str], bool | None]:
    """Press 3 to 8 mm at 0.1 to 1 mm/s, from the air or from within the tissue.

    Return which signs are wrong, and whether one is left open; None: the force is below ten times
    its noise.
    """
    draw = np.random.default_rng([seed, 27])
    rate, depth = 0.05 * np.exp(draw.uniform(np.log(0.1), 0.0)), draw.uniform(0.15, 0.4)
    peak, noise = np.exp(draw.uniform(np.log([0.1, 0.002]), np.log([8.0, 0.1])))
    force_rate, motion_rate = draw.uniform(60.0, 500.0, 2)
    press = RampHold(rate, depth, draw.choice([0.1, 2.0, 10.0]), rate * draw.choice([1.0, 20.0]))
    scenario = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=(Site(Tissue(2000.0, draw.uniform(2.0, 10.0), draw.uniform(0.05, 0.3)), (press,)),),
        approach=Approach(draw.uniform(0.5, 5.0) * 1e-3, 1e-3, 5e-4, start_pause_s=2.0),
        force=ForceSensor(force_rate),
        displacement=DisplacementSensor(motion_rate, delay_s=draw.uniform(0.0, 0.02)),
        preload=Preload(0.3 * depth * 0.02 if draw.random() < 0.3 else 0.0, 60.0),
    )
    recording = simulate(scenario, seed)
    grows, into = axis_of(draw), axis_of(draw)
    times, motion_times = times_of(recording)
    force = np.outer(peak * recording.force.value / recording.force.value.max(), grows)
    force += np.outer(draw.normal(0.0, 0.003) * times, draw.normal(0.0, 1.0, grows.size))
    force += draw.normal(0.0, 3.0, grows.size) + draw.normal(0.0, noise, force.shape)
    place = np.outer(recording.displacement.value, into)
    place += draw.normal(0.0, 0.3, into.size) + draw.normal(0.0, 1e-5, place.shape)
    found = survey([Streams("slow press", times, force, motion_times, place)])
    wrong, is_open = [], False
    for name, truth in (("force", grows), ("displacement", into)):
        axis = found.finding(f"{name} axis")
        is_open |= axis.value is None
        if axis.claim and float(np.atleast_1d(axis.value) @ truth) < 0.0:
            wrong.append(f"{seed} {name} axis")
    return wrong, is_open if peak > 10.0 * noise else None


@pytest.mark.parametrize(
    "seeds",
    [
        range(4),
        # Single presses without a hold, whose force axes were reversed once.
        (239, 5747),
        # A drift that outdoes the contact.
        (20330,),
        pytest.param((*range(200), 245, 296, 570, 858), marks=pytest.mark.statistics),
    ],
)
def test_signs_of_slow_presses_are_right_or_left_open(seeds):
    verdicts = [verdict(seed) for seed in seeds]
    assert [name for wrong, _ in verdicts for name in wrong] == []
    clear = [is_open for _, is_open in verdicts if is_open is not None]
    assert sum(clear) <= max(1, 0.05 * len(clear))


# A new user's first hour: from a recording of an arm to numbers


PAGE = ROOT / "docs" / "quickstart.md"
NOISE, DOWN = 0.02, np.array([0.0, 0.0, -1.0])


def recorded(folder: Path, seed: int) -> tuple[float, float, float]:
    """Write two presses of one place by an arm; return the tissue's ln G, ln Gn and alpha.

    Tissue, noise and the rig's errors are drawn; the errors as the parameters' defaults say.
    """
    draw = np.random.default_rng([seed, 12])
    g = float(np.exp(draw.uniform(math.log(400.0), math.log(4000.0))))
    gn, alpha = float(draw.uniform(6.0, 12.0)), float(draw.uniform(0.08, 0.25))
    press = RampHold(strain_rate=0.2, max_strain=0.35, hold_s=0.7, retract_rate=0.4)
    thickness = 0.02 * (1 + draw.normal(0.0, 0.02))
    scenario = Scenario(
        seed=seed,
        geometry=Geometry(area_m2=math.pi * 0.02**2, thickness_m=thickness),
        sites=(Site(Tissue(g, gn, alpha), (press,) * 2),),
        approach=Approach(slow_distance_m=0.002),
        force=ForceSensor(
            rate_hz=500.0,
            noise_n=NOISE,
            bias_n=float(draw.normal(0.0, 2.0)),
            drift_n_per_s=float(draw.normal(0.0, 0.001)),
        ),
        displacement=DisplacementSensor(
            rate_hz=500.0, noise_m=1e-5, delay_s=float(draw.normal(0.0, 0.0025))
        ),
        disturbances=Disturbances(
            compliance_m_per_n=abs(float(draw.normal(0.0, 1e-4))),
            friction_n=abs(float(draw.normal(0.0, 0.007))),
        ),
    )
    recording = simulate(scenario)
    times, motion_times = (one + 1.0 for one in times_of(recording))
    force = np.outer(recording.force.value, DOWN)
    force[:, :2] += draw.normal(0.0, NOISE, (len(force), 2))
    position = np.outer(recording.displacement.value, DOWN) + np.array([0.3, -0.2, 0.1])
    streams = Streams("arm", times, force, motion_times, position)
    RigBag(streams, *LAYOUTS["ur"][:2]).write(folder)
    return math.log(g), math.log(gn), alpha


def errors(contact: dict[str, Any], truth: tuple[float, float, float]) -> dict[str, float]:
    """Return the errors of what a contact claims, in its deviations."""
    values = {
        "linear_stiffness": (np.log(contact["g"]), contact["g_sd"] / contact["g"]),
        "nonlinear_stiffness": (np.log(contact["g_n"]), contact["g_n_sd"] / contact["g_n"]),
        "fractional_order": (contact["alpha"], contact["alpha_sd"]),
    }
    return {
        name: float((values[name][0] - true) / values[name][1])
        for name, true in zip(values, truth, strict=True)
        if name in contact["converged_parameters"]
    }


@pytest.mark.parametrize("seeds", counts(1, 20))
def test_the_commands_of_the_quick_start_lead_from_a_bag_to_right_numbers(
    seeds, tmp_path, capsys, monkeypatch
):
    page, found = PAGE.read_text(encoding="utf-8"), []
    (configure,) = re.findall(r"(?m)^ {4}fden (configure press .*--robot ur .*)$", page)
    for seed in range(seeds):
        (tmp_path / str(seed)).mkdir()
        monkeypatch.chdir(tmp_path / str(seed))
        truth = recorded(Path("press"), seed)
        assert main(shlex.split(configure, comments=True)) == 0
        assert "ATTENTION" not in capsys.readouterr().out
        parameters = read_parameter_file(Path("probe.yaml"))
        assert parameters.force.axis @ DOWN > 0.99 < parameters.displacement.axis @ DOWN
        first, second = answer(capsys, "replay", "press", "--config", "probe.yaml")["contacts"]
        assert first["site"] == second["site"] == 1
        assert seed or not (first["flags"] or second["flags"])
        for contact in (first, second):
            assert all(abs(error) < 5.0 for error in errors(contact, truth).values()), seed
        found.append(errors(second, truth))
    assert len(found[0]) == 3
    for name in found[0] if seeds > 1 else ():
        off = [one[name] for one in found if name in one]
        assert np.sqrt(np.mean(np.square(off))) <= 1.3, name
