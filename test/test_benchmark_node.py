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

"""The benchmarks of speed measure what they say; their goals are for a quiet machine."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from fden_ros.benchmarks import node as benchmark
from fden_ros.cli import main
from fden_ros.nodes.backlog import Backlog, Input


def test_a_run_through_the_node_loses_nothing_and_measures_all() -> None:
    plan = 2 * [
        benchmark.Turn(benchmark.NODE, 200.0, 1.5),
        benchmark.Turn(benchmark.RELAY, 200.0, 1.5),
    ]
    node, relay = benchmark.measure(plan)
    assert (node.what, relay.what) == (benchmark.NODE, benchmark.RELAY)
    for run in (node, relay):
        assert run.sent == 600
        assert run.lost == 0
        assert run.published > 30
        assert len(run.cpu) == 2
        assert all(0.0 < cpu < 2.0 for cpu in run.cpu)
        for turn in range(2):
            p50, p99, most = (run.latency_ms[name][turn] for name in ("p50", "p99", "p99.9"))
            assert 0.0 < p50 <= p99 <= most
        assert min(run.memory_mb) > 10.0
        assert math.isnan(run.memory_growth)


def test_goals_tell_silent_losses_from_those_that_were_said() -> None:
    def run(what: str, rate: float, lost: int = 0, told: int = 0, cpu: float = 0.2) -> object:
        # One turn of three met a machine that did something else.
        latency = {"p50": (0.5,) * 3, "p99": (1.0, 1.0, 9.0), "p99.9": (2.0,) * 3}
        memory = tuple(100.0 + (second > 100) for second in range(200))
        turns = (cpu, cpu, 2.0 * cpu)
        return benchmark.Run(
            what, rate, 10.0, 100, lost, told, 0, 0, 0, 90, turns, latency, memory
        )

    runs = [
        run(benchmark.NODE, 1000.0, cpu=0.3),
        run(benchmark.RELAY, 1000.0),
        run(benchmark.NODE, 2000.0, lost=5, told=5),
        run(benchmark.NODE, 4000.0, lost=5, told=3),
    ]
    goals = {goal.name: goal for goal in benchmark._goals(runs)}  # type: ignore[arg-type]
    assert goals["CPU over relay's"].met is False
    assert goals["p99 latency over relay's"].met is True
    assert goals["memory grown after a minute [MB]"].value == 1.0
    assert goals["pairs lost silently at 2000 Hz"].met is True
    assert goals["pairs lost silently at 4000 Hz"].met is False
    figure = Figure()
    benchmark._draw(runs, figure)  # type: ignore[arg-type]
    assert len(figure.axes) == 2


def test_a_backlog_is_worked_off_in_order_and_its_oldest_dropped_and_counted() -> None:
    read: list[bytes] = []
    incoming = [b"%d" % number for number in range(30_000)]
    coming = iter(incoming)
    source = Input("force", lambda: next(coming, None), read.append)
    backlog = Backlog()
    backlog.inputs.append(source)
    for _ in range(40):
        if (data := next(coming, None)) is not None:
            backlog.add(source, data)
    while backlog.waiting:
        backlog.work()
    dropped = backlog.dropped["force"]
    assert 9_000 < dropped < 11_000
    assert len(read) + dropped == len(incoming)
    numbers = [int(data) for data in read]
    assert numbers == sorted(numbers)
    assert numbers[-1] == 29_999
    assert backlog.batches == 1


def test_streams_that_waited_together_are_worked_off_side_by_side() -> None:
    """After a pause, at whatever rates: neither is far ahead of the other."""
    read: list[float] = []
    apart: list[float] = []
    newest = {"force": 0.0, "displacement": 0.0}

    def stream(name: str, rate: float) -> Input:
        times = iter([b"%r" % (k / rate) for k in range(round(20.0 * rate))])

        def take_in(data: bytes) -> None:
            newest[name] = float(data)
            read.append(newest[name])
            apart.append(abs(newest["force"] - newest["displacement"]))

        return Input(name, lambda: next(times, None), take_in)

    backlog = Backlog()
    backlog.inputs += [stream("force", 500.0), stream("displacement", 60.0)]
    while len(read) < 20 * 560:
        backlog.work()
    assert max(apart) < 2.0 / 60.0


def test_core_is_quick_and_its_figures_are_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("fracmem")
    pytest.importorskip("differint")
    from fden_ros.benchmarks import core

    monkeypatch.setattr(core, "_QUICK_HISTORIES", (1000, 2000))
    assert main(["benchmark", "core", "--quick", "--json", "-o", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    goals = {goal["name"]: goal for goal in result["goals"]}
    assert goals["fracmem's error over ours"]["met"]
    assert goals["memory per sample at 1e4 over 1e3"]["value"] == pytest.approx(1.0, abs=0.05)
    assert set(result["figures"]["stages_microseconds"]) >= {"pairing", "all of it in contact"}
    assert (tmp_path / "core.png").stat().st_size > 10_000
