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

"""The node beside a bare relay on real DDS: losses, CPU, latency, memory, and where it saturates.

A source publishes force and displacement (sensor-data QoS), a sink hears what comes out, each in a
process of its own. In between stand, each in a process and a namespace of its own,

node        the identifier
relay       a plain node with the same inputs that publishes a message of the same size as often,
            and computes nothing: the limit that Python and ROS set
raw relay   the same without making messages of the bytes: what is left when nothing is decoded

All wait from the beginning; the source speaks to one at a time. Node and relay take turns over
five rounds, so that what else the machine does meets both: the goals are on the median of the
rounds' ratios, and the spread of the rounds is stated.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EPILOG = """\
examples:
  fden benchmark node --quick               under a minute
  fden benchmark node -o results            ten minutes for node and relay each
  fden benchmark node --seconds 60 --rates 2000 7000

The figures hold for a machine that does nothing else: the load is printed beside them.
"""

_SECONDS, _QUICK_SECONDS = 600.0, 12.0
_ROUNDS = 5
_SATURATION_SECONDS, _QUICK_SATURATION_SECONDS = 20.0, 3.0
_RATES = (2000.0, 4000.0)
#: No goal hangs on the raw relay [s].
_LONGEST_RAW_RELAY = 60.0
#: Left out at the beginning of a turn [s].
_WARM_UP = 0.5
#: Between two turns, and before and after a count of what was lost: diagnostics come once a
#: second [s].
_PAUSE, _COUNTING_PAUSE = 0.2, 1.5
#: Memory counts from then on [s].
_MEMORY_FROM = 60.0
#: The press begins at this time of its recording [s]: the air before it is short.
_PRESS_FROM = 1.9
_BLOCK = 10
_STAMP = struct.Struct("<iI")
_BODY = 4
_CLOCK_TICKS = os.sysconf("SC_CLK_TCK")

NODE, RELAY, RAW_RELAY = "node", "relay", "raw relay"
_NAMESPACES = {NODE: "/node", RELAY: "/relay", RAW_RELAY: "/raw_relay"}


@dataclass(frozen=True)
class Turn:
    """One stretch of messages for one of those in the middle."""

    what: str
    rate: float  #: of each stream [Hz]
    seconds: float
    pause: float = _PAUSE  #: before it [s]


@dataclass(frozen=True)
class Run:
    """What was measured of one process between source and sink at one rate."""

    what: str
    rate: float  #: of each stream [Hz]
    seconds: float  #: of all its turns
    sent: int  #: pairs
    lost: int  #: pairs that did not come through
    told: int  #: of these, how many the process itself counted
    rejected: int
    batches: int  #: how often messages had to be taken together
    most_waiting: int  #: messages
    published: int
    cpu: tuple[float, ...]  #: share of a core, of each turn
    #: p50, p99, p99.9 from stamp to arrival of the result, of each turn
    latency_ms: dict[str, tuple[float, ...]]
    memory_mb: tuple[float, ...]  #: resident, once a second

    @property
    def memory_growth(self) -> float:
        """Growth after the first minute [MB]; NaN where it was shorter."""
        later = self.memory_mb[int(_MEMORY_FROM) :]
        return max(later) - later[0] if len(later) > 10 else float("nan")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help=f"for each at 1 kHz, in {_ROUNDS} turns (default: {_SECONDS:g})",
    )
    parser.add_argument(
        "--rates",
        type=float,
        nargs="*",
        default=_RATES,
        metavar="HZ",
        help="where to look for saturation, shortly (default: 2000 4000)",
    )


def run(args: argparse.Namespace) -> Report:
    """Measure; the exit code does not depend on what comes out."""
    seconds = args.seconds or (_QUICK_SECONDS if args.quick else _SECONDS)
    short = _QUICK_SATURATION_SECONDS if args.quick else _SATURATION_SECONDS
    plan = _ROUNDS * [
        Turn(NODE, 1000.0, seconds / _ROUNDS),
        Turn(RELAY, 1000.0, seconds / _ROUNDS),
    ]
    if not args.quick:
        plan.append(Turn(RAW_RELAY, 1000.0, min(seconds, _LONGEST_RAW_RELAY)))
    for rate in args.rates:
        plan.append(Turn(NODE, rate, short, _COUNTING_PAUSE))
        if not args.quick:
            plan.append(Turn(RELAY, rate, short, _COUNTING_PAUSE))
    with progress("measuring", len(plan)) as step:
        runs = measure(plan, step)
    return Report(_goals(runs), _figures(runs), lambda figure: _draw(runs, figure), [_table(runs)])


# The turns


def measure(plan: Sequence[Turn], step: Callable[[], None] = lambda: None) -> list[Run]:
    """Run source, sink and what is between them; return what was measured of each at each rate."""
    environment = dict(os.environ)
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    environment.setdefault("ROS_DOMAIN_ID", str(40 + os.getpid() % 50))
    me = [sys.executable, "-m", "fden_ros.benchmarks.node"]
    turns = json.dumps([(_NAMESPACES[t.what], t.rate, t.seconds, t.pause) for t in plan])
    tested: dict[str, Any] = {}
    with contextlib.ExitStack() as stack:
        sink = stack.enter_context(_process([*me, "sink"], environment))
        for what in dict.fromkeys(turn.what for turn in plan):
            command = [*me, "relay", *(["--raw"] if what == RAW_RELAY else [])]
            if what == NODE:
                command = [
                    *(sys.executable, "-m", "fden_ros.nodes.programs", "identifier"),
                    *_node_arguments(),
                ]
            tested[what] = stack.enter_context(_process(command, environment))
        sender = stack.enter_context(_process([*me, "source", "--turns", turns], environment))
        watched = []
        for turn in plan:
            watched.append(_watch(turn, tested[turn.what].pid, sender))
            step()
        _ended(sender)
        for what, process in tested.items():
            # The relays leave nothing to tidy up.
            process.send_signal(signal.SIGINT if what == NODE else signal.SIGKILL)
            _ended(process)
        sink.send_signal(signal.SIGINT)
        heard = json.loads(_ended(sink))
    kinds = dict.fromkeys((turn.what, turn.rate) for turn in plan)
    return [
        _run(
            [(t, w) for t, w in zip(plan, watched, strict=True) if (t.what, t.rate) == kind], heard
        )
        for kind in kinds
    ]


@dataclass(frozen=True)
class _Watched:
    """What was seen of a process during a turn."""

    sent: int
    begin_ns: int
    end_ns: int
    cpu: float
    memory_mb: list[float]


def _watch(turn: Turn, pid: int, sender: Any) -> _Watched:
    """Wait for a turn, and return what the process took for it."""
    assert sender.stdout is not None
    begin_ns = json.loads(sender.stdout.readline())["begin_ns"]
    memory = [_memory_mb(pid)]
    time.sleep(_WARM_UP)
    begin, before = time.monotonic(), _cpu_seconds(pid)
    while (left := begin + turn.seconds - _WARM_UP - 0.2 - time.monotonic()) > 0.0:
        time.sleep(min(1.0, left))
        memory.append(_memory_mb(pid))
    cpu = (_cpu_seconds(pid) - before) / (time.monotonic() - begin)
    done = json.loads(sender.stdout.readline())
    return _Watched(done["sent"], begin_ns, done["end_ns"], cpu, memory)


def _run(turns: Sequence[tuple[Turn, _Watched]], heard: dict[str, Any]) -> Run:
    """Return what the turns of one kind come to."""
    what, rate = turns[0][0].what, turns[0][0].rate
    first, last = turns[0][1], turns[-1][1]
    before, after = (
        _counts(heard["counts"][what], first.begin_ns),
        _counts(heard["counts"][what], last.end_ns + round(0.9e9 * _COUNTING_PAUSE)),
    )

    def came(name: str) -> int:
        return int(after.get(name, 0) - before.get(name, 0))

    arrivals = np.array(heard["arrivals"][what], dtype=np.int64).reshape(-1, 2)
    latencies = [_latency_ms(arrivals, watched) for _, watched in turns]
    sent = sum(watched.sent for _, watched in turns)
    return Run(
        what=what,
        rate=rate,
        seconds=sum(turn.seconds for turn, _ in turns),
        sent=sent,
        lost=max(sent - came("pairs") - came("rejected"), 0),
        told=came("lost"),
        rejected=came("rejected"),
        batches=came("batches"),
        most_waiting=int(after.get("most waiting", 0)),
        published=sum(latency.size for latency in latencies),
        cpu=tuple(watched.cpu for _, watched in turns),
        latency_ms={
            name: tuple(float(np.percentile(latency, q)) for latency in latencies)
            for name, q in (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9))
        },
        memory_mb=tuple(memory for _, watched in turns for memory in watched.memory_mb),
    )


def _counts(told: Sequence[tuple[int, dict[str, int]]], time_ns: int) -> dict[str, int]:
    """Return what a process had counted at a time, by its last diagnostics before."""
    return next((counts for heard_ns, counts in reversed(told) if heard_ns <= time_ns), {})


def _latency_ms(arrivals: NDArray[np.int64], watched: _Watched) -> Array:
    """Return the time from stamp to arrival of what belongs to a turn [ms]."""
    stamps = arrivals[:, 0]
    own = (stamps > watched.begin_ns + _WARM_UP * 1e9) & (stamps < watched.end_ns)
    # A stale state is stamped 1 ns after the state that it takes back.
    own[1:] &= np.diff(stamps) != 1
    latency: Array = 1e-6 * (arrivals[own, 1] - stamps[own])
    return latency if latency.size else np.array([np.nan])


def _node_arguments() -> list[str]:
    parameters = {
        "autostart": "true",
        # Each turn is a site of its own, on which the estimator learns: one turn ends in contact.
        "site.timeout": "0.05",
        "geometry.area": "3.14159e-4",
        "geometry.thickness": "0.02",
        "alpha.learn": "false",
        "prior.alpha_sd": "0.0",
    }
    pairs = [("-p", f"{name}:={value}") for name, value in parameters.items()]
    namespace = ("-r", f"__ns:={_NAMESPACES[NODE]}")
    return ["--ros-args", *namespace, *(word for pair in pairs for word in pair)]


@contextlib.contextmanager
def _process(command: Sequence[str], environment: dict[str, str]) -> Iterator[Any]:
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        try:
            yield process
            if process.returncode > 0:
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
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024.0
    return float("nan")


# The processes


def _signals() -> list[int]:
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    return stopped


def _source(turns: Sequence[tuple[str, float, float, float]]) -> None:
    """Publish presses in one namespace after the other, stamped as they are sent."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from fden_ros.recording.cdr import serialize
    from fden_ros.simulation.scenario import ramp_scenario
    from fden_ros.simulation.simulate import simulate

    recording = simulate(ramp_scenario(strain_rate=0.15, max_strain=0.27, hold_s=1.0, seed=1))
    values = [
        [struct.pack("<d", value) for value in stream.value.tolist()]
        for stream in (recording.force, recording.displacement)
    ]
    wrench, joint = WrenchStamped(), JointState(name=["probe"], position=[0.0])
    wrench.header.frame_id = joint.header.frame_id = "tool"
    wrench.wrench.force.z = joint.position[0] = 1234.5
    templates = [bytearray(serialize(wrench)), bytearray(serialize(joint))]
    places = [bytes(t).index(struct.pack("<d", 1234.5)) for t in templates]

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("source")
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    publishers = {
        namespace: [
            node.create_publisher(WrenchStamped, f"{namespace}/force", qos),
            node.create_publisher(JointState, f"{namespace}/displacement", qos),
        ]
        for namespace in dict.fromkeys(turn[0] for turn in turns)
    }
    while not all(p.get_subscription_count() for pair in publishers.values() for p in pair):
        time.sleep(0.02)
    time.sleep(_COUNTING_PAUSE)
    for namespace, rate, seconds, pause in turns:
        time.sleep(pause)
        print(json.dumps({"begin_ns": time.time_ns()}), flush=True)
        sent = _send(publishers[namespace], templates, places, values, rate, seconds)
        print(json.dumps({"sent": sent, "end_ns": time.time_ns()}), flush=True)
    # What is still under way, and the last diagnostics.
    time.sleep(_COUNTING_PAUSE)
    node.destroy_node()
    rclpy.try_shutdown()


