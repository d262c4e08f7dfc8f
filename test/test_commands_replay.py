# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""`fden replay` on recordings of other makers: bags, types of their own, tables."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_helpers import POSE, answer, fden
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pipeline_helpers import begun
from rosbags.highlevel import AnyReader

from benchmark.trial import fed
from fden_ros.core.streams import Pair
from fden_ros.core.strokes import REMEDY, Strokes
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import read_parameter_file
from fden_ros.recording.reader import BagReader
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter
from fden_ros.ros.messages import type_name
from fden_ros.ros.status import PipelineProblems
from simulation.bag import PARAMETER_FILE

PRESS = POSE.with_name("golden_press")


def error_line(capsys: pytest.CaptureFixture[str], code: int, *arguments: str | Path) -> str:
    """Return the one line on standard error that goes with exit code 1."""
    assert fden(*arguments) == code
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    return lines[0]


def test_damaged_messages_are_counted_and_the_others_used(capsys, tmp_path):
    source = BagReader(PRESS)
    with BagWriter(tmp_path / "bag") as bag:
        for topic in source.topics:
            bag.add_topic(topic.name, topic.type_name)
        for number, message in enumerate(source.messages()):
            data = message.data[:10] if number in (500, 501, 502) else message.data
            bag.write(message.topic, data, message.log_time_ns)
    result = answer(capsys, "replay", tmp_path / "bag", "--config", PRESS / "identifier.yaml")
    damaged = {k: n for k, n in result["rejected"].items() if k.endswith(".damaged")}
    assert sum(damaged.values()) == 3
    counts = ", ".join(f"{reason} {n}" for reason, n in result["rejected"].items())
    said = f"{sum(result['rejected'].values())} samples were rejected ({counts}), "
    assert any(words.startswith(said) for words in result["warnings"])
    assert len(result["contacts"]) == 2


def test_several_sensible_topics_are_listed_in_one_line(capsys, tmp_path):
    bag = tmp_path / "bag"
    topics = {"/left/wrench": WrenchStamped, "/right/wrench": WrenchStamped, "/pose": PoseStamped}
    with BagWriter(bag) as written_bag:
        for name, kind in topics.items():
            message = kind()
            message.header.stamp.sec = 5
            written_bag.add_topic(name, type_name(kind))
            written_bag.write(name, message, 5 * 10**9)
    line = error_line(capsys, 1, "replay", bag)
    assert "/left/wrench" in line and "/right/wrench" in line and "--force-topic" in line
    line = error_line(capsys, 1, "replay", bag, "--force-topic", "/pose")
    assert "--force-field" in line


