# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that stays on the tissue: stiffness and alpha along its path, and what is not known.

The truth is the closed-form answer of a fractional element to a sine about a slow motion, with a
surface, a force zero and a rig of its own; it shares nothing with the core.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from pipeline_helpers import begun
from property_helpers import counts, first

from fden_ros.core import ContactSummary, DynamicModulus, Flag, Status, TissueState
from fden_ros.core.estimation import NOTHING_UNKNOWN, EstimatorConfig, Prior
from fden_ros.core.oscillation import Stiffness
from fden_ros.core.oscillation.local_stiffness import LocalStiffness
from fden_ros.core.oscillation.palpation import palpated as told_by

START_NS = 5_000_000_000
TIME_SCALE = 0.1
SOURCES = ("delay", "compliance", "backlash")
RIGID = {f"displacement.{name}_sd": 0.0 for name in SOURCES}
RIGID |= {"force.friction_sd": 0.0, "model_discrepancy.sd": 0.0}


@dataclass(frozen=True)
class Palpated:
    """One record and its truth."""

    time: np.ndarray  #: [s]
    displacement: np.ndarray  #: as read [m]
    force: np.ndarray  #: [N]
    way: np.ndarray  #: sideways [m]
    stiffness: np.ndarray  #: |k| [N/m]
    order: float
    angular_frequency: float  #: [rad/s]

    def apparent(self, way: float) -> float:
        """dF/dd after `TIME_SCALE` at a place [N/m]."""
        size = float(np.interp(way, self.way, self.stiffness))
        relaxed = (self.angular_frequency * TIME_SCALE) ** -self.order
        return size * relaxed / math.gamma(1.0 - self.order)


def palpated(
    seed: int,
    profile: str = "constant",
    *,
    is_rigid: bool = False,
    duration: float = 40.0,
    frequency: float = 1.5,
    amplitude: float = 1e-3,
    delay: float = 0.0,
) -> Palpated:
    """Palpate while sliding at 3 mm/s, sampled at 100 Hz with jitter."""
    rng = np.random.default_rng(seed)
    n = int(100 * duration)
    step = (1.0 + 0.05 * rng.uniform(-1.0, 1.0, n)) / 100.0
    t = np.cumsum(step)
    order = rng.uniform(0.05, 0.3)
    omega = 2.0 * math.pi * frequency * (1.0 + 0.01 * rng.normal())
    stiffness = {
        "constant": np.full(n, 400.0),
        "smooth": 400.0 * np.exp(0.35 * np.sin(2.0 * math.pi * t / 20.0 + rng.uniform(0.0, 6.0))),
        "edge": np.where((t > 0.4 * duration) & (t < 0.75 * duration), 800.0, 400.0),
        "air": np.zeros(n),
    }[profile]
    angle = omega * t + rng.uniform(0.0, 6.0)
    size = amplitude * (1.0 + 0.1 * np.sin(0.3 * t + rng.uniform(0.0, 6.0)))
    slow = 3e-3 + 5e-4 * np.sin(0.25 * t + rng.uniform(0.0, 6.0))
    walk = np.cumsum(rng.normal(size=(2, n)) * np.sqrt(step), axis=1)
    surface, zero = 2e-4 * walk[0], 0.3 + 5e-3 * walk[1]
    # The sine, a second harmonic as nonlinear tissue gives it, and the slow motion, which relaxes.
    force = stiffness * size * np.cos(angle + 0.5 * math.pi * order)
    force += 0.1 * stiffness * size * np.cos(2.0 * angle + 0.3)
    force += (
        stiffness * omega**-order / math.gamma(1 - order) * (t + 1) ** -order * (slow - surface)
    )
    force += zero + 0.01 * rng.normal(size=n)
    displacement = slow + size * np.cos(angle)
    if not is_rigid:
        force += 0.007 * rng.normal() * np.sign(-np.sin(angle))
        displacement = displacement + 1.5e-4 * rng.normal() * force
        delay += 0.0025 * rng.normal()
    displacement = np.interp(t - delay, t, displacement) + 5e-6 * rng.normal(size=n)
    return Palpated(t, displacement, force, 3e-3 * t, stiffness, order, omega)


