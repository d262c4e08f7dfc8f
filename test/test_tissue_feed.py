# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a controller is told: of states directly, and of a live identifier that freezes or dies."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from live_helpers import PARAMETERS, Ears, node_process
from property_helpers import counts
from ros_helpers import wait_for
from sensor_msgs.msg import JointState

from fden_ros.control.live_tissue import LiveTissue, Reading, Refusal
from fden_ros.core.law.geometry import FlatPunch
from fden_ros.core.outputs import Flag, Status, TissueState, stale
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.model import FdenModel
from fden_ros.simulation.rig import Command, Rig, RigConfig
from fden_ros.simulation.tissue import Column
from fden_ros.tissue_feed import TissueFeed
from simulation.simulate import EXACT

AREA, THICKNESS = 3.1416e-4, 0.02
GEOMETRY = FlatPunch(AREA, THICKNESS)
DEADLINE = 0.1


class Press:
    """A press with everything recorded, and the states that the pipeline made of it."""

    def __init__(self, model: FdenModel, seed: int, after: float, seconds: float = 4.2) -> None:
        rig = Rig(RigConfig((Column(model),), seed=seed))
        self.states: list[TissueState] = []
        pipeline = Pipeline(
            pipeline_config(
                check({**EXACT, "geometry.area": AREA, "geometry.thickness": THICKNESS})
            ),
            lambda out: self.states.append(out) if isinstance(out, TissueState) else None,
        )
        kept = []
        for n in range(int(seconds / rig.config.step)):
            if n % 50 == 0:
                rig.command(Command.VELOCITY, self._velocity(rig, after))
            rig.step()
            kept.append((rig.time, rig.force, rig.depth))
            if n % 4 == 0:
                stamp_ns = round(rig.time * NANOSECONDS) + NANOSECONDS
                pipeline.add_displacement(stamp_ns, rig.measured_position()[2])
                pipeline.add_force(stamp_ns, rig.measured_force())
        self.times, self.force, self.depth = np.array(kept).T

    @staticmethod
    def _velocity(rig: Rig, after: float) -> float:
        if rig.time < 1.5 or (rig.depth > 0.004 and rig.time < 3.0):
            return 0.0
        return 0.005 if rig.time < 3.0 else after

    def heard_until(self, seconds: float, **options: Any) -> tuple[LiveTissue, float]:
        """Return who heard the states so far, and the time of the last."""
        live = LiveTissue(GEOMETRY, **options)
        now = 0.0
        for state in self.states:
            if state.stamp_ns <= (seconds + 1.0) * NANOSECONDS:
                now = state.stamp_ns / NANOSECONDS
                live.add(state, now)
        return live, now


LIVER = FdenModel(544.8, 8.547, 0.131)


@pytest.fixture(scope="module")
def press() -> Press:
    return Press(LIVER, seed=1, after=0.002)


@pytest.mark.parametrize("seeds", counts(3, 8))
def test_predictions_hold_the_truth_in_their_intervals_on_random_tissue(seeds):
    """Two deviations hold 95 % if the model's linearisation is right; asked for are 85 %."""
    generator = np.random.default_rng(7)
    inside, errors = [], []
    for seed in range(seeds):
        g, gn, order = np.array([520.0, 8.4, 0.131]) * np.exp(
            np.array([0.25, 0.15, 0.08]) * generator.standard_normal(3)
        )
        run = Press(FdenModel(g, gn, order), seed, after=(0.002, 0.004, -0.002, 0.0)[seed % 4])
        live, now = run.heard_until(3.0)
        # The estimate stands for the middle of its block.
        start = now - 1.0 - 0.005
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


def test_an_estimate_is_refused_once_it_is_older_than_the_deadline(press):
    live, now = press.heard_until(3.0)
    reading = live.reading(now + 0.9 * DEADLINE)
    assert reading is not None and reading.age == pytest.approx(0.9 * DEADLINE, abs=0.01)
    late = now + 1.01 * DEADLINE
    assert live.refusal(late) is Refusal.LOST
    assert live.reading(late) is None and live.predictor(late) is None


def test_an_identifier_without_input_is_lost_only_when_it_no_longer_says_so(press):
    """It says so once a second: after a bag has ended nothing is frozen, killed or unreachable."""
    live, now = press.heard_until(3.0)
    live.add(stale(press.states[-1]), now)
    live.miss(now + 1.01 * DEADLINE)
    assert live.refusal(now + 2.0) is Refusal.STALE
    assert live.refusal(now + 3.1) is Refusal.LOST
    live.lose(now + 0.2)
    assert live.refusal(now + 0.2) is Refusal.LOST
    live, now = press.heard_until(3.0)
    live.miss(now + 0.9 * DEADLINE)
    assert live.refusal(now + 0.9 * DEADLINE) is Refusal.LOST


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"status": Status.NO_CONTACT}, Refusal.NO_CONTACT),
        ({"status": Status.CONVERGING}, Refusal.NOT_CONVERGED),
        ({"status": Status.STALE}, Refusal.STALE),
        ({"status": Status.UNKNOWN}, Refusal.UNKNOWN),
        ({"flags": Flag.GAP}, Refusal.REJECTED),
        ({"flags": Flag.MODEL_MISMATCH}, Refusal.REJECTED),
        ({"flags": Flag.TISSUE_CHANGED}, Refusal.REJECTED),
        ({"flags": Flag.INPUT_REJECTED}, None),
    ],
)
def test_what_cannot_be_relied_on_is_refused_with_its_reason(press, change, refusal):
    losses: list[Refusal] = []
    live, now = press.heard_until(3.0, on_loss=losses.append)
    losses.clear()
    last = next(s for s in reversed(press.states) if s.stamp_ns <= (now + 1e-9) * NANOSECONDS)
    stamp_ns = last.stamp_ns + 10_000_000
    live.add(replace(last, stamp_ns=stamp_ns, **change), stamp_ns / NANOSECONDS)
    assert live.refusal(stamp_ns / NANOSECONDS) is refusal
    assert losses == ([refusal] if refusal is not None else [])


