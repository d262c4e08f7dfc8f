"""The node beside a bare relay on real DDS: losses, CPU, latency, memory, and where it saturates.

A source publishes force and displacement (sensor-data QoS), a sink hears what comes out, each in a
process of its own. In between stands, one after the other,

node        the identifier
relay       a plain node with the same inputs that publishes a message of the same size as often,
            and computes nothing: the limit that Python and ROS set
raw relay   the same without making messages of the bytes: what is left when nothing is decoded
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
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

EPILOG = """\
examples:
  fden benchmark node --quick               under a minute
  fden benchmark node -o results            ten minutes for node and relay each
  fden benchmark node --seconds 60 --rates 1000 7000

The figures hold for a machine that does nothing else: the load is printed beside them.
"""

_SECONDS, _QUICK_SECONDS = 600.0, 6.0
_SATURATION_SECONDS, _QUICK_SATURATION_SECONDS = 20.0, 4.0
_RATES = (2000.0, 4000.0)
#: No goal hangs on the raw relay [s].
_LONGEST_RAW_RELAY = 60.0
#: Left out at the beginning: discovery, imports, the first touch.
_WARM_UP = 2.0
#: Memory counts from then on [s].
_MEMORY_FROM = 60.0
_BLOCK = 10
_ESTIMATE = "/identifier/estimate"
_STAMP = struct.Struct("<iI")
_BODY = 4
_CLOCK_TICKS = os.sysconf("SC_CLK_TCK")

NODE, RELAY, RAW_RELAY = "node", "relay", "raw relay"


@dataclass(frozen=True)
class Run:
    """What was measured of one process between source and sink."""

    what: str
    rate: float  #: of each stream [Hz]
    seconds: float
    sent: int  #: pairs
    lost: int  #: pairs that did not come through
    told: int  #: of these, how many the process itself counted
    rejected: int
    batches: int  #: how often messages had to be taken together
    most_waiting: int  #: messages
    published: int
    cpu: float  #: share of a core
    latency_ms: dict[str, float]  #: p50, p99, p99.9 from stamp to arrival of the result
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
        "--seconds", type=float, metavar="S", help=f"for each at 1 kHz (default: {_SECONDS:g})"
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
    plan = [(NODE, 1000.0, seconds), (RELAY, 1000.0, seconds)]
    plan.append((RAW_RELAY, 1000.0, min(seconds, _LONGEST_RAW_RELAY)))
    for rate in args.rates:
        plan += [(NODE, rate, short)] + ([] if args.quick else [(RELAY, rate, short)])
    runs = []
    with progress("measuring", len(plan)) as step:
        for what, rate, duration in plan:
            runs.append(measure(what, rate, duration))
            step()
    return Report(_goals(runs), _figures(runs), lambda figure: _draw(runs, figure), [_table(runs)])


# One run


def measure(what: str, rate: float, seconds: float) -> Run:
    """Run source, `what` and sink, and return what was measured."""
    environment = dict(os.environ)
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    environment.setdefault("ROS_DOMAIN_ID", str(40 + os.getpid() % 50))
    me = [sys.executable, "-m", "fden_ros.benchmarks.node"]
    middle = [*me, "relay", *(["--raw"] if what == RAW_RELAY else [])]
    if what == NODE:
        middle = [sys.executable, "-m", "fden_ros.nodes.identifier", *_node_arguments()]
    source = [*me, "source", "--rate", str(rate), "--seconds", str(seconds + _WARM_UP)]
    with contextlib.ExitStack() as stack:
        sink = stack.enter_context(_process([*me, "sink"], environment))
        tested = stack.enter_context(_process(middle, environment))
        sender = stack.enter_context(_process(source, environment))
        watched = _watch(tested.pid, sender, seconds)
        sent = json.loads(_ended(sender)).get("sent", 0)
        # What is still under way.
        time.sleep(2.0 + (2.0 if rate > 1000.0 else 0.0))
        # The relay leaves nothing to tidy up.
        tested.send_signal(signal.SIGINT if what == NODE else signal.SIGKILL)
        sink.send_signal(signal.SIGINT)
        _ended(tested)
        heard = json.loads(_ended(sink))
    counts = heard["counts"]
    lost = max(sent - counts.get("pairs", 0) - counts.get("rejected", 0), 0)
    return Run(
        what=what,
        rate=rate,
        seconds=seconds,
        sent=sent,
        lost=lost,
        told=counts.get("lost", 0),
        rejected=counts.get("rejected", 0),
        batches=counts.get("batches", 0),
        most_waiting=counts.get("most waiting", 0),
        published=heard["published"],
        cpu=watched[0],
        latency_ms=heard["latency_ms"],
        memory_mb=watched[1],
    )


def _node_arguments() -> list[str]:
    parameters = {
        "autostart": "true",
        "site.timeout": "1.0",
        "geometry.area": "3.14159e-4",
        "geometry.thickness": "0.02",
        "alpha.learn": "false",
        "prior.alpha_sd": "0.0",
    }
    pairs = [("-p", f"{name}:={value}") for name, value in parameters.items()]
    return ["--ros-args", *(word for pair in pairs for word in pair)]


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


def _watch(pid: int, sender: Any, seconds: float) -> tuple[float, tuple[float, ...]]:
    """Return the share of a core and the memory of a process while the sender sends."""
    assert sender.stdout is not None
    sender.stdout.readline()  # sent when the first message is
    time.sleep(_WARM_UP)
    begin, before = time.monotonic(), _cpu_seconds(pid)
    memory = [_memory_mb(pid)]
    while time.monotonic() - begin < seconds - 0.5 and sender.poll() is None:
        time.sleep(min(1.0, seconds / 4.0))
        memory.append(_memory_mb(pid))
    elapsed = time.monotonic() - begin
    return (_cpu_seconds(pid) - before) / elapsed, tuple(memory)


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


def _source(rate: float, seconds: float) -> None:
    """Publish a press every few seconds, stamped as it is sent."""
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
    publishers = [
        node.create_publisher(WrenchStamped, "/force", qos),
        node.create_publisher(JointState, "/displacement", qos),
    ]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.02)
    time.sleep(1.0)
    print("{}", flush=True)
    count, samples = round(rate * seconds), len(values[0])
    begin = time.monotonic()
    for k in range(count):
        ahead = begin + k / rate - time.monotonic()
        if ahead > 0.0:
            time.sleep(ahead)
        stamp = _STAMP.pack(*divmod(time.time_ns(), 1_000_000_000))
        index = int(k * 1000.0 / rate) % samples
        for which in (1, 0):
            data, place = templates[which], places[which]
            data[_BODY : _BODY + 8] = stamp
            data[place : place + 8] = values[which][index]
            publishers[which].publish(bytes(data))
    print(json.dumps({"sent": count}), flush=True)
    time.sleep(1.0)
    node.destroy_node()
    rclpy.try_shutdown()


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
    from fden_ros.ros.topics import ESTIMATE_QOS, INPUT_QOS

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("identifier")
    estimates = node.create_publisher(TissueEstimate, _ESTIMATE, ESTIMATE_QOS)
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
        status = DiagnosticStatus(values=[KeyValue(key="pairs", value=str(min(counts)))])
        diagnostics.publish(DiagnosticArray(status=[status]))

    node.create_subscription(WrenchStamped, "/force", on_force, INPUT_QOS, raw=raw)
    node.create_subscription(JointState, "/displacement", on_displacement, INPUT_QOS, raw=raw)
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
    arrivals: list[tuple[int, int]] = []
    counts: dict[str, int] = {}

    def on_estimate(data: bytes) -> None:
        now = time.time_ns()
        seconds, nanoseconds = _STAMP.unpack_from(data, _BODY)
        arrivals.append((seconds * 1_000_000_000 + nanoseconds, now))

    def on_diagnostics(message: DiagnosticArray) -> None:
        for entry in message.status[0].values:
            if entry.key in ("pairs", "rejected", "most waiting", "batches"):
                counts[entry.key] = int(entry.value)
            if entry.key.startswith("lost."):
                counts[entry.key] = int(entry.value)

    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    node.create_subscription(TissueEstimate, _ESTIMATE, on_estimate, qos, raw=True)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, qos)
    executor = make_executor()
    executor.add_node(node)
    spin(executor, lambda: bool(stopped))
    counts["lost"] = max((n for k, n in counts.items() if k.startswith("lost.")), default=0)
    print(json.dumps(_heard(arrivals, counts)), flush=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def _heard(arrivals: list[tuple[int, int]], counts: dict[str, int]) -> dict[str, Any]:
    times = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    kept = times[times[:, 0] > times[0, 0] + round(_WARM_UP * 1e9)] if len(times) else times
    if len(kept) > 1:
        # A stale state is stamped 1 ns after the state that it takes back.
        kept = kept[1:][np.diff(kept[:, 0]) != 1]
    latency = 1e-6 * (kept[:, 1] - kept[:, 0]) if len(kept) else np.array([np.nan])
    shares = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
    return {
        "published": len(kept),
        "counts": counts,
        "latency_ms": {name: float(np.percentile(latency, q)) for name, q in shares.items()},
    }


# The report


def _of(runs: Sequence[Run], what: str, rate: float = 1000.0) -> Run:
    return next(r for r in runs if r.what == what and r.rate == rate)


def _goals(runs: Sequence[Run]) -> list[Goal]:
    node, relay = _of(runs, NODE), _of(runs, RELAY)
    infinity = float("inf")
    goals = [
        Goal("pairs lost at 1 kHz", node.lost, "0", node.lost == 0),
        within("CPU over relay's", node.cpu / relay.cpu, (-infinity, 1.4)),
        within(
            "p99 latency over relay's",
            node.latency_ms["p99"] / relay.latency_ms["p99"],
            (-infinity, 1.5),
        ),
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
    return {"runs": rows, "load_average": os.getloadavg(), "cores": os.cpu_count()}


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
            f"{one.cpu:.2f}",
            *(f"{one.latency_ms[p]:.2f}" for p in ("p50", "p99", "p99.9")),
            f"{one.memory_mb[-1]:.0f}",
        )
    table.caption = "latency in ms from stamp to arrival at the sink; CPU in cores; pairs"
    return table


def _draw(runs: Sequence[Run], figure: Figure) -> None:
    at_1khz = [r for r in runs if r.rate == 1000.0]
    others = [r for r in runs if r.rate != 1000.0]
    names = [r.what if r.rate == 1000.0 else f"{r.what}\n{r.rate:g} Hz" for r in at_1khz + others]
    cpu_axes, latency_axes = figure.subplots(1, 2)
    colours = ["C0" if r.what == NODE else "0.6" for r in at_1khz + others]
    cpu_axes.bar(names, [r.cpu for r in at_1khz + others], color=colours)
    cpu_axes.axhline(1.4 * at_1khz[1].cpu, color="C3", linestyle="--", linewidth=1.0)
    cpu_axes.annotate(
        "1.4 of the relay at 1 kHz ",
        (1.0, 1.4 * at_1khz[1].cpu),
        xycoords=("axes fraction", "data"),
        color="C3",
        va="bottom",
        ha="right",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
    cpu_axes.set(ylabel="CPU [cores]", title="CPU of the process in the middle")
    for offset, share in enumerate(("p50", "p99", "p99.9")):
        places = np.arange(len(names)) + 0.27 * (offset - 1)
        values = [r.latency_ms[share] for r in at_1khz + others]
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
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--raw", action="store_true")
    args = parser.parse_args(arguments)
    if args.role == "source":
        _source(args.rate, args.seconds)
    elif args.role == "relay":
        _relay(args.raw)
    else:
        _sink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
