# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The live system over DDS: controller, example, monitor, map, and who listens."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from command_helpers import points, text_of
from fden_msgs.msg import PalpationSummary, TissueEstimate
from geometry_msgs.msg import WrenchStamped
from live_helpers import (
    LIMIT,
    PARAMETERS,
    ROOT,
    Ears,
    command_of,
    node_process,
    process_of,
    wait_for,
)
from pipeline_helpers import ESTIMATE, of_columns, states_of, summary
from property_helpers import counts
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2, PointField
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from benchmark.trial import elapsed
from fden_ros.advice import FLAGS
from fden_ros.control import Cause, LiveTissue, Refusal
from fden_ros.core.estimation import ParameterSet
from fden_ros.core.law import FlatPunch
from fden_ros.core.outputs import (
    ContactSummary,
    Flag,
    OrderSource,
    Phase,
    Signals,
    Status,
    TissueState,
    late,
)
from fden_ros.core.stiffness import MeasuredSlope, Slopes
from fden_ros.core.streams import NANOSECONDS
from fden_ros.report.monitor import MonitorView, monitor_line, monitor_view
from fden_ros.ros.stiffness_map import StiffnessMap
from fden_ros.simulation import FdenModel
from fden_ros.tissue_feed import TissueFeed
from simulation.closed_form import moves_of_knots
from simulation.contact import contacts_of_moves
from simulation.simulate import EXACT

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: What a machine that runs every other test beside it can keep pace with.
SIMULATOR = {"axis.max_speed": 0.01, "force.rate": 100.0, "displacement.rate": 100.0}
IDENTIFIER = {
    "autostart": True,
    "estimate.period": 0.02,
    "lag_deadline": 1.0,
    "qos_overrides./force.subscription.reliability": "reliable",
    "qos_overrides./displacement.subscription.reliability": "reliable",
}


def on_map(site: int, stiffness: float = 500.0) -> ContactSummary:
    """A contact with a place, ln G known to 0.02."""
    estimate = ESTIMATE._replace(
        log_linear_stiffness=math.log(stiffness), covariance=np.diag([4e-4, 4e-4, 1e-4])
    )
    return summary(
        site_id=site,
        contact_id=site,
        estimate=estimate,
        position=(0.01 * site, 0.02, 0.03),
        position_frame="base",
    )


def test_a_site_is_one_point_of_its_newest_contact():
    stiffness_map = StiffnessMap()
    for site, stiffness in ((1, 300.0), (2, 900.0), (1, 320.0)):
        assert stiffness_map.add(on_map(site, stiffness))
    raw = stiffness_map.cloud()
    assert raw.header.frame_id == "base"
    # RViz draws coordinates of float32 alone.
    assert [field.datatype for field in raw.fields[:3]] == [PointField.FLOAT32] * 3
    assert len(raw.data) == raw.row_step == 2 * raw.point_step
    cloud = points(raw)
    assert cloud["G"] == pytest.approx([320.0, 900.0])
    assert cloud["x"] == pytest.approx([0.01, 0.02])
    assert cloud["G_sd"] == pytest.approx([6.4, 18.0])
    assert np.isnan(cloud["stiffness"]).all()  # not known: a gap in colours and plots


def shown(view: MonitorView) -> str:
    return text_of(monitor_view(view), 110)


def test_the_monitor_shows_what_is_known_and_what_is_not():
    assert "nothing received yet" in shown(MonitorView("/identifier"))
    state = TissueState(
        stamp_ns=0,
        status=Status.CONVERGED,
        flags=Flag.GAP,
        site_id=2,
        contact_id=3,
        phase=Phase.HOLDING,
        order_source=OrderSource.LEARNED,
        estimate=ESTIMATE,
        signals=Signals(0.2, 500.0, 400.0),
    )
    slope = MeasuredSlope(2619.7, 12.0, 0.005, 0)
    unknown = ESTIMATE._replace(known=ParameterSet(0))
    alone = replace(on_map(2), converged=False, estimate=unknown, measured=Slopes(slope))
    view = MonitorView(
        "/identifier", state=state, age=0.01, rate=99.0, label="liver", gains="safe"
    )
    text = shown(
        replace(
            view,
            refusal=Refusal(Cause.REJECTED, Flag.GAP),
            probabilities={"liver": 0.97, "unknown": 0.03},
            summaries=(on_map(1), alone),
        )
    )
    interval = f"[{500 * math.exp(-0.2):.4g}, {500 * math.exp(0.2):.4g}]"
    for words in (interval, "gap", "99 Hz", "3 at site 2", "liver 97%", "safe", "2,620", "(500 ±"):
        assert words in text
    assert "no estimate for 3.0 s" in shown(replace(view, age=3.0, refusal=Refusal(Cause.LOST)))


