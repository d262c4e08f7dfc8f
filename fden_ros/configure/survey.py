# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All findings of one rig, from its recordings."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from fden_ros.configure.axes import Axes, find_axes
from fden_ros.configure.delay import delay_finding
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.lag import find_lag
from fden_ros.configure.rigid import Press, compliance_finding, rigid_presses
from fden_ros.configure.sampling import (
    bias_findings,
    filter_findings,
    find_force_filter,
    lift_off_finding,
    sampling_findings,
)
from fden_ros.configure.session import Session, make_sessions
from fden_ros.configure.streams import Streams
from fden_ros.configure.units import STATED_SI, Unit, in_own_unit, unit_findings
from fden_ros.configure.weight import Weight, find_weight, weight_findings
from fden_ros.core.law import Geometry
from fden_ros.offline.thickness import assumed
from fden_ros.parameters import check


@dataclass(frozen=True)
class Survey:
    """What recordings say of a rig, and what it rests on.

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
    units: Mapping[str, Unit] = STATED_SI,
) -> Survey:
    """Find out what recordings say of a rig.

    Parameters
    ----------
    recordings : sequence of Streams
        Of one rig, in whatever directions.
    indenter : dict, optional
        Values of ``geometry.*`` as they are stated.
    rigid : collection of str
        Names of recordings in which something rigid was pressed.
    show : callable
        Called with what is looked at next.
    one_place : bool
        Whether it is known that all presses are of one place.
    units : mapping
        What is stated of the units of ``force`` and ``displacement``, which are in SI units then.
    """
    show("tool weight")
    weight = find_weight(recordings)
    show("air and contacts")
    loads = [None if weight is None else weight.load(one) for one in recordings]
    sessions = make_sessions(recordings, loads)
    axes = find_axes(sessions)
    show("rigid presses")
    presses = rigid_presses(sessions, axes, rigid)
    show("delay")
    load_sd = weight.weight_sd if weight is not None and weight.holds else 0.0
    filtered = find_force_filter(sessions, axes.force)
    geometry = check({f"geometry.{k}": v for k, v in (indenter or {}).items()}).geometry.build()
    found = (
        *axes.findings(),
        *unit_findings(sessions, axes, geometry if indenter else None, units),
        *sampling_findings("force", sessions, axes.force),
        *filter_findings(filtered),
        *sampling_findings("displacement", sessions, axes.displacement),
        lift_off_finding(sessions),
        *bias_findings(sessions, axes.force, load_sd),
        *weight_findings(weight, recordings),
        delay_finding(weight, presses, lambda: find_lag(sessions, axes), filtered),
        compliance_finding(presses),
        _indenter(indenter, geometry),
        *_place(sessions, is_one=one_place),
    )
    findings = tuple(in_own_unit(finding, units) for finding in found)
    return Survey(findings, sessions, axes, weight, presses)


def _indenter(stated: dict[str, float | str] | None, geometry: Geometry) -> Finding:
    """Return the indenter as it was stated; no recording shows it."""
    if stated is None:
        return unknown("indenter", "force and displacement do not show a face or a thickness")
    words = ", ".join(f"{name} {value}" for name, value in stated.items())
    layer = assumed(geometry)
    evidence = f"as stated; {layer}" if layer else "as stated"
    values = {f"geometry.{name}": value for name, value in stated.items()}
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
