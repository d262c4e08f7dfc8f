# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The identifier node in its own process, over real DDS: its life, and the launch files."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import threading
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
from command_helpers import POSE
from diagnostic_msgs.msg import DiagnosticStatus
from fden_msgs.msg import TissueEstimate
from lifecycle_msgs.msg import Transition
from live_helpers import LIMIT, Ears, process_of
from rcl_interfaces.srv import DescribeParameters
from ros_helpers import STEP_NS, Bench, Live, active, assert_live_equals_replay, identifier, stamp
from std_srvs.srv import Trigger

from fden_ros.core.outputs import Classification, ContactSummary, DynamicModulus, TissueState
from fden_ros.parameters import PARAMETERS
from simulation.bag import write_recording
from simulation.scenario import load_scenario
from simulation.simulate import START_NS, simulate


def continuous(bag: Path) -> Path:
    """A probe that stays on the tissue; 60 mm in 40 s."""
    write_recording(simulate(load_scenario("continuous")), bag)
    return bag


@pytest.mark.parametrize(
    ("made", "kinds", "topics"),
    [
        (
            lambda folder: POSE,
            (TissueState, Classification, ContactSummary),
            ("/tool/wrench", "/arm/measured_cp"),
        ),
        (continuous, (TissueState, ContactSummary, DynamicModulus), ("/force", "/displacement")),
    ],
    ids=["golden pose", "continuous"],
)
def test_live_equals_replay_bit_for_bit(made, kinds, topics, tmp_path):
    remap = dict(zip(topics, ("/force", "/displacement"), strict=True))
    assert_live_equals_replay(made(tmp_path / "bag"), kinds, remap=remap)


def test_parameters_are_described_ranged_and_changed_once_it_is_cleaned_up():
    with Bench() as bench, active():
        bench.wait_until_heard()
        names = [parameter.name for parameter in PARAMETERS] + ["autostart", "source_timeout"]
        request = DescribeParameters.Request(names=names)
        descriptors = bench.call(DescribeParameters, "describe_parameters", request).descriptors
        assert [d.name for d in descriptors] == names
        assert all(d.description.endswith("]") for d in descriptors)
        assert next(d for d in descriptors if d.name == "autostart").read_only
        area = next(d for d in descriptors if d.name == "geometry.area")
        assert area.floating_point_range[0].to_value == 1.0
        assert bench.change_state(Transition.TRANSITION_DEACTIVATE)
        assert bench.change_state(Transition.TRANSITION_CLEANUP)
        (result,) = bench.set_parameters({"geometry.area": 2e-4})
        assert result.successful


def test_tare_and_reset_work_in_the_air_and_are_refused_elsewhere():
    with Bench() as bench, active():
        bench.wait_until_heard()
        refused = bench.call(Trigger, "tare")
        assert not refused.success and "air" in refused.message
        live = Live(bench)
        live.stream(0.5)
        live.stream(0.5, lambda t: 0.01 * t)
        bench.wait_for(lambda: stamp(bench.estimates[-1]) > live.now - 50_000_000, "the press")
        status = TissueEstimate.STATUS_CONVERGING, TissueEstimate.STATUS_CONVERGED
        assert bench.estimates[-1].status in status
        for service in ("tare", "reset"):
            refused = bench.call(Trigger, service)
            assert not refused.success
            assert refused.message == f"the probe is in contact: lift it, then {service}"
        live.stream(2.0, lambda t: max(5e-3 - 0.02 * t, -2e-3))
        bench.wait_for(lambda: bench.summaries, "the release")
        bench.wait_for(lambda: bench.call(Trigger, "tare").success, "the air")
        assert bench.call(Trigger, "reset").success


# What a node says and does before its first pair of samples, and how it ends


def warnings_of(node: Any, words: str) -> list[str]:
    """The warnings of a node that has ended, with these words."""
    return [line for line in node.output.splitlines() if "[WARN]" in line and words in line]


def looks_that_say(bench: Bench, *words: str) -> int:
    """How many looks of the node at its inputs, one a second, have found all these words."""
    return sum(all(one in array.status[0].message for one in words) for array in bench.diagnostics)


def wait_for_words(bench: Bench, *words: str, looks: int = 2) -> None:
    """Wait until so many looks have said them: the log has it from the second on."""
    bench.wait_for(lambda: looks_that_say(bench, *words) >= looks, f"the words {words}")


