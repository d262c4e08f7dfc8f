# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node next to a bare relay on real DDS: losses, CPU, latency and memory.

A source publishes force and displacement (sensor-data QoS), a sink receives the results, each in a
process of its own. Between them run, each in a process and a namespace of its own, the *node*, and
a *relay*: a plain node with the same inputs that publishes a message of the same size as often,
and computes nothing, the limit that Python and ROS set. Both wait from the beginning; the source
publishes to one at a time. They take turns over five rounds, so that other load meets both: the
goals are on the median over the rounds.

A controller of 100 Hz reads at each tick the newest estimate that the sink has received. The tick
is *late* where the stamp of that estimate is more than 100 ms before it.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark.harness import Benchmark, Goal, Report, Table, at_most
from fden_ros.commands import live
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.progress import progress

EPILOG = """\
examples:
  fden benchmark node --quick               two minutes
  fden benchmark node -o results            ten minutes for node and relay each
  fden benchmark node --quick --busy        next to two processes that only compute
  prlimit --nice=0 setpriv --bounding-set=-sys_nice fden benchmark node --busy

The last denies the node a negative nice; *nice* is what it has. Without --busy the figures hold
for a machine that does nothing else. CPU in cores, latency in ms from stamp to
arrival at the sink, memory in MB: of each turn. *Reported*: of the lost pairs those that
the process itself counted. *late*: of a 100 Hz controller's ticks those with an estimate older
than 100 ms [%].
"""

_SECONDS, _QUICK_SECONDS = 600.0, 40.0
_ROUNDS = 5
#: Left out at the beginning of a turn [s].
_WARM_UP = 0.5
#: Between two turns, and before and after a count of what was lost: diagnostics come once a
#: second [s].
_PAUSE, _COUNTING_PAUSE = 0.2, 1.5
#: Memory counts from then on [s].
_MEMORY_FROM = 60
#: A turn begins at this time of the recording [s]: with 1.5 s of air, from which the
#: identifier needs to learn before a touch.
_PRESS_FROM = 0.5
_BLOCK = 10
_STAMP = struct.Struct("<iI")
_BODY = 4
_CLOCK_TICKS = os.sysconf("SC_CLK_TCK")
_QUANTILES = {"p50": 50.0, "p99": 99.0, "max": 100.0}

NODE, RELAY = "node", "relay"
_NAMESPACES = {NODE: "/node", RELAY: "/relay"}
_RATE = 1000.0
#: The period of the controller, and the age from which an estimate is late to it [ns].
_TICK, _LATE = 10_000_000, 100_000_000
_BURNERS = 2


#: Lets Linux kill the calling process when its parent ends, in whatever way.
end_with_parent = functools.partial(live.end_with_parent, signal.SIGKILL)


class _Watched(NamedTuple):
    """The record of a process during a turn: one stretch of messages for it."""

    sent: int
    begin_ns: int
    end_ns: int
    cpu: float  #: cores
    memory_mb: list[float]  #: resident, once a second
    nice: int


def _more(parser: argparse.ArgumentParser) -> None:
    words = f"next to {_BURNERS} processes that only compute"
    parser.add_argument("--busy", action="store_true", help=words)


def run(args: argparse.Namespace) -> Report:
    """Measure; the exit code does not depend on the result."""
    seconds, burners = _QUICK_SECONDS if args.quick else _SECONDS, _BURNERS * args.busy
    rows = measure(_ROUNDS * [NODE, RELAY], seconds / _ROUNDS, burners)
    load = f"load {os.getloadavg()[0]:.1f} at the end"
    title = f"{os.cpu_count()} cores, {burners} busy processes, {load}"
    shown = {name: row | {"memory": row["memory"][-1]} for name, row in rows.items()}
    return Report(goals_of(rows, is_busy=args.busy), {"turns": Table(title, shown)})


