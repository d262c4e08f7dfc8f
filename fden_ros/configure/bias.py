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

"""Bias and drift of the force along its axis, in the air."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.configure.axes import Axis
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Session, runs
from fden_ros.configure.statistics import fit
from fden_ros.core.arrays import Array

#: The air that a bias rests on: the first stretch of at least this long, up to 5 s.
_LEAST, _MOST = 1.0, 5.0
#: A drift is told from air that is spread over at least this time [s].
_SPREAD = 10.0
#: `force.drift_sd` stays at its default up to this drift [N/s].
_DEFAULT_DRIFT = 0.005
_AIR = "begin with 2 s in the air, and lift off between presses"


def bias_findings(
    sessions: Sequence[Session], axis: Axis | None, load_sd: float = 0.0
) -> tuple[Finding, Finding]:
    """Return bias and drift; `load_sd` is the deviation of the tool's weight taken off [N]."""
    if axis is None:
        reason = "the force's axis is not known"
        return unknown("force bias", reason, _AIR), unknown("force drift", reason, _AIR)
    seen = [session for session in sessions if session.leaves]
    if not seen:
        reason = "the probe is never seen in the air"
        return unknown("force bias", reason, _AIR), unknown("force drift", reason, _AIR)
    return _bias(seen, axis, load_sd), _drift(seen, axis)


def _bias(sessions: Sequence[Session], axis: Axis, load_sd: float) -> Finding:
    for session in sessions:
        for first, last in runs(session.air):
            start = float(session.edges[first])
            end = min(float(session.edges[last]), start + _MOST)
            if end - start < _LEAST:
                continue
            inside = (session.streams.force_times >= start) & (session.streams.force_times < end)
            values = session.unloaded[inside] @ axis.direction
            found = fit(np.ones((values.size, 1)), values)
            zero = session.streams.start
            return Finding(
                "force bias",
                True,
                float(found.solution[0]),
                math.hypot(math.sqrt(float(found.covariance[0, 0])), load_sd),
                "N",
                ((start - zero, end - zero),),
                "mean force along the axis, the tool's weight taken off; measured anew before "
                "each contact",
            )
    return unknown("force bias", f"no stretch of {_LEAST:g} s in the air", _AIR)


def _drift(sessions: Sequence[Session], axis: Axis) -> Finding:
    slopes, variances, seconds = [], [], []
    for session in sessions:
        times = session.times[session.air]
        if times.size < 10 or float(np.ptp(times)) < _SPREAD:
            continue
        slope, variance = _slope(times, session.force[session.air] @ axis.direction)
        slopes.append(slope)
        variances.append(variance)
        seconds += list(session.air_seconds())
    if not slopes:
        return unknown(
            "force drift",
            f"the air is not spread over {_SPREAD:g} s",
            "record for a minute, with the probe in the air every few seconds",
        )
    weights = 1.0 / np.array(variances)
    slope = float(weights @ np.array(slopes) / weights.sum())
    sd = math.sqrt(1.0 / float(weights.sum()))
    worst = abs(slope) + 2.0 * sd
    parameters = {"force.drift_sd": round(worst, 5)} if worst > _DEFAULT_DRIFT else {}
    kept = "" if parameters else "; within the default of force.drift_sd, which stays"
    return Finding(
        "force drift",
        True,
        slope,
        sd,
        "N/s",
        tuple(seconds),
        f"line through {len(seconds)} stretches in the air{kept}",
        parameters=parameters,
    )


def _slope(times: Array, values: Array) -> tuple[float, float]:
    since = times - times.mean()
    found = fit(np.stack([np.ones_like(since), since], axis=1), values)
    return float(found.solution[1]), float(found.covariance[1, 1])