@pytest.mark.parametrize(
    ("contact", "flags", "words"),
    [
        (0, Flag.NONE, "hold the probe in the air for 2 s, then press"),
        (1, Flag.NONE, "nothing: it identifies"),
        (1, Flag.MODEL_MISMATCH, str(FLAGS["MODEL_MISMATCH"])),
    ],
)
def test_the_next_step_is_that_of_the_present_contact(contact, flags, words):
    state = TissueState(0, Status.CONVERGING, flags, contact, contact, Phase.LOADING)
    # Once a second, the diagnostics may not count it yet.
    said = {"message": "identifying", "contacts": "0"}
    view = MonitorView("/identifier", state=state, age=0.01, diagnostics=said)
    assert monitor_line(view).endswith(f"next: {words}")


@pytest.fixture(scope="module")
def simulator() -> Iterator[None]:
    """The simulated tissue, started as the page does; the probe is in the air at first."""
    command = command_of("tissue_simulator", SIMULATOR, file=PARAMETERS)
    command[1:4] = ["-m", "fden_ros.nodes.tissue_simulator"]
    with process_of(command):
        yield


def test_the_documented_program_runs_as_it_stands(simulator):
    program = ROOT / "examples" / "controller.py"
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/force")
        estimates = ears.hear(TissueEstimate, "/identifier/estimate")
        with node_process("identifier", IDENTIFIER, file=PARAMETERS):
            # The air's noise is measured before the touch.
            ears.wait_for(lambda: len(estimates) > 50, "the identifier")
            with process_of([sys.executable, str(program)]) as controller:
                ears.wait_for(
                    lambda: abs(mean_force(forces) - 0.15) < 0.01, "the force it wants", 90.0
                )
                assert controller.poll() is None
    assert controller.returncode == 0
    assert "Traceback" not in controller.output and "Error" not in controller.output


def test_the_controller_schedules_live_and_falls_back_when_the_node_dies(simulator):
    with Ears() as ears:
        gains = ears.hear(String, "/force_controller/gains", LATCHED)
        forces = ears.hear(WrenchStamped, "/force")
        estimates = ears.hear(TissueEstimate, "/identifier/estimate")
        summaries = ears.hear(PalpationSummary, "/identifier/palpation", LATCHED)
        maps = ears.hear(PointCloud2, "/identifier/stiffness_map", LATCHED)
        target = ears.node.create_publisher(Float64, "/target_force", 10)
        reset = ears.node.create_client(Trigger, "/identifier/reset")

        def press() -> None:
            """Press until the gains are live: anew where a machine lost samples or is late."""
            for _ in range(3):
                # The air's noise is measured before the touch.
                estimates.clear()
                ears.wait_for(lambda: len(estimates) > 100, "1 s of air")
                target.publish(Float64(data=0.1))
                with contextlib.suppress(AssertionError):
                    ears.wait_for(lambda: gains and gains[-1].data == "live", "live gains", 30.0)
                    return
                release()
                assert reset.call_async(Trigger.Request())
            raise AssertionError(f"no live gains in three presses: {found()}")

        def release() -> None:
            target.publish(Float64(data=0.0))
            air = TissueEstimate.STATUS_NO_CONTACT
            ears.wait_for(lambda: estimates[-1].status == air, "the air")

        def found() -> str:
            flags = [str(Flag(summary.flags)) for summary in summaries]
            return f"flags of {estimates[-1].flags} now, {flags} in the summaries"

        command = ears.node.create_publisher(JointState, "/command", 10)
        ears.wait_for(command.get_subscription_count, "the simulator")
        # Another place: nothing is known of what the program did to the first.
        command.publish(JointState(name=["x", "z"], position=[0.02, -0.004]))
        with node_process("identifier", IDENTIFIER, file=PARAMETERS) as identifier:
            ears.wait_for(lambda: estimates, "the identifier")
            controller = {"program.forces": "[0.0]", "tare_time": 2.0, "reaction_time": 0.1}
            with node_process("force_controller", controller, file=PARAMETERS) as node:
                ears.wait_for(target.get_subscription_count, "the controller")
                press()
                ears.wait_for(lambda: abs(mean_force(forces) - 0.1) < 0.01, "the force wanted")
                release()
                ears.wait_for(lambda: maps or summaries, "the summary")
                # The map is that of a contact whose touch and history were seen.
                ears.wait_for(lambda: maps, f"the map: {found()}", 30.0)
                cloud = points(maps[-1])
                assert cloud["G"] == pytest.approx([544.8], rel=0.1), found()
                assert cloud["x"] == pytest.approx([0.02], abs=1e-4)
                assert maps[-1].header.frame_id == "base"
                # And measured again, where the release found the force off its zero.
                press()
                gains.clear()
                identifier.kill()
                ears.wait_for(lambda: gains and gains[-1].data == "safe", "safe gains")
            assert node.returncode == 0


