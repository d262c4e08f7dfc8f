# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The pipeline as a whole: the life of contacts and sites, gaps, resets, and the order of outputs.

The truth comes from the simulation, which shares nothing with the core. Faults of the input are in
``test_faults.py``.
"""

from __future__ import annotations

import functools
import itertools
import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fault_helpers import TISSUE, Outcome, Shift, is_wrong, outcome_of, shift_of
from pipeline_helpers import Item, begun, items_of, parameters_of

from benchmark.trial import fed
from fden_ros.core.outputs import (
    Classification,
    ContactSummary,
    Flag,
    Phase,
    Status,
    TissueState,
)
from fden_ros.core.pipeline import Pipeline
from simulation.scenario import DisplacementSensor, Site, Tissue, ramp_scenario
from simulation.simulate import simulate
from simulation.trajectory import Approach, Palpation, RampHold, Trajectory

SECOND = 1_000_000_000
RATE = 250.0
FIRM = RampHold(0.3, 0.26, 0.3)
#: Three presses of one place, 0.9 s apart: sooner than `site.timeout`.
THREE = (Palpation(0.3, 0.26, 0.3, presses=3, lift_m=0.002, pause_s=0.3),)
#: A release is seen after two chunks of 20 ms and one sample at most; a summary comes within this
#: time after it, unless samples end before [ns].
RELEASE_NS, SUMMARY_NS = 64_000_000, 600_000_000
#: Block by which the first grids of a contact are laid.
SOLVED = 20


def at(data: Shift, number: int, share: float) -> int:
    """Stamp at this share of a contact's duration; below 0 or above 1: in the air by it."""
    start, end = (data.contacts[number][key] for key in ("start_ns", "end_ns"))
    return int(start + share * (end - start))


def between(data: Shift, begin: float, end: float) -> list[Item]:
    return [item for item in data.items if begin <= item.stamp_ns < end]


@functools.cache
def presses(
    kinds: tuple[Trajectory, ...] = THREE, sites: int = 1, message: str = "joint_state"
) -> Shift:
    """Return presses of one place, or one of each site, half a second apart."""
    return shift_of(
        simulate(
            replace(
                ramp_scenario(rate_hz=RATE, seed=3),
                approach=Approach(distance_m=0.004, start_pause_s=1.0, site_pause_s=0.5),
                sites=tuple(Site(TISSUE, kinds, (0.02 * k, 0.0)) for k in range(sites)),
                displacement=DisplacementSensor(rate_hz=RATE, message=message, noise_m=1e-6),
            )
        )
    )


def outcome(data: Shift, items: Sequence[Any] | None = None, **parameters: object) -> Outcome:
    own = {name.replace("__", "."): value for name, value in parameters.items()}
    return outcome_of(data.items if items is None else items, data.parameters | own)


def sd_of(output: Any) -> float:
    return math.sqrt(output.estimate.covariance[1, 1])


def states_in(result: Outcome, contact_id: int) -> list[TissueState]:
    """States from one contact, without those in the air after it."""
    own = [state for state in result.states if state.contact_id == contact_id]
    return [state for state in own if state.phase is not Phase.APPROACH]


def ids(outputs: Sequence[Any]) -> list[tuple[int, int]]:
    return [(output.site_id, output.contact_id) for output in outputs]


@functools.cache
def undisturbed() -> Outcome:
    """What is made of three presses of one place."""
    return outcome(presses())


def test_each_contact_of_a_site_adds_to_what_the_ones_before_have_taught() -> None:
    data, result = presses(), undisturbed()
    assert ids(result.summaries)[:2] == [(1, 1), (1, 2)]
    assert all(s.complete and s.converged and not s.flags for s in result.summaries)
    deviations = [sd_of(summary) for summary in result.summaries]
    assert deviations[1] < 0.9 * deviations[0] and deviations[2] < 0.9 * deviations[1]
    assert not any(is_wrong(summary, data.sites[0]) for summary in result.summaries)
    for before, after in itertools.pairwise(result.summaries):
        # A contact begins with what was known at the end of the one before.
        first = states_in(result, after.contact_id)[0]
        assert sd_of(first) == pytest.approx(sd_of(before), rel=0.1)
        # It says so once its own data do.
        assert states_in(result, after.contact_id)[SOLVED].status is Status.CONVERGED


