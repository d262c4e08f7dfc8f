# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The identifier node in its own process, over real DDS."""

from __future__ import annotations

from pathlib import Path

import pytest
from fden_msgs.msg import TissueEstimate
from lifecycle_msgs.msg import Transition
from rcl_interfaces.srv import DescribeParameters
from ros_helpers import Bench, Live, active, assert_live_equals_replay, stamp
from std_srvs.srv import Trigger

from fden_ros.core.outputs import Classification, ContactSummary, DynamicModulus, TissueState
from fden_ros.parameters import PARAMETERS
from fden_ros.recording.reader import BagReader
from simulation.bag import write_recording
from simulation.scenario import load_scenario
from simulation.simulate import simulate

GOLDEN = Path(__file__).parent.parent / "bags" / "golden"


def inputs_of(bag: Path) -> dict[str, str]:
    """Force and displacement of a bag, by name, on the topics of the node."""
    names = [topic.name for topic in BagReader(bag).topics]
    force = next(n for n in names if n.endswith(("force", "wrench")))
    return {
        force: "/force",
        next(n for n in names if n != force and "truth" not in n): "/displacement",
    }


def continuous(bag: Path) -> Path:
    """A probe that stays on the tissue; 60 mm in 40 s."""
    write_recording(simulate(load_scenario("continuous")), bag)
    return bag


@pytest.mark.parametrize(
    ("made", "kinds"),
    [
        ("golden_pose", (TissueState, Classification, ContactSummary)),
        (continuous, (TissueState, ContactSummary, DynamicModulus)),
    ],
)
def test_live_equals_replay_bit_for_bit(made, kinds, tmp_path):
    bag = GOLDEN / made if isinstance(made, str) else made(tmp_path / "bag")
    remap = inputs_of(bag)
    assert_live_equals_replay(bag, kinds, remap=remap)


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
