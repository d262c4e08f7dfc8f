# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All findings of one rig, from its recordings, and what to do next so that all is found."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.configure.axes import Axes, find_axes
from fden_ros.configure.delay import delay_finding
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.rigid import Press, compliance_finding, contact_lines, rigid_presses
from fden_ros.configure.sampling import bias_findings, lift_off_finding, sampling_findings
from fden_ros.configure.session import Contact, Session, make_sessions
from fden_ros.configure.streams import Streams
from fden_ros.configure.surface import Scan, find_surface_plane
from fden_ros.configure.units import Units, find_units
from fden_ros.configure.weight import Weight, find_weight, weight_finding
from fden_ros.core.arrays import Array
from fden_ros.core.law.geometry import Geometry

#: Deviations of the logarithms, and alpha: wide, since the same contacts are then identified.
_LEAST_LOG_SD, _MOST_LOG_SD = 0.8, 2.0
_NONLINEAR_LOG_SD = 0.5
_ALPHA, _ALPHA_SD = 0.2, 0.1
_GRID = np.geomspace(2.0, 30.0, 15)
#: A press to less than this strain says nothing of Gn.
_LEAST_STRAIN = 0.05
#: A press to less than this strain is no press of tissue.
_TOUCHED = 0.02
_NONLINEAR = 8.4
_INDENTER = "state the indenter: --flat-punch AREA --thickness H, or --sphere R"


def geometry_finding(stated: dict[str, float | str] | None) -> Finding:
    """Return the indenter as it was stated; no recording shows it."""
    if stated is None:
        return unknown(
            "indenter", "force and displacement do not show a face or a thickness", _INDENTER
        )
    words = ", ".join(f"{name} {value}" for name, value in stated.items())
    return Finding(
        "indenter",
        True,
        words,
        None,
        "",
        (),
        "as stated",
        parameters={f"geometry.{name}": value for name, value in stated.items()},
    )


def prior_finding(
    sessions: Sequence[Session],
    axes: Axes,
    geometry: Geometry | None,
    compliance: float,
    lines: Sequence[Press],
) -> Finding:
    """Return medians and deviations of G, Gn and alpha before the touch."""
    subject = "prior"
    if geometry is None:
        return unknown(subject, "without the indenter forces are no stresses", _INDENTER)
    # What answers in a line and at once may be rigid.
    hard = {(id(line.session), line.contact) for line in lines if line.is_line}
    fits, seconds = [], []
    for session in sessions:
        if not session.leaves or axes.force is None or axes.displacement is None:
            continue
        for contact in session.contacts:
            if (id(session), contact) in hard:
                continue
            found = _fit(session, contact, axes, geometry, compliance)
            if found is not None:
                fits.append(found)
                seconds.append(session.seconds((contact,))[0])
    if not fits:
        return unknown(
            subject,
            "no press of tissue from the air on was seen",
            "press tissue to a strain of 0.2 in a second, hold for 2 s, lift off",
        )
    logs = np.log([stiffness for stiffness, _ in fits])
    median = float(np.exp(np.median(logs)))
    spread = min(max(_LEAST_LOG_SD, 2.0 * float(np.std(logs))), _MOST_LOG_SD)
    bends = [bend for _, bend in fits if bend is not None]
    bend = float(np.exp(np.median(np.log(bends)))) if bends else _NONLINEAR
    return Finding(
        subject,
        True,
        (median, bend, _ALPHA),
        None,
        "",
        tuple(seconds),
        f"loading of {len(fits)} presses, made wide: the same data are identified with it",
        parameters={
            "prior.linear_stiffness": float(f"{median:.3g}"),
            "prior.linear_stiffness_log_sd": round(spread, 2),
            "prior.nonlinear_stiffness": float(f"{bend:.3g}"),
            "prior.nonlinear_stiffness_log_sd": _NONLINEAR_LOG_SD,
            "prior.alpha": _ALPHA,
            "prior.alpha_sd": _ALPHA_SD,
        },
    )