def test_the_results_are_a_bag_of_all_that_the_node_publishes(capsys, tmp_path):
    out = tmp_path / "results"
    options = ("--config", POSE / "identifier.yaml", "-o", out)
    result = answer(capsys, "replay", POSE, *options)
    source = BagReader(POSE)
    contents = {topic.name: topic for topic in BagReader(out).topics}
    assert set(contents) == {
        *("/identifier/estimate", "/identifier/classification", "/identifier/palpation"),
        *("/identifier/complex_modulus", "/identifier/stiffness_map"),
        "/diagnostics",
    }
    assert contents["/identifier/palpation"].offered_qos[0].latched
    assert contents["/identifier/estimate"].message_count > 300
    seconds = ((source.end_ns or 0) - (source.start_ns or 0)) * 1e-9
    assert contents["/diagnostics"].message_count == int(seconds)
    with AnyReader([out]) as reader:
        read = [
            (connection.topic, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]
    summaries = [m for topic, _, m in read if topic == "/identifier/palpation"]
    (*_, last_map) = [m for topic, _, m in read if topic == "/identifier/stiffness_map"]
    assert (last_map.header.frame_id, last_map.width) == ("arm_base", 2)
    assert [m.linear_stiffness for m in summaries] == [c["g"] for c in result["contacts"]]
    # The position is in the displacement's frame, the header names the force's.
    assert {m.position_frame_id for m in summaries} == {"arm_base"}
    assert {m.header.frame_id for m in summaries} == {"tool_sensor"}
    for message, contact in zip(summaries, result["contacts"], strict=True):
        place = message.position
        assert contact["frame"] == "arm_base"
        assert contact["position"] == [place.x, place.y, place.z]
    ends = [m.end.sec * 10**9 + m.end.nanosec for m in summaries]
    assert ends == [contact["end_ns"] for contact in result["contacts"]]
    delays = [
        time - m.header.stamp.sec * 10**9 - m.header.stamp.nanosec
        for topic, time, m in read
        if topic == "/identifier/estimate"
    ]
    assert min(delays) >= 0 and max(delays) < 0.1e9
    assert "--force" in error_line(capsys, 1, "replay", POSE, *options)
    words = "fden_msgs are outputs of an identifier: replay its recording"
    assert words in error_line(capsys, 1, "replay", out)


FORCE, POSES = "/tool/wrench", "/arm/measured_cp"
FIELDS = Selection(
    {"force": FORCE, "displacement": POSES},
    {"force": "wrench.force", "displacement": "pose.position"},
)


def test_fields_give_what_the_topics_give():
    parameters = read_parameter_file(POSE / PARAMETER_FILE)
    topics, fields = replay(POSE, parameters), replay(POSE, parameters, FIELDS)
    assert topics.summaries
    assert result_object(replace(fields, inputs={})) == result_object(replace(topics, inputs={}))


# Where G and Gn are not to be had: N/m alone is a result, and strokes are no presses


SPRING = 1000.0  # [N/m]
RATE = 100.0
GEOMETRY = {"geometry.area": 7.85e-5, "geometry.thickness": 0.03}
CONFIG = """\
/**:
  ros__parameters:
    geometry: {area: 7.85e-5, thickness: 0.03}
    estimate: {period: 0.02}
"""


def pressed() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, force and depth of a press of a spring, with 0.02 N of noise and a bias of 0.4 N."""
    time = np.arange(0.0, 7.0, 1.0 / RATE)
    depth = 1e-3 * np.interp(time, [0.0, 2.0, 3.5, 5.5, 7.0], [-3.0, 0.0, 1.5, 1.5, -3.0])
    return time, _spring(depth) + 0.4, depth


def palpated(lowest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of strokes of 3 mm at 1.5 Hz, from a depth [m] that is the lowest."""
    time = np.arange(0.0, 20.0, 1.0 / RATE)
    depth = lowest + 1.5e-3 * (1.0 - np.cos(2.0 * np.pi * 1.5 * time))
    return time, _spring(depth), depth


def _spring(depth: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(4).standard_normal(depth.size)
    return SPRING * np.maximum(depth, 0.0) + 0.02 * noise


def written(path: Path, columns: tuple[np.ndarray, ...]) -> Path:
    np.savetxt(path, np.stack(columns).T, delimiter=",", header="time_s,force_N,depth_m",
               comments="")  # fmt: skip
    return path


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "probe.yaml"
    path.write_text(CONFIG)
    return path


def test_linear_tissue_is_a_result_in_newtons_per_metre_with_one_line_that_says_why(
    capsys, tmp_path, config
):
    table = written(tmp_path / "spring.csv", pressed())
    # G of a spring is known to a fifth.
    config.write_text(CONFIG + "    converged: {log_g_sd: 0.1}\n")
    assert fden("replay", table, "--config", config) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    words = " ".join(printed.out.split())
    assert "N/m known" in words
    assert words.split("contact 1: ")[1].startswith("N/m is known; G and Gn are not known: ")
    row = next(line for line in printed.out.splitlines() if line.startswith("1 "))
    assert row.split()[2].startswith(("(", "–"))
    found = answer(capsys, "replay", table, "--config", config)["contacts"][0]
    for name in ("apparent_stiffness", "measured_slope"):
        assert abs(found[name] - SPRING) < 4.0 * found[f"{name}_sd"]


def test_a_probe_that_never_lifts_is_told_what_to_write_and_then_has_its_stiffness(
    capsys, tmp_path, config
):
    table = written(tmp_path / "strokes.csv", palpated(1e-3))
    assert fden("replay", table, "--config", config) == 3
    printed = capsys.readouterr()
    assert REMEDY in printed.err and "1.5 Hz" in printed.err
    assert "undetermined" not in printed.out  # no row of a table
    config.write_text(f"{config.read_text()}    {REMEDY}\n")
    assert fden("replay", table, "--config", config) == 0
    shown = capsys.readouterr().out
    assert "1 stiffness" in " ".join(shown.split()) or "stiffness, cut short" in shown


@pytest.mark.parametrize(("rate", "words"), [(12.0, "record at 24 Hz or more"), (50.0, REMEDY)])
def test_strokes_in_rare_samples_are_told_to_be_recorded_faster(rate, words):
    """Continuous mode finds nothing there, and a slow ramp with noise looked like strokes."""
    strokes = Strokes()
    for k in range(round(10.0 * rate)):
        depth = 1e-3 * math.sin(2.0 * math.pi * 1.5 * k / rate)
        pair = Pair(0, 1 + round(1e9 * k / rate), 1.0, depth, None)
        if not k:
            onset = SimpleNamespace(samples=[pair], way=np.zeros((3, 0)), displacement=depth)
            onset.seen = False
            strokes.touch(onset)
        strokes.add(pair, in_contact=True)
    assert words in strokes.warning
    assert (REMEDY in strokes.warning) == (words == REMEDY)


@pytest.mark.parametrize(("lowest", "is_told"), [(1e-3, True), (-1e-3, False)])
def test_strokes_are_told_from_presses_once_and_while_they_come(lowest, is_told):
    pipeline, _ = begun(GEOMETRY | {"estimator.kind": "ekf"})
    problems, said = PipelineProblems(pipeline), []
    for number, _ in enumerate(fed(pipeline, *palpated(lowest))):
        if number % RATE == 0:
            said.append(any(REMEDY in words for words in problems.look().warnings))
    pipeline.finish()
    assert pipeline.never_lifts is is_told
    # As what is odd about the input, for ten looks, and never again.
    assert sum(said) == (10 if is_told else 0)
    assert sum(REMEDY in words for words in pipeline.warnings) == is_told


def test_a_table_of_one_row_is_too_short_for_a_contact(tmp_path, capsys):
    table = tmp_path / "row.csv"
    table.write_text("time_s,force_N,depth_mm\n0,1,2\n")
    line = error_line(capsys, 3, "replay", table, "--area", "314mm2", "--height", "20mm")
    assert "in 1 samples, too few to measure the force in the air; record 2 s in the air" in line