def goals_of(rows: dict[str, dict[str, Any]], *, is_busy: bool) -> list[Goal]:
    """Compare the node with the relay, on an idle machine or next to busy processes."""
    node, relay = (rows[what] for what in (NODE, RELAY))
    later = node["memory"][_MEMORY_FROM:]
    grown = max(later) - later[0] if len(later) > 10 else float("nan")
    most_late = (0.5 if node["nice"] < 0 else 2.0) if is_busy else 0.0
    late = at_most("late ticks [%]", node["late"], most_late)
    if is_busy:
        return [late]
    above = float(np.median(np.array(node["p99"]) - np.array(relay["p99"])))
    ratio = float(np.median(np.array(node["CPU"]) / np.array(relay["CPU"])))
    most = max(node["max"]) - max(relay["max"])
    return [
        at_most("pairs lost at 1 kHz", float(node["lost"]), 0.0),
        at_most("CPU over relay's", ratio, 1.6),
        at_most("p99 latency above the relay's [ms]", above, 5.0),
        at_most("largest latency above the relay's [ms]", most, 30.0),
        at_most("memory grown after a minute [MB]", grown, 2.0),
        late,
    ]


# The turns


def measure(plan: Sequence[str], seconds: float, burners: int) -> dict[str, dict[str, Any]]:
    """Give the processes their turns, of some seconds each; return the figures of each."""
    environment = dict(os.environ)
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    environment.setdefault("ROS_DOMAIN_ID", str(40 + os.getpid() % 50))
    root = str(Path(__file__).resolve().parents[1])
    environment["PYTHONPATH"] = os.pathsep.join([root, environment.get("PYTHONPATH", "")])
    me = [sys.executable, "-m", "benchmark.node"]
    turns = json.dumps([(_NAMESPACES[what], seconds) for what in plan])
    with contextlib.ExitStack() as stack:

        def started(*command: str) -> Any:
            return stack.enter_context(_process(command, environment))

        sink = started(*me, "sink")
        for _ in range(burners):
            started(sys.executable, "-c", "while True: pass")
        programs = [sys.executable, "-m", "fden_ros.nodes.programs"]
        tested = {
            NODE: started(*programs, "identifier", *_NODE_ARGUMENTS),
            RELAY: started(*me, "relay"),
        }
        sender = started(*me, "source", "--turns", turns)
        watched: dict[str, list[_Watched]] = {what: [] for what in tested}
        show = stack.enter_context(progress("measuring", len(plan)))
        for count, what in enumerate(plan, start=1):
            watched[what].append(_watch(seconds, tested[what].pid, sender))
            show(count)
        _ended(sender)
        for process in (*tested.values(), sink):
            process.send_signal(signal.SIGINT)
            last = _ended(process)
    heard = json.loads(last)
    return {
        what: _row(own, heard["arrivals"][what], heard["counts"][what])
        for what, own in watched.items()
    }


def _watch(seconds: float, pid: int, sender: Any) -> _Watched:
    """Wait for a turn, and return the use of resources of the process."""
    begin_ns = json.loads(sender.stdout.readline())["begin_ns"]
    memory = [_memory_mb(pid)]
    time.sleep(_WARM_UP)
    begin, before = time.monotonic(), _cpu_seconds(pid)
    while (left := begin + seconds - _WARM_UP - 0.2 - time.monotonic()) > 0.0:
        time.sleep(min(1.0, left))
        memory.append(_memory_mb(pid))
    cpu = (_cpu_seconds(pid) - before) / (time.monotonic() - begin)
    done = json.loads(sender.stdout.readline())
    nice = os.getpriority(os.PRIO_PROCESS, pid)
    return _Watched(done["sent"], begin_ns, done["end_ns"], cpu, memory, nice)


def _row(turns: Sequence[_Watched], arrived: Any, counts: Any) -> dict[str, Any]:
    """Return the figures of the turns of one kind; lists are over the turns, or seconds."""
    before = _counted_at(counts, turns[0].begin_ns)
    after = _counted_at(counts, turns[-1].end_ns + round(0.9e9 * _COUNTING_PAUSE))
    came = {name: count - before.get(name, 0) for name, count in after.items()}
    arrivals = np.array(arrived, dtype=np.int64).reshape(-1, 2)
    latencies = [_latency_ms(arrivals, turn) for turn in turns]
    sent = sum(turn.sent for turn in turns)
    return {
        "lost": max(sent - came.get("pairs", 0) - came.get("rejected", 0), 0),
        "reported": came.get("lost", 0),
        "CPU": [turn.cpu for turn in turns],
        **{
            name: [float(np.percentile(latency, q)) for latency in latencies]
            for name, q in _QUANTILES.items()
        },
        "late": 100.0 * float(np.mean(np.concatenate([_is_late(arrivals, t) for t in turns]))),
        "nice": turns[-1].nice,
        "memory": [memory for turn in turns for memory in turn.memory_mb],
    }