def test_a_topic_that_nothing_publishes_is_named_with_one_that_fits_and_the_remap():
    with Bench() as bench, identifier({"autostart": True}, remap={"force": "/arm/wrench"}) as node:
        has_type = "/force has that type"
        wait_for_words(bench, has_type, "/displacement is published by /bench")
    # A loaded machine may discover publisher and node after the first line, which names neither.
    *before, line = warnings_of(node, "/arm/wrench")
    assert all("start its publisher" in one for one in before)
    assert "nothing publishes /arm/wrench" in line and "-r force:=/force" in line
    assert "/displacement is published by /bench" in warnings_of(node, "/displacement is")[-1]


def test_stamps_of_zero_are_said_with_the_parameter_that_takes_the_times_of_receipt_instead():
    def air(bench: Bench) -> None:
        bench.publish(0, 0.0, 0.0)
        bench.spin_for(0.004)

    with Bench() as bench:
        with active():
            bench.wait_until_heard()
            words = "set synchronize.stamp_source to receive"
            bench.wait_for(
                lambda: air(bench) or words in bench.diagnostic().get("message", ""), words
            )
            assert bench.diagnostic()["rejected.force.zero_stamp"] != "0"
        bench.estimates.clear()
        with active({"synchronize.stamp_source": "receive"}):
            bench.wait_until_heard()
            begin = time.time_ns()
            said = bench.wait_for(
                lambda: (
                    air(bench)
                    or [m for m in bench.estimates if m.status == TissueEstimate.STATUS_NO_CONTACT]
                ),
                "an estimate in the air",
            )
            # The middleware's clock, to its resolution.
            assert begin - 1_000_000 < stamp(said[0]) < time.time_ns()


def test_lost_messages_are_said_with_their_topic_and_what_mends_it():
    with Bench() as bench, identifier({"autostart": True}) as node:
        bench.wait_until_heard()
        for k in range(50):
            bench.publish(START_NS + k * STEP_NS, 0.0, 0.0)
        bench.wait_for(lambda: bench.diagnostic().get("pairs", "0") != "0", "the first of them")
        # While it is stopped, shared memory has no room for all of them.
        node.send_signal(signal.SIGSTOP)
        for k in range(50, 2500):
            bench.publish(START_NS + k * STEP_NS, 0.0, 0.0)
        node.send_signal(signal.SIGCONT)
        now = iter(range(START_NS + 2500 * STEP_NS, 2 * START_NS, STEP_NS))
        words = "messages a second on /force lost: publish it at no more than"
        bench.wait_for(
            lambda: (
                bench.publish(next(now), 0.0, 0.0)
                or any(words in array.status[0].message for array in bench.diagnostics)
            ),
            words,
        )
    line, *_ = warnings_of(node, words)
    assert "or set qos_overrides./force.subscription.reliability to reliable" in line


SLOW_CORE = """
import time
from fden_ros.core.pipeline import Pipeline
on_pair = Pipeline._on_pair
Pipeline._on_pair = lambda self, pair: (time.sleep(0.02), on_pair(self, pair))
"""


def test_estimates_of_a_machine_that_is_too_slow_are_late_and_that_is_said():
    with Bench() as bench, identifier({"autostart": True}, first=SLOW_CORE) as node:
        bench.wait_until_heard()
        stop = threading.Event()

        def feed() -> None:
            now = iter(range(START_NS, 2 * START_NS, STEP_NS))
            while not stop.wait(0.002):
                bench.publish(next(now), 0.0, 0.0)

        thread = threading.Thread(target=feed)
        thread.start()
        try:
            late = TissueEstimate.STATUS_LATE
            bench.wait_for(lambda: bench.estimates and bench.estimates[-1].status == late, "late")
            words = "the machine is too slow: "
            bench.wait_for(lambda: words in bench.diagnostic().get("message", ""), words)
        finally:
            stop.set()
            thread.join()
    assert all((e.lag > 0.1) == (e.status == late) for e in bench.estimates)
    assert warnings_of(node, words)