def test_what_was_learned_is_held_in_the_air_after_a_contact() -> None:
    data, result = presses(), undisturbed()
    begin, end = result.summaries[0].stamp_ns + RELEASE_NS, data.contacts[1]["start_ns"]
    held = [state for state in result.states if begin < state.stamp_ns < end]
    before = [state for state in result.states if state.stamp_ns < data.contacts[0]["start_ns"]]
    assert len(held) > 20 and set(ids(held)) == {(1, 1)} and set(ids(before)) == {(0, 0)}
    for state in held:
        assert state.status is Status.NO_CONTACT and state.phase is Phase.APPROACH
        assert state.estimate is not None and state.signals is None and state.innovation is None
    assert all(state.estimate is None for state in before)


def test_the_phases_of_a_press_follow_each_other() -> None:
    own = [state for state in undisturbed().states if state.contact_id == 1]
    phases = [phase for phase, _ in itertools.groupby(state.phase for state in own)]
    assert phases == [Phase.LOADING, Phase.HOLDING, Phase.UNLOADING, Phase.APPROACH]


# Gaps in contact


def with_gap(max_gap: float) -> tuple[Outcome, int]:
    """Leave out 0.2 s of the first of two ramps; return what comes of it, and where it begins."""
    data = presses()
    begin = at(data, 0, 0.4)
    end, third = begin + SECOND // 5, at(data, 2, -0.1)
    items = [*between(data, 0, begin), *between(data, end, third)]
    return outcome(data, items, synchronize__max_gap=max_gap), begin


def test_a_gap_shorter_than_the_greatest_allowed_leaves_contact_and_memory() -> None:
    result, _ = with_gap(0.21)
    assert ids(result.summaries) == [(1, 1), (1, 2)]
    for summary in result.summaries:
        # The memory of the site spans the gap from then on.
        assert summary.complete and summary.converged and summary.flags & Flag.GAP
        assert not is_wrong(summary, presses().sites[0])
    assert sd_of(result.summaries[1]) < 0.9 * sd_of(result.summaries[0])


def test_a_longer_gap_ends_the_contact_and_nothing_is_said_of_its_site_soon_after() -> None:
    result, begin = with_gap(0.19)
    first, later = result.summaries
    assert ids(result.summaries) == [(1, 1), (1, 2)]
    # It ends with the last pair before the gap, and is reported once.
    assert not first.complete and first.flags & Flag.GAP
    assert begin - SECOND / RATE - 1 <= first.end_ns < begin
    assert first.estimate is not None and not is_wrong(first, presses().sites[0])
    # The probe presses on: the states go on, without a number.
    after = [s for s in states_in(result, 1) if s.stamp_ns > first.end_ns]
    assert len(after) > 20
    assert all(s.estimate is None and s.status is Status.UNKNOWN for s in after)
    assert all(s.flags & Flag.GAP and s.signals is not None for s in after)
    # What the tissue remembers of the gap is not known, so a later contact there says nothing.
    assert later.complete and later.flags & Flag.GAP
    assert later.estimate is None and not later.converged and later.classes is None


