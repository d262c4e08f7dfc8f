# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Speed and memory of replay: against real time, against merely decoding, over the bag's length.

A simulated palpation of one site, force and displacement at 1 kHz each, is replayed by a process
of its own on one core, which then decodes the same messages with rclpy and does nothing with
them. Memory is the peak of such a process on a bag of a minute and on one of an hour; the long
bag repeats a press every 30 s at 100 Hz, so that it holds as many samples as six minutes at 1 kHz.
Last, an archive goes through ``fden batch`` with one worker and with two.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.offline.replay import replay
from fden_ros.parameters import read_parameter_file
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.synthetic import PARAMETER_FILE, write_recording
from fden_ros.recording.writer import BagWriter
from fden_ros.simulation.scenario import Scenario, load_scenario
from fden_ros.simulation.simulate import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

EPILOG = """\
examples:
  fden benchmark replay --quick
  fden benchmark replay --json | jq .goals

An otherwise idle machine is wanted: the speeds are of processor time, but cores share caches.
"""

_SPEED = "palpation"
_MEMORY = "ramp"
_MEMORY_RATE_HZ = 100.0
_REPETITION_S = 30
_MINUTE, _HOUR, _QUICK_HOUR = 60, 3600, 600
_BAGS = 30
_ROUNDS, _QUICK_ROUNDS = 3, 1
_NS_PER_S = 1_000_000_000
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4  # after the encapsulation's header, every header of a message begins with its stamp

T = TypeVar("T")


@dataclass(frozen=True)
class Speed:
    """One bag replayed, and its messages merely decoded."""

    recorded_s: float
    messages: int
    replay_s: float  #: processor time
    decode_s: float  #: processor time

    @property
    def over_real_time(self) -> float:
        """How many times faster than it was recorded."""
        return self.recorded_s / self.replay_s

    @property
    def over_decoding(self) -> float:
        """Speed as a share of that of decoding."""
        return self.decode_s / self.replay_s


@dataclass(frozen=True)
class Memory:
    """Peak of a process that replays a bag."""

    recorded_s: float
    messages: int
    peak_mib: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    lengths = (_MINUTE, _QUICK_HOUR if args.quick else _HOUR)
    rounds = _QUICK_ROUNDS if args.quick else _ROUNDS
    with tempfile.TemporaryDirectory() as folder, progress("bags", rounds + 5) as advance:
        place = Path(folder)
        bag = _make(load_scenario(_SPEED), place / _SPEED)
        speeds = []
        for _ in range(rounds):
            speeds.append(_in_a_process(_speed, bag))
            advance()
        speed = min(speeds, key=lambda s: s.replay_s)
        memories = []
        for length in lengths:
            memories.append(_in_a_process(_memory, _long(place / f"{length}_s", length)))
            advance()
        scaling = math.nan
        if not args.quick and (os.cpu_count() or 1) >= 2:
            archive = _archive(place / "archive", bag)
            seconds = []
            for workers in (1, 2):
                seconds.append(_batch(archive, place / f"{workers}.parquet", workers))
                advance()
            scaling = seconds[0] / seconds[1]
    growth = memories[1].peak_mib / memories[0].peak_mib
    duration = "an hour" if lengths[1] == _HOUR else f"{lengths[1] // 60} minutes"
    goals = [
        within(
            "replay at 1 kHz, times real time, one core", speed.over_real_time, (8.0, math.inf)
        ),
        within("speed of replay over merely decoding", speed.over_decoding, (0.4, math.inf)),
        within(f"peak memory, {duration} over a minute", growth, (0.0, 1.05)),
        within("archive: speed of two workers over one", scaling, (1.8, math.inf)),
    ]
    if args.quick:
        goals[2] = Goal(goals[2].name, goals[2].value, goals[2].goal, None)
    return Report(
        goals=goals,
        figures={
            "speed": asdict(speed),
            "memory": [asdict(memory) for memory in memories],
            "two_workers_over_one": scaling,
        },
        tables=[_table(speed, memories)],
        draw=lambda figure: _draw(figure, speed, memories, scaling),
    )


# Bags


def _make(scenario: Scenario, folder: Path) -> Path:
    write_recording(simulate(scenario, scenario.seed), folder)
    return folder