def identify(*records: Palpated, **values):
    """Return the pipeline after records that follow each other, and its outputs."""
    pipeline, outputs = begun({"contact.mode": "continuous"} | values)
    for record in records:
        columns = (record.time, record.force, record.displacement, record.way)
        for t, force, displacement, way in zip(*(c.tolist() for c in columns), strict=True):
            stamp_ns = START_NS + round(1e9 * t)
            pipeline.add_force(stamp_ns, force)
            pipeline.add_displacement(stamp_ns, displacement, (way, 0.0, displacement))
    pipeline.finish()
    return pipeline, outputs


def of(kind, outputs):
    return [output for output in outputs if isinstance(output, kind)]


def known_places(outputs):
    return [one for one in of(ContactSummary, outputs) if one.is_of_path]


def errors(record: Palpated, place: ContactSummary) -> tuple[float, float]:
    """Errors of dF/dd and alpha over their deviations."""
    stiffness, estimate = place.apparent_stiffness, place.estimate
    off = math.log(stiffness.value / record.apparent(place.position[0]))
    alpha = estimate.fractional_order - record.order
    return off * stiffness.value / stiffness.sd, alpha / estimate.fractional_order_sd


#: In pascals only where the probe is stated and its modulus needs no depth.
COLUMN = {"geometry.area": 1e-4, "geometry.thickness": 0.02}
SPHERE = {"geometry.kind": "sphere", "geometry.radius": 0.003}
CONDITIONS = first(
    ("constant", True), ("smooth", True), ("edge", False), ("constant", False), ("edge", True)
)


@pytest.mark.parametrize("seeds", counts(3, 12))
@pytest.mark.parametrize("condition", CONDITIONS, ids=str)
def test_deviations_of_stiffness_alpha_and_complex_modulus_hold_along_the_path(condition, seeds):
    profile, is_rigid = condition
    found = []
    for seed in range(seeds):
        record = palpated(seed, profile, is_rigid=is_rigid)
        outputs = identify(record, **COLUMN, **(RIGID if is_rigid else {}))[1]
        found += [errors(record, place) for place in known_places(outputs)]
        *before, last = (one.modulus for one in of(DynamicModulus, outputs))
        assert len(before) > 10
        if condition == ("constant", True):  # a modulus is that of one window, as it is read
            truth = 400.0 * COLUMN["geometry.thickness"] / COLUMN["geometry.area"]
            assert math.hypot(last.storage, last.loss) == pytest.approx(truth, abs=4.0 * last.sd)
            sd = last.fractional_order_sd
            assert last.fractional_order == pytest.approx(record.order, abs=4.0 * sd)
    assert len(found) > 15 * seeds
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    # The places of one record have errors in common.
    low, high = (0.6, 1.4) if seeds == 12 else (0.3, 2.0)
    assert np.all(rms > low) and np.all(rms < high), rms


def test_alpha_is_the_mean_of_the_prior_and_of_the_phase_weighed_by_their_variances():
    value, sd = 400.0 * np.exp(0.5j * math.pi * 0.3), 20.0
    prior = replace(Prior(), fractional_order=0.1, fractional_order_sd=0.05)
    config = EstimatorConfig(prior, uncertainty=NOTHING_UNKNOWN)
    found = told_by(Stiffness(value, sd**2 * np.eye(2)), 9.0, 1e-3, 0.1, config, 99)
    assert found is not None
    own = (2.0 / math.pi * sd / 400.0) ** 2
    order = (0.3 / own + 0.1 / 0.05**2) / (1.0 / own + 1.0 / 0.05**2)
    assert found.estimate.fractional_order == pytest.approx(order, rel=1e-6)
    assert found.estimate.fractional_order_sd**-2.0 == pytest.approx(
        1.0 / own + 0.05**-2, rel=1e-6
    )