def mean_force(forces: list[Any], bias: float = 0.05) -> float:
    if len(forces) < 50:
        return math.nan
    return float(np.mean([message.wrench.force.z for message in forces[-20:]])) - bias


def test_the_live_system_starts_and_ends_with_its_terminal():
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/fden_live/force")
        with process_of([sys.executable, "-m", "fden_ros.cli", "live"]) as live:
            ears.wait_for(lambda: len(forces) > 100, "the simulator")
            ears.wait_for(
                lambda: ears.node.count_publishers("/fden_live/command"), "the controller"
            )
            ears.wait_for(
                lambda: ears.node.count_publishers("/fden_live/identifier/estimate"),
                "the identifier",
            )
            # Piped, it prints as it goes.
            assert live.stdout.readline()
            live.send_signal(signal.SIGHUP)
            assert live.wait(LIMIT) == 130
        assert "Traceback" not in live.output
        ears.wait_for(
            lambda: not ears.node.count_publishers("/fden_live/force"), "everybody's end"
        )


AREA, THICKNESS = 3.1416e-4, 0.02
GEOMETRY = FlatPunch(AREA, THICKNESS)
DEADLINE = 0.1


class Press:
    """A press to 5 mm at 250 Hz with its true force, and the states that the pipeline made of it.

    `after` is its speed from 3.2 s on [m/s].
    """

    def __init__(self, model: FdenModel, seed: int, after: float) -> None:
        draw, knots = np.random.default_rng(seed), np.array([0.0, 1.5, 2.7, 3.2, 4.4])
        depths = np.array([-2e-3, -2e-3, 5e-3, 5e-3, 5e-3 + 1.2 * after])
        self.times = np.arange(0.0, 4.4, 4e-3)
        self.depth = np.interp(self.times, knots, depths)
        contacts = contacts_of_moves(moves_of_knots(knots, depths / THICKNESS), model)
        self.force = AREA * contacts.stress(self.times)
        read = self.force + 1e-3 * draw.standard_normal(self.times.size)
        parameters = EXACT | {"geometry.area": AREA, "geometry.thickness": THICKNESS}
        places = self.depth + 1e-6 * draw.standard_normal(self.times.size)
        self.states = states_of(of_columns(parameters, self.times, read, places)[1])

    def heard_until(self, seconds: float, **options: Any) -> tuple[LiveTissue, float]:
        """Return who heard the states so far, and the time of the last."""
        live = LiveTissue(GEOMETRY, **options)
        heard = [state for state in self.states if elapsed(state.stamp_ns) <= seconds]
        for state in heard:
            live.add(state, state.stamp_ns / NANOSECONDS)
        self.last = heard[-1]
        return live, self.last.stamp_ns / NANOSECONDS


LIVER = FdenModel(544.8, 8.547, 0.131)


@pytest.fixture(scope="module")
def press() -> Press:
    return Press(LIVER, seed=1, after=0.002)


