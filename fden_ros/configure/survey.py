# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All findings of one rig, from its recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from fden_ros.configure.axes import find_axes
from fden_ros.configure.delay import delay_finding
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.rigid import compliance_finding, rigid_presses
from fden_ros.configure.sampling import (
    bias_findings,
    filter_finding,
    find_force_filter,
    lift_off_finding,
    noise_finding,
    rate_finding,
)
from fden_ros.configure.session import make_sessions
from fden_ros.configure.streams import Streams
from fden_ros.configure.units import STATED_SI, Unit, in_own_unit, unit_findings
from fden_ros.configure.weight import find_weight, weight_finding
from fden_ros.core.law import Geometry
from fden_ros.offline.thickness import assumed
from fden_ros.parameters import check


@dataclass(frozen=True)
class Survey:
    """What recordings show of a rig, in the order of output."""

    findings: tuple[Finding, ...]

    def finding(self, subject: str) -> Finding:
        """Return the finding of a subject."""
        return next(finding for finding in self.findings if finding.subject == subject)


def survey(
    recordings: Sequence[Streams],
    indenter: Mapping[str, float | str] | None = None,
    rigid: Collection[str] = (),
    units: Mapping[str, Unit] = STATED_SI,
) -> Survey:
    """Return the findings of recordings of one rig.

    Stated are the `indenter` (``geometry.*``), the names of recordings of a press on something
    `rigid`, and the `units` of force and displacement, which are then in SI units.
    """
    weight = find_weight(recordings)
    loads = [None if weight is None else weight.load(one) for one in recordings]
    sessions = make_sessions(recordings, loads)
    axes = find_axes(sessions)
    presses = rigid_presses(sessions, axes, rigid)
    load_sd = weight.sd if weight is not None and weight.holds else 0.0
    filtered = find_force_filter(sessions, axes.force)
    geometry = check({f"geometry.{k}": v for k, v in (indenter or {}).items()}).geometry.build()
    found = (
        *axes.findings(),
        *unit_findings(sessions, axes, geometry if indenter else None, units),
        rate_finding("force", sessions),
        noise_finding("force", sessions, axes.force, filtered),
        *(filter_finding(one) for one in (filtered,) if one is not None),
        rate_finding("displacement", sessions),
        noise_finding("displacement", sessions, axes.displacement),
        lift_off_finding(sessions),
        *bias_findings(sessions, axes.force, load_sd),
        weight_finding(weight, recordings),
        delay_finding(weight, presses, sessions, axes, filtered),
        compliance_finding(presses),
        _indenter(indenter, geometry),
    )
    return Survey(tuple(in_own_unit(finding, units) for finding in found))


def _indenter(stated: Mapping[str, float | str] | None, geometry: Geometry) -> Finding:
    """Return the stated indenter; no recording shows it."""
    if stated is None:
        return unknown("indenter", "force and displacement do not show a face or a thickness")
    words = ", ".join(f"{name} {value}" for name, value in stated.items())
    evidence = "; ".join(filter(None, ("as stated", assumed(geometry))))
    values = {f"geometry.{name}": value for name, value in stated.items()}
    return Finding("indenter", words, None, evidence, parameters=values)