def test_the_lifecycle_from_a_library_that_cannot_be_read_to_the_end():
    """The requests of a lifecycle manager; what is refused is in log and diagnostics."""
    change = Transition
    with Bench("/arm/identifier") as bench, identifier(remap={"__ns": "/arm"}) as node:

        def set_library(path: str) -> bool:
            (result,) = bench.set_parameters({"classifier.library": path})
            return bool(result.successful)

        assert bench.state() == "unconfigured"
        assert set_library("/nowhere/tissues.yaml")
        assert not bench.change_state(change.TRANSITION_CONFIGURE)
        assert bench.state() == "unconfigured"
        refusal = "cannot configure: /nowhere/tissues.yaml: "
        bench.wait_for(lambda: refusal in bench.diagnostic().get("message", ""), refusal)
        assert bench.diagnostic_level() == DiagnosticStatus.ERROR
        assert set_library("")
        for _ in range(2):
            assert bench.change_state(change.TRANSITION_CONFIGURE)
            assert bench.state() == "inactive"
            assert not set_library("/nowhere/tissues.yaml")
            heard = len(bench.estimates)
            bench.publish(START_NS, 0.0, 0.0)
            bench.spin_for(0.5)
            assert len(bench.estimates) == heard
            assert bench.change_state(change.TRANSITION_ACTIVATE)
            bench.wait_for(lambda: bench.estimates and bench.diagnostics, "its voice")
            assert bench.change_state(change.TRANSITION_DEACTIVATE)
            assert bench.change_state(change.TRANSITION_CLEANUP)
        assert bench.change_state(change.TRANSITION_UNCONFIGURED_SHUTDOWN)
        assert bench.state() == "finalized"
    assert node.returncode == 0
    assert sum("/nowhere/tissues.yaml" in line for line in node.output.splitlines()) == 1
    for words, count in (("unconfigured: it", 1), ("configured: silent", 2), ("deactivated:", 2)):
        assert node.output.count(f": {words}") == count, words


def test_the_node_goes_before_ordinary_processes_and_ends_cleanly_if_interrupted_often():
    with Bench() as bench, identifier({"autostart": True}) as node:
        bench.wait_until_connected()
        tasks = list(Path(f"/proc/{node.pid}/task").iterdir())
        threads = {int(t.name): t.joinpath("comm").read_text().strip() for t in tasks}
        own = [pid for pid, name in threads.items() if pid == node.pid or "dds" in name]
        found = {os.getpriority(os.PRIO_PROCESS, pid) for pid in own}
        # As a terminal and a launch file both do.
        while node.poll() is None:
            node.send_signal(signal.SIGINT)
            time.sleep(0.005)
    assert node.returncode == 0 and "Traceback" not in node.output
    # Only who may raise a priority everywhere gets it.
    if "no right" not in node.output:
        assert len(own) > 1 and found == {max(os.nice(0) - 10, -20)}, threads
    assert ("no right" in node.output) <= (os.geteuid() != 0)


# The launch files, run by `ros2 launch` as a user runs them; there are no wheels of it


HAS_LAUNCH = all(importlib.util.find_spec(name) for name in ("launch_ros", "ros2launch"))
needs_launch = pytest.mark.skipif(not HAS_LAUNCH, reason="ros2 launch is not to be had as a wheel")


def launched(*arguments: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """Run the launch file of the identifier; Ctrl-C it at the end, and keep its output."""
    program = shutil.which("ros2")
    assert program is not None
    return process_of([program, "launch", "fden_ros", "identifier.launch.py", *arguments])


def process_ids(namespace: str) -> list[int]:
    """Processes whose command line has this namespace."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if f"__ns:={namespace}".encode() in words:
            found.append(int(folder.name))
    return found


@needs_launch
def test_a_wrong_parameter_file_starts_nothing_and_is_one_line(tmp_path):
    path = tmp_path / "probe.yaml"
    path.write_text("identifier: {ros__parameters: {geometry.thicknes: 0.02}}")
    # With respawn too: a node that refuses its file must not be started again and again.
    with launched(f"parameters:={path}", "respawn:=true") as launch:
        assert launch.wait(LIMIT) == 1
    assert launch.output.count("there is no parameter geometry.thicknes; did you mean") == 1
    assert "process started" not in launch.output and "Traceback" not in launch.output


@needs_launch
def test_ctrl_c_of_the_terminal_and_of_the_launch_file_ends_the_node_cleanly():
    with Ears() as ears, launched("namespace:=/launched") as launch:
        topic = "/launched/identifier/estimate"
        ears.wait_for(lambda: ears.node.count_publishers(topic), "the identifier")
        # A terminal sends it to the node too.
        for process_id in process_ids("/launched"):
            subprocess.run(["kill", "-INT", str(process_id)], check=False)
        launch.send_signal(signal.SIGINT)
    assert "process has finished cleanly" in launch.output
    assert "process has died" not in launch.output and "Traceback" not in launch.output
