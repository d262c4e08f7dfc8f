# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The benchmarks of speed measure what they say; their goals are for a quiet machine."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmark import node
from fden_ros.cli import main
from fden_ros.nodes.backlog import Backlog, Input


def test_a_run_through_the_node_measures_all() -> None:
    """How much is lost in time is for a quiet machine to say."""
    rows = node.measure(2 * [node.Turn(node.NODE, 200.0, 1.5), node.Turn(node.RELAY, 200.0, 1.5)])
    assert list(rows) == ["node, 200 Hz", "relay, 200 Hz"]
    for row in rows.values():
        assert row["sent"] == 600 and 0 <= row["lost"] < 600
        assert row["published"] > 0
        assert len(row["CPU"]) == 2 and all(0.0 < cpu < 2.0 for cpu in row["CPU"])
        for p50, p99, most in zip(row["p50"], row["p99"], row["p99.9"], strict=True):
            assert 0.0 < p50 <= p99 <= most
        assert min(row["memory"]) > 10.0


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


def test_replay_is_timed_and_its_figures_are_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "replay", "--quick", "--json", "-o", str(tmp_path)]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert set(figures["steps"]) >= {"in the air", "in contact"}
    assert figures["speed"]["palpation at 1 kHz"]["times real time"] > 1.0