def _counted_at(diagnostics: Sequence[tuple[int, dict[str, int]]], time_ns: int) -> dict[str, int]:
    """Return what a process had counted at a time, by its last diagnostics before."""
    return next((counts for heard_ns, counts in reversed(diagnostics) if heard_ns <= time_ns), {})


def _latency_ms(arrivals: NDArray[np.int64], turn: _Watched) -> Array:
    """Return the time from stamp to arrival of a turn's messages [ms]."""
    stamps = arrivals[:, 0]
    own = (stamps > turn.begin_ns + _WARM_UP * 1e9) & (stamps < turn.end_ns)
    own &= _is_measured(arrivals)
    latency: Array = 1e-6 * (arrivals[own, 1] - stamps[own])
    return latency if latency.size else np.array([np.nan])


def _is_measured(arrivals: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a message is of new samples: a stale state is stamped 1 ns after the one before."""
    return np.diff(arrivals[:, 0], prepend=0) != 1


def _is_late(arrivals: NDArray[np.int64], turn: _Watched) -> NDArray[np.bool_]:
    """Return of each tick of a controller in a turn whether its newest estimate is too old."""
    ticks = np.arange(turn.begin_ns + round(_WARM_UP * 1e9), turn.end_ns, _TICK)
    measured = arrivals[_is_measured(arrivals)]
    if not len(measured):
        return np.ones(len(ticks), dtype=bool)
    newest = np.searchsorted(measured[:, 1], ticks, side="right") - 1
    late: NDArray[np.bool_] = (newest < 0) | (ticks - measured[newest, 0] > _LATE)
    return late


_NODE_ARGUMENTS = f"""
    --ros-args -r __ns:={_NAMESPACES[NODE]} -p autostart:=true
    -p geometry.area:=3.14159e-4 -p geometry.thickness:=0.02
""".split()


@contextlib.contextmanager
def _process(command: Sequence[str], environment: dict[str, str]) -> Iterator[Any]:
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            preexec_fn=end_with_parent,
        )
        try:
            yield process
            if (process.returncode or 0) > 0:
                errors.seek(0)
                words = " ".join(errors.read().split())[-300:]
                raise InputError(f"{command[2:4]} ended with {process.returncode}: {words}")
        finally:
            if process.poll() is None:
                process.kill()
            process.communicate()


def _ended(process: Any) -> str:
    """Wait for a process; return its last line."""
    output, _ = process.communicate(timeout=60.0)
    lines = str(output).strip().splitlines()
    return lines[-1] if lines else "{}"


def _cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _CLOCK_TICKS


def _memory_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    (line,) = (line for line in status if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024.0


# The processes


def _source(turns: Sequence[tuple[str, float]]) -> None:
    """Publish presses in one namespace after the other, stamped as they are sent."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from simulation.scenario import ramp_scenario
    from simulation.simulate import simulate

    recording = simulate(ramp_scenario(strain_rate=0.15, max_strain=0.27, hold_s=1.0, seed=1))
    first = round(_RATE * _PRESS_FROM)
    streams = (recording.force, recording.displacement)
    forces, depths = (np.roll(stream.value, -first).tolist() for stream in streams)
    size = len(forces)
    wrench, joint = WrenchStamped(), JointState(name=["probe"])
    wrench.header.frame_id = joint.header.frame_id = "tool"

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("source")
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    topics = {"displacement": JointState, "force": WrenchStamped}
    publishers = {
        namespace: [node.create_publisher(t, f"{namespace}/{n}", qos) for n, t in topics.items()]
        for namespace in _NAMESPACES.values()
    }
    while not all(p.get_subscription_count() for pair in publishers.values() for p in pair):
        time.sleep(0.02)
    time.sleep(_COUNTING_PAUSE)
    for namespace, seconds in turns:
        time.sleep(_PAUSE)
        print(json.dumps({"begin_ns": time.time_ns()}), flush=True)
        begin, count = time.monotonic(), round(_RATE * seconds)
        for k in range(count):
            ahead = begin + k / _RATE - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            # However late this process is: what is sent is of the time of its stamp.
            place, part = divmod((time.monotonic() - begin) * _RATE, 1.0)
            for message in (wrench, joint):
                stamp = message.header.stamp
                stamp.sec, stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
            at, after = int(place) % size, (int(place) + 1) % size
            wrench.wrench.force.z = (1.0 - part) * forces[at] + part * forces[after]
            joint.position = [(1.0 - part) * depths[at] + part * depths[after]]
            displacement, force = publishers[namespace]
            displacement.publish(joint)
            force.publish(wrench)
        done = {"sent": count, "end_ns": time.time_ns()}
        print(json.dumps(done), flush=True)
    # Messages in transit, and the last diagnostics.
    time.sleep(_COUNTING_PAUSE)
    node.destroy_node()
    rclpy.try_shutdown()


@contextlib.contextmanager
def _spun(name: str, **options: Any) -> Iterator[Any]:
    """Own a node, and spin it after the block, until a signal."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from fden_ros.nodes.running import make_executor, spin

    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, **options)
    yield node
    executor = make_executor()
    executor.add_node(node)
    spin(executor, lambda: bool(stopped))
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def _relay() -> None:
    """Receive the same messages, publish one of the same kind as often, compute nothing."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from fden_msgs.msg import TissueEstimate
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import JointState

    from fden_ros.ros.topics import INPUT_QOS, OUTPUT_TOPICS

    estimate = TissueEstimate()
    counts = [0, 0]
    with _spun("identifier", namespace=_NAMESPACES[RELAY]) as node:
        qos = OUTPUT_TOPICS[0].profile(0.01)
        estimates = node.create_publisher(TissueEstimate, "~/estimate", qos)
        diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

        def on_force(message: Any) -> None:
            counts[0] += 1
            if counts[0] % _BLOCK == 0:
                estimate.header = message.header
                estimates.publish(estimate)

        def on_displacement(message: Any) -> None:
            counts[1] += 1

        def report() -> None:
            pairs = KeyValue(key="pairs", value=str(min(counts)))
            status = DiagnosticStatus(name=RELAY, values=[pairs])
            diagnostics.publish(DiagnosticArray(status=[status]))

        node.create_subscription(WrenchStamped, "force", on_force, INPUT_QOS)
        node.create_subscription(JointState, "displacement", on_displacement, INPUT_QOS)
        node.create_timer(1.0, report)


def _sink() -> None:
    """Receive the results: arrival times and counts."""
    from diagnostic_msgs.msg import DiagnosticArray
    from fden_msgs.msg import TissueEstimate
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    arrivals: dict[str, list[tuple[int, int]]] = {what: [] for what in _NAMESPACES}
    counts: dict[str, list[tuple[int, dict[str, int]]]] = {what: [] for what in _NAMESPACES}

    def on_estimate(what: str, data: bytes) -> None:
        now = time.time_ns()
        seconds, nanoseconds = _STAMP.unpack_from(data, _BODY)
        arrivals[what].append((seconds * 1_000_000_000 + nanoseconds, now))

    def on_diagnostics(message: DiagnosticArray) -> None:
        status = message.status[0]
        found = {entry.key: entry.value for entry in status.values}
        counted = {key: int(found[key]) for key in ("pairs", "rejected") if key in found}
        lost = [int(value) for key, value in found.items() if key.startswith("lost.")]
        what = RELAY if status.name == RELAY else NODE
        counts[what].append((time.time_ns(), counted | {"lost": max(lost, default=0)}))

    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    with _spun("sink") as node:
        for what, namespace in _NAMESPACES.items():
            topic = f"{namespace}/identifier/estimate"
            hear = functools.partial(on_estimate, what)
            node.create_subscription(TissueEstimate, topic, hear, qos, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, qos)
    print(json.dumps({"arrivals": arrivals, "counts": counts}), flush=True)


def main() -> None:
    """Run one of the processes of the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmark.node")
    parser.add_argument("role", choices=("source", "relay", "sink"))
    parser.add_argument("--turns", type=json.loads, default=[])
    args = parser.parse_args()
    roles = {"relay": _relay, "sink": _sink}
    roles.get(args.role, lambda: _source(args.turns))()


BENCHMARK = Benchmark(run, EPILOG, more=_more)

if __name__ == "__main__":
    main()