@pytest.mark.parametrize("seeds", counts(2, 8))
def test_predictions_hold_the_truth_in_their_intervals_on_random_tissue(seeds):
    """Two deviations hold 95 % if the model's linearisation is right; asked for are 85 %."""
    generator = np.random.default_rng(7)
    inside, errors = [], []
    for seed in range(seeds):
        g, gn, order = np.array([520.0, 8.4, 0.131]) * np.exp(
            np.array([0.25, 0.15, 0.08]) * generator.standard_normal(3)
        )
        run = Press(FdenModel(g, gn, order), seed, after=(0.002, 0.004, -0.002, 0.0)[seed % 4])
        live, now = run.heard_until(3.2)
        # The estimate stands for the middle of its block.
        start = elapsed(run.last.stamp_ns) - 0.005
        ahead = np.linspace(0.02, 1.0, 50)
        way = np.interp(start + ahead, run.times, run.depth) - np.interp(
            start, run.times, run.depth
        )
        force = np.interp(start + ahead, run.times, run.force)
        predictor = live.predictor(now)
        assert predictor is not None, live.refusal(now)
        predicted = predictor.force(ahead, way)
        low, high = predicted.interval(2.0)
        inside += list(((low <= force) & (force <= high))[[5, 20, 49]])
        errors.append(np.max(np.abs(predicted.value - force)) / force.max())
    assert np.mean(inside) >= 0.85
    assert np.median(errors) < 0.02


def test_an_old_estimate_and_that_of_one_of_two_publishers_are_refused(press):
    losses: list[Refusal] = []
    live, now = press.heard_until(3.2, on_loss=losses.append)
    reading = live.reading(now + 0.9 * DEADLINE)
    assert reading is not None and reading.age == pytest.approx(0.9 * DEADLINE, abs=0.01)
    late = now + 1.01 * DEADLINE
    assert live.refusal(late).cause is Cause.LOST
    assert live.reading(late) is None and live.predictor(late) is None
    live.count_publishers(2, now)
    assert losses[-1] == live.refusal(now) == Refusal(Cause.TWO_PUBLISHERS)
    assert live.reading(now) is live.predictor(now) is live.stiffness(0.1, now) is None
    live.count_publishers(1, now)
    assert live.reading(now) is not None


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"status": Status.NO_CONTACT}, Cause.NO_CONTACT),
        ({"status": Status.CONVERGING}, Cause.NOT_CONVERGED),
        ({"status": Status.STALE}, Cause.STALE),
        ({"status": Status.UNKNOWN}, Cause.UNKNOWN),
        ({"flags": Flag.GAP}, Cause.REJECTED),
        ({"flags": Flag.MODEL_MISMATCH}, Cause.REJECTED),
        ({"flags": Flag.TISSUE_CHANGED}, Cause.REJECTED),
        ({"flags": Flag.INPUT_REJECTED}, None),
    ],
)
def test_what_cannot_be_relied_on_is_refused_with_its_cause_and_flags(press, change, cause):
    losses: list[Refusal] = []
    live, _ = press.heard_until(3.2, on_loss=losses.append)
    losses.clear()
    stamp_ns = press.last.stamp_ns + 10_000_000
    live.add(replace(press.last, stamp_ns=stamp_ns, **change), stamp_ns / NANOSECONDS)
    refusal = Refusal(cause, change.get("flags", Flag.NONE)) if cause is not None else None
    assert live.refusal(stamp_ns / NANOSECONDS) == refusal
    assert losses == ([refusal] if refusal is not None else [])
    flag = change.get("flags", Flag.NONE)
    assert flag in (Flag.NONE, Flag.INPUT_REJECTED) or str(flag.name) in str(refusal)


def test_stiffness_is_that_of_the_law_where_it_is_known_and_the_measured_slope_where_only_that_is(
    press,
):
    slope = MeasuredSlope(100.0, 5.0, 0.004, 0)
    by_slope, nothing = (100.0, 5.0, 0.004), None
    for flags, deviation, measured, expected in (
        (Flag.NONE, 0.1, slope, "law"),
        (Flag.NONE, 0.3, slope, by_slope),
        (Flag.NONE, 0.3, None, nothing),
        (Flag.MODEL_MISMATCH, 0.1, slope, by_slope),
        (Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED, 0.1, slope, nothing),
        (Flag.IMPLAUSIBLE, 0.1, slope, nothing),
    ):
        live, now = press.heard_until(3.2)
        then = now + 0.01
        known = press.last.apparent_stiffness
        known = replace(known, sd=deviation * known.value)
        state = replace(
            press.last,
            stamp_ns=round(then * NANOSECONDS),
            flags=flags,
            apparent_stiffness=known,
            measured=Slopes(measured),
        )
        live.add(state, then)
        assert live.predictor(then) is None or not flags
        if expected == "law":
            ratio = (0.5 / known.time_scale) ** -press.last.estimate.fractional_order
            expected = (ratio * known.value, ratio * known.sd, None)
        assert live.stiffness(0.5, then) == expected


