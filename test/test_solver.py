# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Solutions in a process of the node's own: the same outputs, whatever becomes of the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial

import pytest
from pipeline_helpers import feed, items_of, parameters_of, summaries_of

from fden_ros.core.outputs import Output
from fden_ros.core.pipeline import Pipeline
from fden_ros.nodes.solver import Solver
from fden_ros.parameters import check, pipeline_config
from simulation.scenario import ramp_scenario
from simulation.simulate import simulate

RECORDING = simulate(ramp_scenario(strain_rate=0.3, hold_s=0.3, sites=2, rate_hz=500.0, seed=1))
#: Begins a solver, says its process, and ends as if it were killed.
CUT_OFF = """
import os
from fden_ros.nodes.solver import Solver
if __name__ == "__main__":
    print(Solver().submit(os.getpid).result(), flush=True)
    os._exit(1)
"""


@pytest.fixture
def solver() -> Iterator[Solver]:
    own = Solver()
    yield own
    own.shutdown(cancel_futures=True)


def outputs_with(solver: Solver | None, kill_at: int | None = None) -> list[Output]:
    outputs: list[Output] = []
    config = pipeline_config(check(parameters_of(RECORDING)))
    pipeline = Pipeline(config, outputs.append, solver)
    items = items_of(RECORDING)
    if kill_at is not None:
        assert solver is not None
        feed(pipeline, items[:kill_at])
        os.kill(solver.submit(os.getpid).result(), signal.SIGKILL)
        items = items[kill_at:]
    feed(pipeline, items)
    pipeline.finish()
    return outputs


def test_outputs_are_those_of_solutions_computed_here(solver: Solver) -> None:
    outputs = outputs_with(None)
    assert [s.converged for s in summaries_of(outputs)] == [True, True]
    assert repr(outputs_with(solver)) == repr(outputs)


def test_a_solver_that_is_killed_is_replaced_and_changes_no_output(solver: Solver) -> None:
    onset = next(s.start_ns for s in summaries_of(outputs_with(None)))
    pressed = sum(item.stamp_ns < onset + 300_000_000 for item in items_of(RECORDING))
    assert repr(outputs_with(solver, kill_at=pressed)) == repr(outputs_with(None))
    assert solver.submit(partial(int, 7)).result() == 7


def test_the_process_ends_with_a_node_that_is_killed(tmp_path) -> None:
    (tmp_path / "cut_off.py").write_text(CUT_OFF)
    cut_off = subprocess.run(
        [sys.executable, tmp_path / "cut_off.py"], capture_output=True, text=True
    )
    pid = int(cut_off.stdout)
    end = time.monotonic() + 20.0
    while is_running(pid):
        assert time.monotonic() < end, "the process outlives the node by 20 s"
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
