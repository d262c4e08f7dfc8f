# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

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