def _send(
    publishers: Sequence[Any],
    templates: Sequence[bytearray],
    places: Sequence[int],
    values: Sequence[Sequence[bytes]],
    rate: float,
    seconds: float,
) -> int:
    """Send presses for a turn; return how many pairs."""
    count, samples = round(rate * seconds), len(values[0])
    first = round(1000.0 * _PRESS_FROM)
    begin = time.monotonic()
    for k in range(count):
        ahead = begin + k / rate - time.monotonic()
        if ahead > 0.0:
            time.sleep(ahead)
        stamp = _STAMP.pack(*divmod(time.time_ns(), 1_000_000_000))
        index = (first + int(k * 1000.0 / rate)) % samples
        for which in (1, 0):
            data, place = templates[which], places[which]
            data[_BODY : _BODY + 8] = stamp
            data[place : place + 8] = values[which][index]
            publishers[which].publish(bytes(data))
    return count


def _relay(raw: bool) -> None:
    """Take the same messages, publish one of the same kind as often, compute nothing, for ever."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from fden_msgs.msg import TissueEstimate
    from geometry_msgs.msg import WrenchStamped
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from fden_ros.nodes.running import make_executor, spin
    from fden_ros.recording.cdr import serialize
    from fden_ros.ros.topics import INPUT_QOS, OUTPUT_TOPICS

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    name = RAW_RELAY if raw else RELAY
    namespace = _NAMESPACES[name]
    node = rclpy.create_node("identifier", namespace=namespace)
    estimates = node.create_publisher(TissueEstimate, "~/estimate", OUTPUT_TOPICS[0].profile(0.01))
    diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    estimate = TissueEstimate()
    template = bytearray(serialize(estimate))
    counts = [0, 0]

    def on_force(message: Any) -> None:
        counts[0] += 1
        if counts[0] % _BLOCK:
            return
        if raw:
            template[_BODY : _BODY + 8] = message[_BODY : _BODY + 8]
            estimates.publish(bytes(template))
        else:
            estimate.header = message.header
            estimates.publish(estimate)

    def on_displacement(message: Any) -> None:
        counts[1] += 1

    def tell() -> None:
        pairs = KeyValue(key="pairs", value=str(min(counts)))
        status = DiagnosticStatus(name=name, values=[pairs])
        diagnostics.publish(DiagnosticArray(status=[status]))

    node.create_subscription(WrenchStamped, "force", on_force, INPUT_QOS, raw=raw)
    node.create_subscription(JointState, "displacement", on_displacement, INPUT_QOS, raw=raw)
    node.create_timer(1.0, tell)
    executor = make_executor()
    executor.add_node(node)
    spin(executor, lambda: False)


def _sink() -> None:
    """Hear the results: when they came, and what was counted."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from fden_msgs.msg import TissueEstimate
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.signals import SignalHandlerOptions

    from fden_ros.nodes.running import make_executor, spin

    stopped = _signals()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("sink")
    arrivals: dict[str, list[tuple[int, int]]] = {what: [] for what in _NAMESPACES}
    counts: dict[str, list[tuple[int, dict[str, int]]]] = {what: [] for what in _NAMESPACES}

    def hear(what: str) -> Callable[[bytes], None]:
        own = arrivals[what]

        def on_estimate(data: bytes) -> None:
            now = time.time_ns()
            seconds, nanoseconds = _STAMP.unpack_from(data, _BODY)
            own.append((seconds * 1_000_000_000 + nanoseconds, now))

        return on_estimate

    def on_diagnostics(message: DiagnosticArray) -> None:
        status = message.status[0]
        what = status.name if status.name in _NAMESPACES else NODE
        counts[what].append((time.time_ns(), _counted(status.values)))

    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    for what, namespace in _NAMESPACES.items():
        topic = f"{namespace}/identifier/estimate"
        node.create_subscription(TissueEstimate, topic, hear(what), qos, raw=True)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, qos)
    executor = make_executor()
    executor.add_node(node)
    spin(executor, lambda: bool(stopped))
    print(json.dumps({"arrivals": arrivals, "counts": counts}), flush=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def _counted(values: Sequence[Any]) -> dict[str, int]:
    """Return the counts in a diagnostic status."""
    counts = {
        entry.key: int(entry.value)
        for entry in values
        if entry.key in ("pairs", "rejected", "most waiting", "batches")
    }
    lost = [int(entry.value) for entry in values if entry.key.startswith("lost.")]
    return counts | {"lost": max(lost, default=0)}


# The report


def _of(runs: Sequence[Run], what: str, rate: float = 1000.0) -> Run:
    return next(r for r in runs if r.what == what and r.rate == rate)


def _ratios(above: Sequence[float], below: Sequence[float]) -> tuple[float, float, float]:
    """Return least, median and largest ratio of the rounds."""
    ratios = np.array(above) / np.array(below)
    return float(ratios.min()), float(np.median(ratios)), float(ratios.max())


def _goals(runs: Sequence[Run]) -> list[Goal]:
    node, relay = _of(runs, NODE), _of(runs, RELAY)
    infinity = float("inf")
    cpu = _ratios(node.cpu, relay.cpu)
    p99 = _ratios(node.latency_ms["p99"], relay.latency_ms["p99"])
    goals = [
        Goal("pairs lost at 1 kHz", node.lost, "0", node.lost == 0),
        within("CPU over relay's", cpu[1], (-infinity, 1.4)),
        within("p99 latency over relay's", p99[1], (-infinity, 1.5)),
        within("memory grown after a minute [MB]", node.memory_growth, (-infinity, 2.0)),
    ]
    for fast in (r for r in runs if r.what == NODE and r.rate != 1000.0):
        unsaid = max(fast.lost - fast.told, 0)
        name = f"pairs lost silently at {fast.rate:g} Hz"
        goals.append(Goal(name, unsaid, "0", unsaid == 0))
    return goals


def _figures(runs: Sequence[Run]) -> dict[str, Any]:
    rows = []
    for one in runs:
        row = asdict(one) | {"memory_growth_mb": one.memory_growth}
        row["memory_mb"] = [one.memory_mb[0], one.memory_mb[-1]]
        rows.append(row)
    node, relay = _of(runs, NODE), _of(runs, RELAY)
    ratios = {
        "cpu": _ratios(node.cpu, relay.cpu),
        "p99": _ratios(node.latency_ms["p99"], relay.latency_ms["p99"]),
    }
    return {
        "runs": rows,
        "ratios": ratios,
        "load_average": os.getloadavg(),
        "cores": os.cpu_count(),
    }


def _table(runs: Sequence[Run]) -> Any:
    from rich import box
    from rich.table import Table

    load = os.getloadavg()[0]
    table = Table(title=f"{os.cpu_count()} cores, load {load:.1f} at the end", box=box.SIMPLE_HEAD)
    for name in (
        "",
        "Hz",
        "s",
        "sent",
        "lost",
        "told",
        "waited",
        "CPU",
        "p50",
        "p99",
        "p99.9",
        "MB",
    ):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    for one in runs:
        table.add_row(
            one.what,
            f"{one.rate:g}",
            f"{one.seconds:g}",
            str(one.sent),
            str(one.lost),
            str(one.told),
            str(one.most_waiting),
            _spread(one.cpu),
            *(_spread(one.latency_ms[p]) for p in ("p50", "p99", "p99.9")),
            f"{one.memory_mb[-1]:.0f}",
        )
    node, relay = _of(runs, NODE), _of(runs, RELAY)
    cpu = "{0:.2f} to {2:.2f}".format(*_ratios(node.cpu, relay.cpu))
    p99 = "{0:.2f} to {2:.2f}".format(*_ratios(node.latency_ms["p99"], relay.latency_ms["p99"]))
    table.caption = (
        "latency in ms from stamp to arrival at the sink; CPU in cores; pairs; median of the "
        f"turns, least and largest; node over relay: CPU {cpu}, p99 {p99}"
    )
    return table


def _spread(values: Sequence[float]) -> str:
    """Return the median, and below it the least and the largest where there are several."""
    middle = f"{np.median(values):.2f}"
    return middle if len(values) == 1 else f"{middle}\n{min(values):.2f}–{max(values):.2f}"


def _draw(runs: Sequence[Run], figure: Figure) -> None:
    at_1khz = [r for r in runs if r.rate == 1000.0]
    others = [r for r in runs if r.rate != 1000.0]
    names = [r.what if r.rate == 1000.0 else f"{r.what}\n{r.rate:g} Hz" for r in at_1khz + others]
    cpu_axes, latency_axes = figure.subplots(1, 2)
    colours = ["C0" if r.what == NODE else "0.6" for r in at_1khz + others]
    cpu_axes.bar(names, [float(np.median(r.cpu)) for r in at_1khz + others], color=colours)
    limit = 1.4 * float(np.median(_of(runs, RELAY).cpu))
    cpu_axes.axhline(limit, color="C3", linestyle="--", linewidth=1.0)
    cpu_axes.annotate(
        "1.4 of the relay at 1 kHz ",
        (1.0, limit),
        xycoords=("axes fraction", "data"),
        color="C3",
        va="bottom",
        ha="right",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
    cpu_axes.set(ylabel="CPU [cores]", title="CPU of the process in the middle")
    for offset, share in enumerate(("p50", "p99", "p99.9")):
        places = np.arange(len(names)) + 0.27 * (offset - 1)
        values = [float(np.median(r.latency_ms[share])) for r in at_1khz + others]
        latency_axes.bar(places, values, width=0.25, label=share, color=f"C{offset}")
    latency_axes.set_xticks(range(len(names)), names)
    latency_axes.set(
        ylabel="latency [ms]", yscale="log", title="From stamp to arrival of the estimate"
    )
    latency_axes.legend()


def main(arguments: Sequence[str] | None = None) -> int:
    """Be one of the processes of a run."""
    parser = argparse.ArgumentParser(prog="python -m fden_ros.benchmarks.node")
    parser.add_argument("role", choices=("source", "relay", "sink"))
    parser.add_argument("--turns", type=json.loads, default=[])
    parser.add_argument("--raw", action="store_true")
    args = parser.parse_args(arguments)
    if args.role == "source":
        _source(args.turns)
    elif args.role == "relay":
        _relay(args.raw)
    else:
        _sink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
