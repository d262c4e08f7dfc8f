# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From a scenario to the sensors' recordings, with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.simulation import FdenModel, FloatArray
from simulation.closed_form import Move, SineMove, motion_of
from simulation.contact import ContactHistory, contacts_of_moves
from simulation.disturbance import (
    Disturbances,
    Phases,
    SteppedHistory,
    quantised,
    stepped_contacts_of_moves,
)
from simulation.scenario import (
    DisplacementSensor,
    Dropout,
    ForceSensor,
    Geometry,
    Preload,
    Scenario,
    Site,
)
from simulation.trajectory import Approach, Path

StampArray = NDArray[np.int64]

START_NS = 1_700_000_000 * 10**9
"""Stamp of the beginning of every recording, so that bags are reproducible."""

END_PAUSE_S = 0.5
_MAX_JITTER_PERIODS = 0.45

# One generator a purpose: the draws of one never change the others.
_TISSUE_DRAWS, _FORCE_DRAWS, _DISPLACEMENT_DRAWS, _PHASE_DRAWS = range(4)


@dataclass(frozen=True)
class Stream:
    """The samples of one sensor, in the order of their stamps."""

    stamp_ns: StampArray  #: Header stamps in ns, shape (n,), strictly increasing
    #: Force in N, positive when pressing, or displacement in m along the axis into the tissue,
    #: shape (n,)
    value: FloatArray
    #: Tip of the probe in m, shape (n, 3), with ``position @ axis == value``; None where the
    #: message has no room for it
    position: FloatArray | None
    sensor: ForceSensor | DisplacementSensor  #: Of the scenario


@dataclass(frozen=True)
class Recording:
    """The streams and the truth behind them, which is ready for JSON."""

    force: Stream
    displacement: Stream
    truth: dict[str, Any]

    @property
    def streams(self) -> tuple[Stream, ...]:
        """All streams."""
        return self.force, self.displacement


@dataclass(frozen=True)
class _Visit:
    """One site: when it was met, the moves there (times since `start`) and the contacts."""

    site: Site
    start: float
    stop: float
    moves: tuple[Move, ...]
    contacts: ContactHistory | SteppedHistory


def simulate(scenario: Scenario, seed: int | None = None) -> Recording:
    """Simulate a scenario; the same scenario and seed, by default its own, give the same bytes."""
    seed = scenario.seed if seed is None else seed
    phases = Phases.draw(_generator(seed, _PHASE_DRAWS))
    visits = _visits(scenario, _generator(seed, _TISSUE_DRAWS), phases)
    force = _force_stream(scenario, visits, _generator(seed, _FORCE_DRAWS), phases)
    displacement = _displacement_stream(scenario, visits, _generator(seed, _DISPLACEMENT_DRAWS))
    return Recording(force, displacement, _truth(scenario, seed, visits))


#: The identifier's parameters for an exact model and rig, as in `config/bench.yaml`:
#: the simulated tissue obeys the law, and the simulated rig is rigid.
EXACT: dict[str, Any] = {
    "model_discrepancy.sd": 0.0,
    "surface.motion_sd": 0.0,
    "force.drift_sd": 0.0,
    "force.friction_sd": 0.0,
    "displacement.compliance_sd": 0.0,
    "displacement.backlash_sd": 0.0,
    "displacement.delay_sd": 0.0,
    "geometry.thickness_sd": 0.0,
    "converged.log_gn_sd": 0.05,
}
#: The same of the rig alone: the law's error keeps its default.
KNOWN_RIG = {name: value for name, value in EXACT.items() if name != "model_discrepancy.sd"}


def identifier_parameters(scenario: Scenario, models: Sequence[FdenModel]) -> dict[str, Any]:
    """Return the identifier's parameters that fit a scenario, by their dotted names."""
    force, displacement = scenario.force, scenario.displacement
    parameters: dict[str, Any] = {
        **scenario.geometry.parameters,
        "force.message": "wrench",
        "force.axis": list(force.axis),
        "displacement.message": displacement.message,
        "displacement.axis": list(displacement.axis),
        "displacement.delay": displacement.delay_s,
    }
    if scenario.disturbances == Disturbances():
        parameters |= EXACT
    if scenario.sites[-1].slide is not None:
        return parameters | {"contact.mode": "continuous"}
    orders = {model.fractional_order for model in models}
    if len(orders) == 1:
        parameters["alpha.learn"] = False
        parameters["prior.alpha"] = orders.pop()
        parameters["prior.alpha_sd"] = 0.0
    return parameters


def _generator(seed: int, purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, purpose])))


