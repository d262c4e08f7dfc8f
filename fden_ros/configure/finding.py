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

"""One thing that a recording says of the probe, or does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fden_ros.parameters import Value

Number = float | tuple[float, ...]
Seconds = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Finding:
    """What was found, how sure it is, and where from.

    Parameters
    ----------
    subject : str
        Of what, such as ``force axis``.
    claim : bool
        Whether it is stated; False: the recording cannot tell, and `motion` says what would.
    value : float, tuple of float, str or None
        In `unit`; None where nothing is known.
    deviation : float, optional
        Standard deviation, of each component, in `unit` (of an axis: of its direction, in rad).
    unit : str
        SI unit; empty where there is none.
    seconds : tuple of (float, float)
        Of the recording that it rests on, as from and to since its first stamp [s].
    evidence : str
        What shows it, in one line.
    motion : str
        What to do so that the next recording tells.
    parameters : mapping
        Values of the parameter file, by dotted name.
    """

    subject: str
    claim: bool
    value: Number | str | None = None
    deviation: float | None = None
    unit: str = ""
    seconds: Seconds = ()
    evidence: str = ""
    motion: str = ""
    parameters: Mapping[str, Value] = field(default_factory=dict)


def unknown(subject: str, evidence: str, motion: str) -> Finding:
    """Return the finding that the recording cannot tell."""
    return Finding(subject, False, evidence=evidence, motion=motion)