def test_an_estimate_that_the_node_published_late_is_refused_and_remembered(press):
    """By the deadline of the node, or that of the feed; what was pressed meanwhile is known."""
    live, now = press.heard_until(3.2)
    later = [s for s in press.states if s.stamp_ns > (now + 0.001) * NANOSECONDS][:3]
    for lag, deadline in ((0.3, 0.1), (0.3, 1.0)):
        state = late(replace(later[0], lag=lag), deadline)
        assert (state.status is Status.LATE) == (lag > deadline) == (not state.estimate.known)
        live.add(replace(state, stamp_ns=later[0].stamp_ns), later[0].stamp_ns / NANOSECONDS)
        assert live.refusal(later[0].stamp_ns / NANOSECONDS).cause is Cause.LATE
        assert live.reading(later[0].stamp_ns / NANOSECONDS) is None
    live.add(later[1], later[1].stamp_ns / NANOSECONDS)
    reading = live.reading(later[1].stamp_ns / NANOSECONDS)
    assert reading is not None
    assert live.predictor(later[1].stamp_ns / NANOSECONDS) is not None


def is_refused(feed: LiveTissue, cause: Cause) -> bool:
    refusal = feed.refusal()
    return refusal is not None and refusal.cause is cause


#: Nothing is lost because the machine does something else.
LONG_DEADLINE = 1.0


def touch(command: Any, feed: TissueFeed, states: list[TissueState], x: float = 0.0) -> None:
    """Touch a place anew and wait until there is an estimate to rely on."""
    command.publish(JointState(name=["x", "z"], position=[x, -0.004]))
    wait_for(lambda: is_refused(feed, Cause.NO_CONTACT), "the air")
    # Data that began in contact want the air for `site.timeout`, 2 s, and the probe has to leave.
    known_ns = states[-1].stamp_ns + 3 * NANOSECONDS
    wait_for(lambda: states[-1].stamp_ns > known_ns, "the air's noise to be known")
    command.publish(JointState(name=["z"], position=[0.006]))
    wait_for(lambda: feed.reading(), "an estimate to rely on")


def test_a_frozen_killed_and_restarted_node_is_noticed(simulator):
    losses: list[Refusal] = []
    states: list[TissueState] = []
    with (
        Ears() as ears,
        TissueFeed.standalone(
            deadline=LONG_DEADLINE,
            parameters=PARAMETERS,
            on_loss=losses.append,
            on_state=states.append,
        ) as feed,
    ):
        command = ears.node.create_publisher(JointState, "/command", 10)
        ears.wait_for(command.get_subscription_count, "the simulator")
        assert feed.refusal().cause is Cause.NEVER_HEARD

        def lose_by(act: Any) -> None:
            losses.clear()
            act()
            wait_for(lambda: is_refused(feed, Cause.LOST), "the loss")
            assert feed.reading() is None
            wait_for(lambda: Cause.LOST in [one.cause for one in losses], "the callback")

        with node_process("identifier", IDENTIFIER, file=PARAMETERS) as node:
            touch(command, feed, states)
            assert feed.restarts == 0
            stiffness = wait_for(lambda: feed.stiffness(0.1), "the stiffness")
            assert 3.0 < stiffness[0] < 500.0
            prediction = wait_for(
                lambda: feed.predict_force([0.1, 0.2], [0.0005, 0.001]), "a prediction"
            )
            assert 0.0 < prediction.value[0] < prediction.value[1]
            lose_by(lambda: os.kill(node.pid, signal.SIGSTOP))
            os.kill(node.pid, signal.SIGCONT)
            wait_for(lambda: not is_refused(feed, Cause.LOST), "the node to go on")
            # Another place: of the first a part of the contact may not have been seen.
            touch(command, feed, states, x=0.02)
            lose_by(node.kill)
        with node_process("identifier", IDENTIFIER, file=PARAMETERS):
            wait_for(lambda: feed.restarts == 1, "the restart to be noticed")