def _visits(scenario: Scenario, generator: np.random.Generator, phases: Phases) -> list[_Visit]:
    visits: list[_Visit] = []
    start = 0.0
    for index, site in enumerate(scenario.sites):
        approach = scenario.approach
        path = _path_over(
            site,
            scenario.geometry,
            approach,
            scenario.preload if index == 0 else Preload(),
            approach.site_pause_s if visits else approach.start_pause_s,
        )
        if index == len(scenario.sites) - 1 and site.slide is None:
            path.rest(END_PAUSE_S)
        model = site.tissue.model(generator)
        contacts: ContactHistory | SteppedHistory
        if scenario.disturbances.moves_tissue:
            contacts = stepped_contacts_of_moves(
                path.moves, model, scenario.geometry, scenario.disturbances, phases, start
            )
        else:
            contacts = contacts_of_moves(path.moves, model, site.stiffening)
        visits.append(_Visit(site, start, start + path.time, tuple(path.moves), contacts))
        start += path.time
    return visits


def _path_over(
    site: Site, geometry: Geometry, approach: Approach, preload: Preload, pause_s: float
) -> Path:
    path = Path(-approach.distance_m / geometry.length_m, geometry.length_m)
    if preload.depth_m > 0.0:
        path.floor = geometry.strain_of_depth(preload.depth_m)
        # Not in the recording, which begins at 0.
        path.time = -preload.time_s - (path.floor - path.strain) * path.length_m / (
            approach.speed_m_per_s
        )
        path.go(path.floor, approach.speed_m_per_s / path.length_m)
        path.rest(-path.time)
    path.rest(pause_s)
    for press in site.presses[:-1]:
        press.press(path, approach)
    path.floor = -np.inf
    site.presses[-1].press(path, approach)
    if site.slide is not None:
        del path.moves[1 + path.moves.index(_sine(path.moves)) :]
        path.time = path.moves[-1].stop
    return path


def _sine(moves: Sequence[Move]) -> SineMove:
    """Return the oscillation among the moves of a single sinusoid."""
    return next(move for move in moves if isinstance(move, SineMove))


def _force_stream(
    scenario: Scenario, visits: Sequence[_Visit], generator: np.random.Generator, phases: Phases
) -> Stream:
    sensor, geometry = scenario.force, scenario.geometry
    elapsed_ns, times = _sampling(sensor, visits[-1].stop, generator)
    stress = np.zeros_like(times)
    for visit in visits:
        during = slice(*np.searchsorted(times, [visit.start, visit.stop]))
        stress[during] = visit.contacts.stress(times[during] - visit.start)
        if visit.site.slide is not None:
            sine = _sine(visit.moves)
            since = times[during] - visit.start - sine.start
            gone = np.clip(since / (sine.stop - sine.start), 0, 1)
            stress[during] *= visit.site.slide.stiffness_ratio(gone, visit.site.position_m)
    noise = scenario.force_noise_n * generator.standard_normal(times.size)
    error = sensor.bias_n + sensor.drift_n_per_s * times + noise
    contacts = [
        (visit.start + contact.start, visit.start + contact.stop)
        for visit in visits
        for contact in visit.contacts.contacts
    ]
    velocity = geometry.length_m * _motion(visits, times)[1]
    force = scenario.disturbances.force_reading(
        times, stress * geometry.force_per_stress, error, velocity, contacts, phases
    )
    kept = _kept(elapsed_ns, scenario.dropouts, "force")
    return Stream(START_NS + elapsed_ns[kept], force[kept], None, sensor)


def _displacement_stream(
    scenario: Scenario, visits: Sequence[_Visit], generator: np.random.Generator
) -> Stream:
    sensor, step = scenario.displacement, scenario.disturbances.displacement_step_m
    axis = np.array(sensor.axis)
    elapsed_ns, times = _sampling(sensor, visits[-1].stop, generator)
    along = sensor.surface_m + scenario.geometry.depth_of_strain(_motion(visits, times)[0])
    noise = sensor.noise_m * generator.standard_normal((times.size, 3))
    stamps = elapsed_ns + round(sensor.delay_s * 1e9)
    kept = _kept(stamps, scenario.dropouts, "displacement")
    if sensor.message == "joint_state":
        value, position = quantised(along + noise[:, 2], step)[kept], None
    else:
        across = _lateral(visits, times, axis)
        position = quantised(np.outer(along, axis) + across + noise, step)
        value, position = (position @ axis)[kept], position[kept]
    return Stream(START_NS + stamps[kept], value, position, sensor)