@pytest.mark.parametrize("profile", ["air", "constant"])
def test_what_gives_no_answer_has_no_stiffness(profile):
    amplitude = 1e-3 if profile == "air" else 0.0
    pipeline, outputs = identify(palpated(3, profile, amplitude=amplitude, duration=20.0))
    assert of(TissueState, outputs)
    assert not any(one.apparent_stiffness for one in of(TissueState, outputs))
    assert not known_places(outputs)
    if profile == "constant":
        assert any("no oscillation" in words for words in pipeline.warnings)


@pytest.mark.parametrize("delay", [-0.06, 0.06])
@pytest.mark.parametrize("seed", first(6, 7, 8))
def test_a_force_out_of_step_is_told_and_neither_alpha_nor_stiffness_known(delay, seed):
    """A position that is late by 60 ms makes 0.36 of alpha at 1.5 Hz."""
    pipeline, outputs = identify(palpated(seed, is_rigid=True, delay=delay, duration=25.0))
    places = of(ContactSummary, outputs)[5:]
    assert len(places) > 10 and not any(one.is_of_path for one in places)
    assert all(Flag.AT_PRIOR_LIMIT in one.flags and not one.estimate.observable for one in places)
    assert any("displacement.delay" in words for words in pipeline.warnings)


def test_a_long_gap_ends_the_place_and_forgets_it():
    record = palpated(8, duration=20.0)
    pipeline, outputs = identify(record, replace(record, time=record.time + 25.0), **SPHERE)
    assert not of(DynamicModulus, outputs)
    places, again_ns = of(ContactSummary, outputs), START_NS + 25_000_000_000
    count = sum(one.end_ns < again_ns for one in places)
    last, *after = places[count - 1 :]
    assert not last.complete and after[0].site_id == last.site_id + 1
    assert pipeline.site_count == after[-1].site_id
    since = [one for one in of(TissueState, outputs) if one.stamp_ns > again_ns]
    assert since[0].apparent_stiffness is None and since[-1].apparent_stiffness is not None


def test_a_failure_ends_one_place_and_the_next_is_identified(monkeypatch):
    add, calls = LocalStiffness.add, []

    def fail_once(self, *values):
        calls.append(values)
        if len(calls) == 8:
            raise ZeroDivisionError("of a test")
        add(self, *values)

    monkeypatch.setattr(LocalStiffness, "add", fail_once)
    pipeline, outputs = identify(palpated(12))
    assert not of(DynamicModulus, outputs)
    failed = [one for one in of(ContactSummary, outputs) if Flag.ESTIMATION_FAILED in one.flags]
    assert len(failed) == 1 and not failed[0].complete
    assert [one.site_id for one in pipeline.failures] == [failed[0].site_id]
    assert not pipeline.is_failed
    assert len([one for one in known_places(outputs) if one.site_id > failed[0].site_id]) > 10


@pytest.mark.parametrize("seed", first(4, 5, 6, 7))
def test_the_default_mode_claims_nothing_of_a_probe_that_taps_as_it_slides(seed):
    """It begins in contact, and is free of the tissue for a fifth of each period."""
    record = palpated(seed, "constant", frequency=1.0, duration=20.0)
    depth = record.displacement - np.quantile(record.displacement, 0.2)
    noise = np.random.default_rng(seed).normal(size=depth.size)
    force = 400.0 * np.maximum(depth, 0.0) + 0.005 * noise
    pressed = slice(int(np.argmax(depth > 1e-3)), None)
    own = {"time": record.time, "displacement": record.displacement, "way": record.way}
    own = {name: column[pressed] for name, column in own.items()}
    tapping = replace(record, force=force[pressed], **own)
    _, outputs = identify(tapping, **{"contact.mode": "touch", **SPHERE})
    contacts = of(ContactSummary, outputs)
    assert len(contacts) > 10
    assert all(one.flags and not one.converged for one in contacts)
    states = of(TissueState, outputs)
    assert not [one for one in states if one.status is Status.CONVERGED and not one.flags]
