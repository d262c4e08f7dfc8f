# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All findings of one rig, from its recordings, and what to do next so that all is found."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from fden_ros.configure.axes import Axes, find_axes
from fden_ros.configure.delay import delay_finding
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.lag import find_lag
from fden_ros.configure.rigid import Press, compliance_finding, rigid_presses
from fden_ros.configure.sampling import bias_findings, lift_off_finding, sampling_findings
from fden_ros.configure.session import Session, make_sessions
from fden_ros.configure.streams import Streams
from fden_ros.configure.units import Units, find_units
from fden_ros.configure.weight import Weight, find_weight, weight_findings
from fden_ros.offline.thickness import assumed
from fden_ros.parameters import check


@dataclass(frozen=True)
class Survey:
    """What recordings say of a rig, and what it rests on; SI units.

    Parameters
    ----------
    findings : tuple of Finding
        In the order in which they are said.
    sessions : tuple of Session
    axes : Axes
    weight : Weight or None
    presses : tuple of Press
        Those on something rigid.
    """

    findings: tuple[Finding, ...]
    sessions: tuple[Session, ...]
    axes: Axes
    weight: Weight | None
    presses: tuple[Press, ...]

    def finding(self, subject: str) -> Finding:
        """Return the finding of a subject."""
        return next(finding for finding in self.findings if finding.subject == subject)


def survey(
    recordings: Sequence[Streams],
    indenter: dict[str, float | str] | None = None,
    rigid: Collection[str] = (),
    show: Callable[[str], object] = lambda step: None,
    *,
    one_place: bool = False,
) -> Survey:
    """Find out what recordings say of a rig.

    Parameters
    ----------
    recordings : sequence of Streams
        Of one rig, in whatever units and directions.
    indenter : dict, optional
        Values of ``geometry.*`` as they are stated.
    rigid : collection of str
        Names of recordings in which something rigid was pressed.
    show : callable
        Called with what is looked at next.
    one_place : bool
        Whether it is known that all presses are of one place.
    """
    show("tool weight")
    weight = find_weight(recordings)
    show("air and contacts")
    sessions = _sessions(recordings, weight)
    axes = find_axes(sessions)
    units = find_units(sessions, axes, weight)
    if (units.newton, units.metre) != (1.0, 1.0):
        recordings = [one.scaled(units.newton, units.metre) for one in recordings]
        weight = None if weight is None else weight.scaled(units.newton)
        sessions = _sessions(recordings, weight)
        axes = find_axes(sessions)
    show("rigid presses")
    presses = rigid_presses(sessions, axes, rigid)
    show("delay")
    load_sd = weight.weight_sd if weight is not None and weight.holds else 0.0
    found = (
        *axes.findings(),
        units.force,
        units.displacement,
        *sampling_findings("force", sessions, axes.force),
        *sampling_findings("displacement", sessions, axes.displacement),
        lift_off_finding(sessions),
        *bias_findings(sessions, axes.force, load_sd),
        *weight_findings(weight, recordings),
        delay_finding(weight, presses, lambda: find_lag(sessions, axes, indenter)),
        compliance_finding(presses),
        _indenter(indenter),
        *_place(sessions, is_one=one_place),
    )
    findings = tuple(_in_known_units(finding, units) for finding in found)
    return Survey(findings, sessions, axes, weight, presses)


def _sessions(recordings: Sequence[Streams], weight: Weight | None) -> tuple[Session, ...]:
    loads = [None if weight is None else weight.load(one) for one in recordings]
    return make_sessions(recordings, loads)


def _indenter(stated: dict[str, float | str] | None) -> Finding:
    """Return the indenter as it was stated; no recording shows it."""
    if stated is None:
        return unknown("indenter", "force and displacement do not show a face or a thickness")
    words = ", ".join(f"{name} {value}" for name, value in stated.items())
    values = {f"geometry.{name}": value for name, value in stated.items()}
    layer = assumed(check(values).geometry.build())
    evidence = f"as stated; {layer}" if layer else "as stated"
    return Finding("indenter", words, None, evidence, parameters=values)


def _place(sessions: Sequence[Session], *, is_one: bool) -> list[Finding]:
    """Return whether touches are of one place, and how long the probe is away from it."""
    away = [
        later.start - earlier.end
        for session in sessions
        for earlier, later in itertools.pairwise(session.contacts)
    ]
    has_positions = sessions[0].position.shape[1] == 3
    if not is_one:
        by = "there are no positions: a press is followed as of the last place and as of another"
        return [unknown("place", by)] if away and not has_positions else []
    if has_positions:
        by = "as stated; its positions tell touches apart"
        return [Finding("place", "one", None, by)]
    values = {"site.without_position": "same"}
    return [Finding("place", "one", None, "as stated", parameters=values)]


def _in_known_units(finding: Finding, units: Units) -> Finding:
    """Return the finding, no longer stated where it rests on a unit that is not known."""
    newton, metre = units.force.claim, units.displacement.claim
    if finding.subject == "tool centre of mass":
        metre = True
    known = {"N": newton, "kg": newton, "N/s": newton, "m": metre, "m/N": metre and newton}
    if not finding.claim or known.get(finding.unit, True):
        return finding
    evidence = f"{finding.evidence}; the unit is not known"
    motion = "say which unit it is"
    # The floor is a tenth of the noise in whatever unit a replay reads both.
    kept = finding.parameters if finding.subject == "force noise" else {}
    return replace(finding, claim=False, evidence=evidence, parameters=kept, motion=motion)