def _sampling(
    sensor: ForceSensor | DisplacementSensor, duration: float, generator: np.random.Generator
) -> tuple[StampArray, FloatArray]:
    """Return when samples are taken, in whole ns and in s since the beginning."""
    count = int(duration * sensor.rate_hz)
    bound = _MAX_JITTER_PERIODS / sensor.rate_hz
    jitter = np.clip(sensor.jitter_s * generator.standard_normal(count), -bound, bound)
    jitter[:1] = np.abs(jitter[:1])
    elapsed_ns = np.rint((np.arange(count) / sensor.rate_hz + jitter) * 1e9).astype(np.int64)
    return elapsed_ns, elapsed_ns.astype(np.float64) * 1e-9


def _kept(elapsed_ns: StampArray, dropouts: Sequence[Dropout], stream: str) -> NDArray[np.bool_]:
    kept = np.ones(elapsed_ns.shape, dtype=bool)
    for dropout in dropouts:
        if dropout.stream == stream or dropout.stream == "both":
            since = elapsed_ns * 1e-9 - dropout.start_s
            kept &= (since < 0.0) | (since >= dropout.duration_s)
    return kept


def _motion(visits: Sequence[_Visit], times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the planned strain at `times` (n,), and its rate [1/s]."""
    strain, rate = np.empty_like(times), np.empty_like(times)
    for visit in visits:
        later = slice(int(np.searchsorted(times, visit.start)), None)
        strain[later], rate[later] = motion_of(visit.moves, times[later] - visit.start)
    return strain, rate


def _lateral(visits: Sequence[_Visit], times: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the sideways part of the tip's position, (n, 3): it moves while the probe waits."""
    knots: list[float] = []
    places: list[tuple[float, float]] = []
    for visit in visits:
        arrival = visit.start + visit.moves[0].stop if knots else visit.start
        knots += [arrival, visit.stop]
        places += [visit.site.position_m] * 2
        if visit.site.slide is not None:
            knots[-1:] = [visit.start + _sine(visit.moves).start, visit.stop]
            places.append(visit.site.slide.to_m)
    across = np.array(places)
    lateral = np.zeros((times.size, 3))
    for coordinate, direction in enumerate(_across(axis)):
        lateral += np.outer(np.interp(times, knots, across[:, coordinate]), direction)
    return lateral


def _across(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two directions across the approach axis: x and y where that is z."""
    start = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = start - (start @ axis) * axis
    first /= np.linalg.norm(first)
    second: FloatArray = np.cross(axis, first).astype(np.float64)
    return first, second if second.sum() >= 0.0 else -second


def _site_truth(number: int, visit: _Visit) -> dict[str, Any]:
    model, site = visit.contacts.model, visit.site
    stiffer = site.stiffening.ratio if site.stiffening else 1.0
    truth = {
        "site": number,
        # At the end of the contact, for a comparison with the estimate.
        "linear_stiffness": model.linear_stiffness * stiffer,
        "nonlinear_stiffness": model.nonlinear_stiffness,
        "fractional_order": model.fractional_order,
        "position": list(site.position_m),
    }
    if site.stiffening is not None:
        truth["stiffening"] = asdict(site.stiffening)
    if site.slide is not None:
        truth["slide"] = asdict(site.slide) | {"to_m": list(site.slide.to_m)}
    return truth


def _truth(scenario: Scenario, seed: int, visits: Sequence[_Visit]) -> dict[str, Any]:
    models = [visit.contacts.model for visit in visits]
    met = [
        (number, visit, contact)
        for number, visit in enumerate(visits, start=1)
        for contact in visit.contacts.contacts
    ]
    contacts = [
        {
            "contact": count,
            "site": number,
            "start_ns": START_NS + round((visit.start + contact.start) * 1e9),
            "end_ns": START_NS + round((visit.start + contact.stop) * 1e9),
            "max_strain": contact.max_strain(visit.contacts.model),
        }
        for count, (number, visit, contact) in enumerate(met, start=1)
    ]
    truth = {
        "scenario": scenario.name,
        "description": scenario.description,
        "seed": seed,
        "identifier_parameters": identifier_parameters(scenario, models),
        "surface_displacement_m": scenario.displacement.surface_m,
        "force_noise_n": scenario.force_noise_n,
        "displacement_delay_s": scenario.displacement.delay_s,
        "sites": [_site_truth(number, visit) for number, visit in enumerate(visits, start=1)],
        "contacts": contacts,
    }
    if scenario.disturbances != Disturbances():
        truth["disturbances"] = asdict(scenario.disturbances)
    if scenario.preload.depth_m > 0.0:
        truth["preload"] = asdict(scenario.preload)
    return truth
