# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Speed of replay.

A simulated palpation of one site, force and displacement at 1 kHz each, is replayed by a process
of its own on one core, which then decodes the same messages with rclpy and does nothing with
them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from benchmark.harness import Benchmark, Report, Table, at_least, measured
from fden_ros.offline.replay import replay
from fden_ros.parameters import read_parameter_file
from fden_ros.recording.reader import BagReader, decode
from simulation.bag import PARAMETER_FILE, write_recording
from simulation.scenario import load_scenario
from simulation.simulate import simulate

EPILOG = """\
examples:
  fden benchmark replay --quick
  fden benchmark replay --json | jq .goals

An otherwise idle machine is wanted: the speeds are of processor time, but cores share caches.
"""

_ROUNDS, _QUICK_ROUNDS = 3, 1
_NS_PER_S = 1_000_000_000


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    scenario = load_scenario("palpation")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "palpation"
        write_recording(simulate(scenario, scenario.seed), bag)
        # One of two processes is new for a single task.
        count = _QUICK_ROUNDS if args.quick else _ROUNDS
        rounds = [measured(speed_of, [(bag,)], what=bag.name)[0] for _ in range(count)]
    speed = min(rounds, key=lambda found: found["replay [s]"])
    return Report(
        [
            at_least("replay at 1 kHz, times real time, one core", speed["times real time"], 25.0),
            at_least("speed of replay over merely decoding", speed["over decoding"], 0.4),
        ],
        {"speed": Table("Replay", {"palpation at 1 kHz": speed})},
    )


def speed_of(bag: Path) -> dict[str, float]:
    """Return the processor time of a replay, and of decoding the same messages."""
    parameters = read_parameter_file(bag / PARAMETER_FILE)
    start = time.process_time()
    result = replay(bag, parameters)
    replayed = time.process_time() - start
    reader = BagReader(bag)
    recorded = ((reader.end_ns or 0) - (reader.start_ns or 0)) / _NS_PER_S
    count = sum(1 for message in reader.messages(list(result.inputs.values())) if decode(message))
    decoded = time.process_time() - start - replayed
    return {
        "recorded [s]": recorded,
        "messages": count,
        "replay [s]": replayed,
        "decoding [s]": decoded,
        "us a message": 1e6 * replayed / count,
        "times real time": recorded / replayed,
        "over decoding": decoded / replayed,
    }


BENCHMARK = Benchmark(run, EPILOG)