def _fit(
    session: Session, contact: Contact, axes: Axes, geometry: Geometry, compliance: float
) -> tuple[float, float | None] | None:
    """Return G and, where the press was deep enough, Gn of the loading of a press."""
    assert axes.force is not None and axes.displacement is not None
    first = max(contact.first - 1, 0)
    span = slice(first, contact.last)
    push = session.net[span] @ axes.force.direction
    way = session.position[span] @ axes.displacement.direction
    depth = way - way[0] - compliance * push
    top = int(np.argmax(depth))
    if top < 3 or depth[top] <= 0.0:
        return None
    strain = np.array([geometry.strain(max(d, 0.0) / geometry.length) for d in depth[: top + 1]])
    stress = geometry.stress_per_force * push[: top + 1]
    if float(strain.max()) < _TOUCHED:
        return None
    duration = float(session.times[first + top] - session.times[first])
    misfits, sizes = [], []
    for bend in _GRID:
        shape = _characteristic(strain, float(bend))
        size = float(shape @ stress) / max(float(shape @ shape), 1e-300)
        sizes.append(size)
        misfits.append(float(np.sum((stress - size * shape) ** 2)))
    best = int(np.argmin(misfits))
    # A ramp of time T answers with T^-alpha / gamma(2 - alpha) of what G alone would.
    stiffness = sizes[best] * duration**_ALPHA * math.gamma(2.0 - _ALPHA)
    if stiffness <= 0.0:
        return None
    told = float(strain.max()) > _LEAST_STRAIN and 0 < best < _GRID.size - 1
    return stiffness, float(_GRID[best]) if told else None


def _characteristic(strain: Array, bend: float) -> Array:
    """Return phi / G of the FDEN law."""
    exponential = np.exp(np.clip(bend * strain - 1.0, 0.0, 50.0)) / bend
    return np.where(strain > 1.0 / bend, exponential, strain)


@dataclass(frozen=True)
class Survey:
    """What recordings say of a rig, and what it rests on; SI units.

    Parameters
    ----------
    findings : tuple of Finding
        In the order in which they are told.
    sessions : tuple of Session
    axes : Axes
    units : Units
    weight : Weight or None
    presses : tuple of Press
        Those on something rigid.
    scan : Scan
        Touches of the surface.
    """

    findings: tuple[Finding, ...]
    sessions: tuple[Session, ...]
    axes: Axes
    units: Units
    weight: Weight | None
    presses: tuple[Press, ...]
    scan: Scan

    def finding(self, subject: str) -> Finding:
        """Return the finding of a subject."""
        return next(finding for finding in self.findings if finding.subject == subject)


def survey(
    recordings: Sequence[Streams],
    stated: dict[str, float | str] | None = None,
    geometry: Geometry | None = None,
    rigid: Collection[str] = (),
    show: Callable[[str], object] = lambda step: None,
) -> Survey:
    """Find out what recordings say of a rig.

    Parameters
    ----------
    recordings : sequence of Streams
        Of one rig, in whatever units and directions.
    stated, geometry : optional
        The indenter: values of ``geometry.*``, and what they make.
    rigid : collection of str
        Names of recordings in which something rigid was pressed.
    show : callable
        Called with what is looked at next.
    """
    show("tool weight")
    weight = find_weight(recordings)
    show("air and contacts")
    sessions = _sessions(recordings, weight)
    axes = find_axes(sessions)
    show("units")
    units = find_units(sessions, axes, weight)
    if (units.newton, units.metre) != (1.0, 1.0):
        recordings = [one.scaled(units.newton, units.metre) for one in recordings]
        weight = None if weight is None else in_newtons(weight, units.newton)
        sessions = _sessions(recordings, weight)
        axes = find_axes(sessions)
    show("rigid presses")
    presses = rigid_presses(sessions, axes, rigid)
    compliance = compliance_finding(presses)
    known = compliance.value if isinstance(compliance.value, float) else 0.0
    show("delay")
    delay = delay_finding(sessions, axes, weight, presses, known if compliance.claim else None)
    show("surface")
    scan = find_surface_plane(sessions, axes, presses, delay, units.displacement)
    lines = contact_lines(sessions, axes)
    load_sd = weight.weight_sd if weight is not None and weight.holds else 0.0
    found = (
        *axes.findings(),
        units.force,
        units.displacement,
        *sampling_findings("force", sessions, axes.force),
        *sampling_findings("displacement", sessions, axes.displacement),
        lift_off_finding(sessions),
        *bias_findings(sessions, axes.force, load_sd),
        *weight_finding(weight, recordings, 1.0),
        delay,
        compliance,
        scan.finding,
        geometry_finding(stated),
        prior_finding(sessions, axes, geometry, known, lines),
    )
    findings = tuple(_in_known_units(finding, units) for finding in found)
    return Survey(findings, sessions, axes, units, weight, presses, scan)


