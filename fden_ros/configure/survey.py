# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""All findings of one rig, from its recordings."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from fden_ros.configure.axes import Axes, find_axes
from fden_ros.configure.bias import bias_findings
from fden_ros.configure.compliance import compliance_finding
from fden_ros.configure.delay import delay_finding
from fden_ros.configure.finding import Finding
from fden_ros.configure.lift_off import lift_off_finding
from fden_ros.configure.prior import geometry_finding, prior_finding
from fden_ros.configure.rigid import Press, contact_lines, rigid_presses
from fden_ros.configure.sampling import sampling_findings
from fden_ros.configure.session import Session, make_session
from fden_ros.configure.streams import Streams
from fden_ros.configure.surface import Scan, find_surface_plane
from fden_ros.configure.units import Units, find_units
from fden_ros.configure.weight import Weight, find_weight, weight_finding
from fden_ros.core.law.geometry import Geometry


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
    return tuple(
        make_session(one, None if weight is None else weight.load(one)) for one in recordings
    )


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
