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

"""A prior that is wide enough for what was touched, once the indenter is stated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.rigid import Press
from fden_ros.configure.session import Contact, Session
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