def _long(folder: Path, seconds: int) -> Path:
    """Make a bag of one press, repeated with later stamps."""
    scenario = load_scenario(_MEMORY)
    scenario = replace(
        scenario,
        sites=scenario.sites[:1],
        force=replace(scenario.force, rate_hz=_MEMORY_RATE_HZ),
        displacement=replace(scenario.displacement, rate_hz=_MEMORY_RATE_HZ),
    )
    once = BagReader(_make(scenario, folder.with_name(f"{folder.name}_once")))
    topics = [topic for topic in once.topics if "truth" not in topic.name]
    with BagWriter(folder) as writer:
        for topic in topics:
            writer.add_topic(topic.name, topic.type_name, *topic.offered_qos)
        for repetition in range(seconds // _REPETITION_S):
            shift = repetition * _REPETITION_S
            for message in once.messages([topic.name for topic in topics]):
                data = bytearray(message.data)
                whole, rest = _STAMP.unpack_from(data, _STAMP_AT)
                _STAMP.pack_into(data, _STAMP_AT, whole + shift, rest)
                writer.write(message.topic, bytes(data), message.log_time_ns + shift * _NS_PER_S)
    parameters = once.path / PARAMETER_FILE
    (folder / PARAMETER_FILE).write_bytes(parameters.read_bytes())
    return folder


def _archive(folder: Path, bag: Path) -> Path:
    """Make an archive of one bag many times, each with content of its own."""
    reader = BagReader(bag)
    for number in range(_BAGS):
        with BagWriter(folder / f"bag_{number}") as writer:
            for topic in reader.topics:
                writer.add_topic(topic.name, topic.type_name, *topic.offered_qos)
            for message in reader.messages():
                writer.write(message.topic, message.data, message.log_time_ns + number)
    (folder / PARAMETER_FILE).write_bytes((bag / PARAMETER_FILE).read_bytes())
    return folder


# Measurements


def _in_a_process(function: Callable[[Path], T], bag: Path) -> T:
    """Call a function in a process of its own, whose peak of memory is its alone."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(function, bag).result()


def _speed(bag: Path) -> Speed:
    parameters = read_parameter_file(bag / PARAMETER_FILE)
    start = time.process_time()
    result = replay(bag, parameters)
    replayed = time.process_time()
    count = 0
    reader = BagReader(bag)
    for message in reader.messages(list(result.inputs.values())):
        decode(message)
        count += 1
    decoded = time.process_time()
    recorded = ((reader.end_ns or 0) - (reader.start_ns or 0)) / _NS_PER_S
    return Speed(recorded, count, replayed - start, decoded - replayed)


def _memory(bag: Path) -> Memory:
    result = replay(bag, read_parameter_file(bag / PARAMETER_FILE))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    reader = BagReader(bag)
    recorded = ((reader.end_ns or 0) - (reader.start_ns or 0)) / _NS_PER_S
    assert result.summaries
    return Memory(recorded, reader.message_count, peak)


def _batch(archive: Path, output: Path, workers: int) -> float:
    command = [sys.executable, "-c", "import sys; from fden_ros.cli import main; sys.exit(main())"]
    command += ["batch", str(archive), "-o", str(output), "--workers", str(workers)]
    command += ["--config", str(archive / PARAMETER_FILE)]
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start


# What came out


def _table(speed: Speed, memories: list[Memory]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title="replay", box=box.SIMPLE_HEAD)
    for column in ("", "recorded s", "messages", "processor s", "µs a message", "peak MiB"):
        table.add_column(column, justify="left" if not column else "right")
    for label, seconds in (("replay", speed.replay_s), ("decoding", speed.decode_s)):
        each = f"{1e6 * seconds / speed.messages:.1f}"
        cells = (f"{speed.recorded_s:.0f}", str(speed.messages), f"{seconds:.2f}", each, "")
        table.add_row(f"{label}, 1 kHz", *cells)
    for memory in memories:
        cells = (
            f"{memory.recorded_s:.0f}",
            str(memory.messages),
            "",
            "",
            f"{memory.peak_mib:.1f}",
        )
        table.add_row("replay, 100 Hz", *cells)
    return table


def _draw(figure: Figure, speed: Speed, memories: list[Memory], scaling: float) -> None:
    figure.set_size_inches(12, 4)
    bars: list[tuple[str, list[str], list[float], float]] = [
        ("times real time", ["replay"], [speed.over_real_time], 8.0),
        ("share of decoding's speed", ["replay"], [speed.over_decoding], 0.4),
        (
            "peak memory, MiB",
            [f"{m.recorded_s / 60:.0f} min" for m in memories],
            [m.peak_mib for m in memories],
            1.05 * memories[0].peak_mib,
        ),
    ]
    if math.isfinite(scaling):
        bars.append(("two workers over one", ["archive"], [scaling], 1.8))
    for axes, (title, labels, values, goal) in zip(
        figure.subplots(1, len(bars), squeeze=False)[0], bars, strict=True
    ):
        shown: Any = axes.bar(labels, values, width=0.5, color="#4878a8")
        axes.bar_label(shown, fmt="%.3g", label_type="center", color="white", fontsize=14)
        axes.axhline(goal, color="#b04030", linestyle="--", label=f"goal {goal:.3g}")
        axes.set_title(title)
        axes.margins(x=0.4, y=0.2)
        axes.legend(loc="lower right")
        axes.spines[["top", "right"]].set_visible(False)