@pytest.mark.parametrize("kind", ["joint_state", "pose"])
@pytest.mark.parametrize(("rest_s", "is_flagged"), [(3.0, True), (200.0, False)])
def test_a_place_begins_anew_after_a_gap_and_is_flagged_while_tissue_remembers_it(
    rest_s: float, is_flagged: bool, kind: str
) -> None:
    twice = Palpation(0.3, 0.26, 0.3, presses=2, lift_m=0.002, pause_s=rest_s)
    data = presses((twice,), message=kind)
    begin, end = at(data, 0, 0.4), at(data, 0, 1.0)
    # Of a long rest only the ends are fed.
    rested = at(data, 1, 0.0) - 3 * SECOND
    parts = (0, begin), (begin + SECOND // 5, end + SECOND), (max(rested, end + SECOND), math.inf)
    items = [item for part in parts for item in between(data, *part)]
    result = outcome(data, items, synchronize__max_gap=0.19, site__without_position="same")
    first, later = result.summaries
    assert ids(result.summaries) == [(1, 1), (2, 2)]
    assert not first.complete and first.flags & Flag.GAP
    assert later.converged and bool(later.flags & Flag.GAP) == is_flagged
    assert is_flagged or not is_wrong(later, data.sites[0])


def test_a_place_with_a_gap_is_flagged_too_after_a_press_elsewhere() -> None:
    places = (0.0, 0.0), (0.02, 0.0), (0.0, 0.0)
    scenario = ramp_scenario(rate_hz=RATE, seed=3)
    data = shift_of(simulate(replace(
        scenario,
        sites=tuple(Site(TISSUE, (FIRM,), place) for place in places),
        displacement=DisplacementSensor(rate_hz=RATE, message="pose", noise_m=1e-6),
    )))  # fmt: skip
    begin = at(data, 0, 0.4)
    items = [*between(data, 0, begin), *between(data, begin + SECOND // 5, math.inf)]
    *_, elsewhere, again = outcome(data, items, synchronize__max_gap=0.19).summaries
    assert ids([elsewhere, again]) == [(2, 2), (3, 3)]
    assert not elsewhere.flags and again.flags == Flag.GAP and again.converged


# Faint contacts


@pytest.mark.parametrize(("strain", "site_id"), [(0.018, 2), (0.05, 1)])
def test_a_first_contact_fainter_than_four_release_thresholds_makes_no_site(
    strain: float, site_id: int
) -> None:
    data = presses((RampHold(0.3, strain, 0.2), FIRM))
    result = outcome(data)
    first, second = result.summaries
    assert first.complete and first.contact_id == 1
    assert ids([second]) == [(site_id, 2)]
    assert second.converged and not is_wrong(second, data.sites[0])
    begin, end = at(data, 0, 1.0) + RELEASE_NS, at(data, 1, 0.0)
    in_between = [state for state in result.states if begin < state.stamp_ns < end]
    assert set(ids(in_between)) == ({(0, 0)} if site_id == 2 else {(1, 1)})


def test_a_force_that_relaxes_while_the_probe_holds_is_no_release() -> None:
    """It falls to a tenth, below half of the threshold; then the probe lifts."""
    press = {"strain_rate": 0.5, "max_strain": 0.1, "hold_s": 20.0, "rate_hz": 50.0}
    recording = simulate(ramp_scenario(tissue=Tissue(5000.0, 8.0, 0.5), **press))
    threshold = {"force.threshold": 0.4 * float(recording.force.value.max())}
    (contact,) = outcome_of(items_of(recording), parameters_of(recording) | threshold).summaries
    (truth,) = recording.truth["contacts"]
    assert contact.end_ns > truth["end_ns"] - SECOND


# Resets: what makes the pipeline forget, and what goes on


def two_sites(message: str = "joint_state") -> Shift:
    """One press each; without positions they look like one."""
    return presses((FIRM,), sites=2, message=message)


def clock_back(data: Shift) -> list[Item]:
    stamp_ns = at(data, 0, 1.0) + SECOND // 4
    return [
        item._replace(stamp_ns=item.stamp_ns - 100 * SECOND) if item.stamp_ns >= stamp_ns else item
        for item in data.items
    ]


FORGETTING: dict[str, Callable[[], Outcome]] = {
    "clock_back": lambda: outcome(two_sites(), clock_back(two_sites())),
    "timeout": lambda: outcome(two_sites(), site__timeout=0.5, site__without_position="other"),
    "moved": lambda: outcome(two_sites("pose")),
}


@pytest.mark.parametrize("name", FORGETTING)
def test_nothing_that_was_learned_passes_to_another_site_or_time(name: str) -> None:
    result = FORGETTING[name]()
    first, second = (states_in(result, contact_id)[SOLVED] for contact_id in (1, 2))
    assert sd_of(second) == pytest.approx(sd_of(first), rel=0.1)
    assert first.status is second.status is Status.CONVERGING
    assert ids(result.summaries) == [(1, 1), (2, 2)]
    assert all(s.complete and s.converged and not s.flags for s in result.summaries)
    assert not any(is_wrong(summary, two_sites().sites[0]) for summary in result.summaries)
    assert result.pipeline.contact_count == result.pipeline.site_count == 2
    jumped = [words for words in result.pipeline.warnings if "clock jumped back" in words]
    assert len(jumped) == (name == "clock_back")


def test_after_a_reset_everything_is_as_in_a_new_pipeline_but_ids_and_counts() -> None:
    data = presses()
    stamp_ns, end = at(data, 0, 1.0) + SECOND // 4, at(data, 2, -0.1)
    spoiled = data.items[20]._replace(value=math.nan)
    early, late = between(data, 0, stamp_ns), between(data, stamp_ns, end)
    before, fresh = outcome(data, early), outcome(data, late)
    result = outcome(data, [*early[:20], spoiled, *early[20:], Pipeline.reset, *late])
    after = [output for output in result.outputs if output.stamp_ns >= stamp_ns]
    bare = [
        [pickle.dumps(replace(output, site_id=0, contact_id=0)) for output in outputs]
        for outputs in (after, fresh.outputs)
    ]
    assert bare[0] == bare[1]
    assert ids(result.summaries) == [(1, 1), (2, 2)]
    assert ids(fresh.summaries) == [(1, 1)]
    assert result.pipeline.pair_count == before.pipeline.pair_count + fresh.pipeline.pair_count
    assert result.pipeline.rejected.total() == 1 and not fresh.pipeline.rejected


# Order of outputs, and counts


def test_outputs_come_in_the_order_of_their_stamps_each_label_and_summary_after_its_state() -> (
    None
):
    outputs = undisturbed().outputs
    open_contact = 0
    for before, output in itertools.pairwise(outputs):
        if isinstance(output, TissueState):
            assert output.stamp_ns > before.stamp_ns - isinstance(before, ContactSummary)
        elif isinstance(output, Classification):
            # A label follows the state that it was made from.
            assert isinstance(before, TissueState) and before.stamp_ns == output.stamp_ns
            assert ids([before]) == ids([output])
            assert output.contact_id == open_contact + 1
        else:
            assert isinstance(output, ContactSummary)
            assert output.contact_id == open_contact + 1
            open_contact = output.contact_id
            # The end is where the force was gone, before that was certain.
            assert output.stamp_ns - SUMMARY_NS < output.end_ns <= before.stamp_ns
            assert output.stamp_ns > output.end_ns > output.start_ns
    assert open_contact == 3
    assert ids(outputs) == sorted(ids(outputs))


def test_a_tare_takes_the_force_in_the_air_away() -> None:
    probe = {"geometry.area": 1e-4, "geometry.thickness": 0.02}
    pipeline, _ = begun(probe | {"force.measure_bias": False, "force.threshold": 0.1})
    noise = np.random.default_rng(0).normal(0.0, 1e-3, 250)

    def goes_on(begin: float, force: float) -> bool:
        times = begin + np.arange(250) / 250.0
        for _ in fed(pipeline, times, force + noise, 0.002 * times - 0.01 + 1e-3 * noise):
            pass
        return pipeline.in_contact

    assert not goes_on(0.0, 0.08) and pipeline.tare() is None
    assert not goes_on(1.0, 0.14)
    assert goes_on(2.0, 0.25)