def test_an_estimate_that_was_held_up_on_its_way_is_refused(press):
    live, now = press.heard_until(3.0)
    later = [s for s in press.states if s.stamp_ns > (now + 0.001) * NANOSECONDS]
    live.add(later[0], later[0].stamp_ns / NANOSECONDS + 0.5)
    assert live.refusal(later[0].stamp_ns / NANOSECONDS + 0.5) is Refusal.LATE
    live.add(later[1], later[1].stamp_ns / NANOSECONDS)
    assert live.refusal(later[1].stamp_ns / NANOSECONDS) is None


def test_a_converged_estimate_that_is_contradicted_is_refused(press):
    live, now = press.heard_until(3.0)
    last = next(s for s in reversed(press.states) if s.stamp_ns <= (now + 1e-9) * NANOSECONDS)
    assert last.innovation is not None and last.innovation.predicted_stress is not None
    wrong = last.innovation._replace(
        innovation=0.5 * last.innovation.predicted_stress, variance=1.0
    )
    for n in range(1, 4):
        assert live.refusal(now) is None
        stamp_ns = last.stamp_ns + n * 10_000_000
        now = stamp_ns / NANOSECONDS
        live.add(replace(last, stamp_ns=stamp_ns, innovation=wrong), now)
    assert live.refusal(now) is Refusal.CONTRADICTED


def test_a_slow_sensor_leaves_no_gap_and_an_estimate_that_was_not_heard_does(press):
    every_100_ms = press.states[::10]
    touched = next(n for n, state in enumerate(every_100_ms) if state.contact_id)
    for missed, is_known in ((None, True), (touched + 5, False)):
        live, now = LiveTissue(GEOMETRY, deadline=1.0), 0.0
        for n, state in enumerate(every_100_ms):
            if n != missed and state.stamp_ns <= 4.0 * NANOSECONDS:
                now = state.stamp_ns / NANOSECONDS
                live.add(state, now)
        assert live.refusal(now) is None
        assert (live.predictor(now) is not None) == is_known


# Over DDS

#: What a machine that runs every other test beside it can keep pace with.
SLOW_RIG = {"axis.max_speed": 0.01, "force.rate": 100.0, "displacement.rate": 100.0}
SLOW_IDENTIFIER = {"autostart": True, "estimate.period": 0.02}


#: Nothing is lost because the machine does something else.
LONG_DEADLINE = 1.0


def touch(command: Any, feed: TissueFeed, states: list[TissueState]) -> None:
    """Touch anew and wait until there is an estimate to rely on."""
    command.publish(JointState(name=["z"], position=[-0.004]))
    wait_for(lambda: feed.refusal() is Refusal.NO_CONTACT, "the air")
    # Data that began in contact want the air for `site.timeout`, 2 s, and the probe has to leave.
    known_ns = states[-1].stamp_ns + 3 * NANOSECONDS
    wait_for(lambda: states[-1].stamp_ns > known_ns, "the air's noise to be known")
    command.publish(JointState(name=["z"], position=[0.006]))
    wait_for(lambda: feed.reading(), "an estimate to rely on")


def test_a_frozen_killed_and_restarted_node_is_noticed():
    losses: list[Refusal] = []
    changes: list[Reading] = []
    states: list[TissueState] = []
    with (
        Ears() as ears,
        node_process("tissue_simulator", SLOW_RIG, file=PARAMETERS),
        TissueFeed.standalone(
            deadline=LONG_DEADLINE,
            parameters=PARAMETERS,
            on_loss=losses.append,
            on_change=changes.append,
            on_state=states.append,
        ) as feed,
    ):
        command = ears.node.create_publisher(JointState, "/command", 10)
        ears.wait_for(command.get_subscription_count, "the simulator")
        assert feed.refusal() is Refusal.NEVER_HEARD

        def lose_by(act: Any) -> None:
            losses.clear()
            act()
            wait_for(lambda: feed.refusal() is Refusal.LOST, "the loss")
            assert feed.reading() is None
            wait_for(lambda: Refusal.LOST in losses, "the callback")

        with node_process("identifier", SLOW_IDENTIFIER, file=PARAMETERS) as node:
            touch(command, feed, states)
            wait_for(lambda: changes, "the callback")
            assert feed.restarts == 0
            stiffness = wait_for(lambda: feed.stiffness(0.1), "the stiffness")
            assert 3.0 < stiffness[0] < 500.0
            prediction = wait_for(
                lambda: feed.predict_force([0.1, 0.2], [0.0005, 0.001]), "a prediction"
            )
            assert 0.0 < prediction.value[0] < prediction.value[1]
            lose_by(lambda: os.kill(node.pid, signal.SIGSTOP))
            os.kill(node.pid, signal.SIGCONT)
            wait_for(lambda: feed.refusal() is not Refusal.LOST, "the node to go on")
            touch(command, feed, states)
            lose_by(node.kill)
        with node_process("identifier", SLOW_IDENTIFIER, file=PARAMETERS):
            wait_for(lambda: feed.restarts == 1, "the restart to be noticed")