def _in_known_units(finding: Finding, units: Units) -> Finding:
    """Return the finding, no longer stated where it rests on a unit that is not known."""
    known = {"N": units.force.claim, "kg": units.force.claim, "N/s": units.force.claim}
    known["m"] = units.displacement.claim
    known["m/N"] = known["m"] and known["N"]
    if finding.subject == "prior":
        known[""] = known["m/N"]
    if finding.subject == "tool centre of mass":
        known["m"] = True
    if not finding.claim or known.get(finding.unit, True) or finding.subject.endswith("unit"):
        return finding
    return replace(
        finding,
        claim=False,
        evidence=f"{finding.evidence}; the unit is not known",
        parameters={},
        motion="say which unit it is",
    )


def _sessions(recordings: Sequence[Streams], weight: Weight | None) -> tuple[Session, ...]:
    loads = [None if weight is None else weight.load(one) for one in recordings]
    return make_sessions(recordings, loads)


def in_newtons(weight: Weight, newton: float) -> Weight:
    """Return the weight with its forces multiplied."""
    return replace(
        weight,
        matrix=newton * weight.matrix,
        weight=newton * weight.weight,
        weight_sd=newton * weight.weight_sd,
        left=newton * weight.left,
        noise=newton * weight.noise,
    )


@dataclass(frozen=True)
class Step:
    """One thing to do.

    Parameters
    ----------
    name, says : str
        Short, and in words.
    subjects : tuple of str
        Findings that are stated once it is done.
    """

    name: str
    says: str
    subjects: tuple[str, ...]

    def is_done(self, found: Survey) -> bool:
        """Whether what it is for is stated."""
        return all(found.finding(subject).claim for subject in self.subjects)


#: In this order: each needs what stands before it.
STEPS = (
    Step("air", "hold the probe still in the air for 3 s", ("force noise",)),
    Step(
        "turn",
        "turn the tool in the air through three orientations 60 degrees apart, half a turn in "
        "2 s, with a second of rest at each, and turn back",
        ("tool mass",),
    ),
    Step(
        "press",
        "press tissue three times by 3 mm or more, hold for 2 s, and lift off by 3 mm in between",
        ("force axis", "displacement axis"),
    ),
    Step(
        "plate",
        "press a rigid plate twice, slowly, to the largest force of your presses",
        ("compliance",),
    ),
    Step(
        "delay",
        "press tissue by 3 mm, wait for 2 s, and move by 0.5 mm in a sine: ten cycles at 1 Hz, "
        "ten at 4 Hz",
        ("delay",),
    ),
)


def steps_for(has_orientation: bool) -> tuple[Step, ...]:
    """Return the steps; without orientations turning the tool shows nothing."""
    return tuple(step for step in STEPS if has_orientation or step.name != "turn")
