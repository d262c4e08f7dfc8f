# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Motions of a probe: through the air to the surface, into the tissue and out again.

A trajectory describes the motion in the tissue (a ramp, a hold, a sine); :class:`Approach` that
in the air. Together they give one list of moves in units of strain, negative above the
undisturbed surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from simulation.closed_form import LinearMove, Move, SineMove


class Path:
    """A motion under construction: the probe's place, from time 0 on, and its moves so far.

    A strain of 1 is `length_m` in the air; :meth:`go` goes back to the strain `floor` at least.
    """

    def __init__(self, strain: float, length_m: float) -> None:
        self.time = 0.0
        self.floor = -math.inf
        self.strain = strain
        self.length_m = length_m
        self.moves: list[Move] = []

    def rest(self, duration_s: float) -> None:
        """Stay for a time."""
        if duration_s > 0.0:
            self._add(LinearMove(self.time, self.time + duration_s, self.strain, self.strain))

    def go(self, strain: float, strain_rate: float) -> None:
        """Move to `strain` at a constant rate (1/s, its sign does not matter)."""
        strain = max(strain, self.floor)
        if strain != self.strain:
            duration = abs(strain - self.strain) / abs(strain_rate)
            self._add(LinearMove(self.time, self.time + duration, self.strain, strain))

    def oscillate(self, amplitude: float, frequency: float, cycles: int) -> None:
        """Add whole cycles of a sine around the present strain."""
        stop = self.time + cycles / frequency
        self._add(SineMove(self.time, stop, self.strain, amplitude, frequency, self.time))

    def _add(self, move: Move) -> None:
        mean = self.strain
        self.moves.append(move)
        self.time = move.stop
        self.strain = move.stop_strain if isinstance(move, LinearMove) else mean


@dataclass(frozen=True)
class Approach:
    """How the probe moves in the air; the same for every site."""

    distance_m: float = 0.01  #: Height above the surface where the probe waits
    #: Speed down to `slow_distance_m` above the surface, from where the probe moves at the
    #: rate of its press: a robot does not know where the surface is, so nothing may change at
    #: the touch
    speed_m_per_s: float = 0.02
    slow_distance_m: float = 0.001  #: See there
    #: Speed away from the tissue, unless the press says otherwise
    retract_speed_m_per_s: float = 0.02
    start_pause_s: float = 2.0  #: Time in the air before the first approach, for the tare
    site_pause_s: float = 3.0  #: Time in the air between sites; the probe moves sideways in it

    def descend(self, path: Path) -> None:
        """Bring the probe to the start of the press, unless it is nearer already."""
        near = -self.slow_distance_m / path.length_m
        if path.strain < near:
            path.go(near, self.speed_m_per_s / path.length_m)

    def retract(
        self, path: Path, strain_rate: float | None, height_m: float | None = None
    ) -> None:
        """Return the probe to the air."""
        rate = self.retract_speed_m_per_s / path.length_m if strain_rate is None else strain_rate
        path.go(-(self.distance_m if height_m is None else height_m) / path.length_m, rate)


class Trajectory:
    """The common part of all presses: the probe comes from the air, presses, and returns.

    `strain_rate` is that of the indentation, `retract_rate` that of the retract, in 1/s; None: by
    the approach's retract speed.
    """

    kind: ClassVar[str]
    retract_rate: float | None

    def press(self, path: Path, approach: Approach) -> None:
        """Append the press to `path`: down, into the tissue, and back into the air."""
        approach.descend(path)
        self._go(path, approach)
        approach.retract(path, self.retract_rate)

    def _go(self, path: Path, approach: Approach) -> None:
        """Append the motion between indentation and retract."""
        raise NotImplementedError


@dataclass(frozen=True)
class Ramp(Trajectory):
    """Into the tissue at a constant rate of strain up to `max_strain`, and out again."""

    kind: ClassVar[str] = "ramp"
    strain_rate: float
    max_strain: float
    retract_rate: float | None = None

    def _go(self, path: Path, approach: Approach) -> None:
        path.go(self.max_strain, self.strain_rate)


@dataclass(frozen=True)
class RampHold(Trajectory):
    """A ramp to `max_strain`, which is held for `hold_s`."""

    kind: ClassVar[str] = "ramp_hold"
    strain_rate: float
    max_strain: float
    hold_s: float
    retract_rate: float | None = None

    def _go(self, path: Path, approach: Approach) -> None:
        path.go(self.max_strain, self.strain_rate)
        path.rest(self.hold_s)


@dataclass(frozen=True)
class Staircase(Trajectory):
    """To `max_strain` in as many equal `steps`, each a ramp that is held for `hold_s`."""

    kind: ClassVar[str] = "staircase"
    strain_rate: float
    max_strain: float
    steps: int
    hold_s: float
    retract_rate: float | None = None

    def _go(self, path: Path, approach: Approach) -> None:
        for count in range(1, self.steps + 1):
            path.go(self.max_strain * count / self.steps, self.strain_rate)
            path.rest(self.hold_s)


@dataclass(frozen=True)
class Palpation(Trajectory):
    """Repeated presses of one place: ramp, hold, out of contact, pause, and again."""

    kind: ClassVar[str] = "palpation"
    strain_rate: float
    #: As in :class:`RampHold`
    max_strain: float
    hold_s: float = 0.5
    retract_rate: float | None = None
    presses: int = 10  #: How often
    #: Height above the undisturbed surface to which the probe goes between two presses
    lift_m: float = 0.002
    pause_s: float = 0.5  #: Time it stays there

    def _go(self, path: Path, approach: Approach) -> None:
        for count in range(1, self.presses + 1):
            path.go(self.max_strain, self.strain_rate)
            path.rest(self.hold_s)
            if count < self.presses:
                approach.retract(path, self.retract_rate, self.lift_m)
                path.rest(self.pause_s)


@dataclass(frozen=True)
class Sinusoid(Trajectory):
    """A ramp to `mean_strain`, a hold, then whole cycles of a sine of `amplitude` around it."""

    kind: ClassVar[str] = "sinusoid"
    strain_rate: float
    mean_strain: float
    amplitude: float
    frequency_hz: float
    cycles: int
    hold_s: float = 0.0
    retract_rate: float | None = None

    def _go(self, path: Path, approach: Approach) -> None:
        path.go(self.mean_strain, self.strain_rate)
        path.rest(self.hold_s)
        path.oscillate(self.amplitude, self.frequency_hz, self.cycles)


TRAJECTORIES: dict[str, type[Trajectory]] = {
    one.kind: one for one in (Ramp, RampHold, Staircase, Palpation, Sinusoid)
}
