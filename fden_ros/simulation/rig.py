# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe on a driven axis over simulated tissue: commands in, measured force and position out.

What a robot's driver would publish, without the robot. Deterministic for a given seed and the
same commands at the same steps.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from fden_ros.errors import InputError
from fden_ros.simulation.tissue import Column, Tissue


class Command(enum.Enum):
    """The commanded motion of the axis."""

    POSITION = "position"  #: [m], from the undisturbed surface into the tissue
    VELOCITY = "velocity"  #: [m/s], into the tissue; ends by itself after `command_timeout`
    FORCE = "force"  #: [N], by the rig's own force control


@dataclass(frozen=True)
class RigConfig:
    """Tissue, axis and sensors; SI units.

    Parameters
    ----------
    columns
        The tissue, by place.
    area, thickness
        Flat punch: stress is force over area, strain is depth over thickness.
    step
        Time step in s.
    delay
        From a command to the axis taking it, in s.
    servo_lag
        Time constant of the axis's velocity in s.
    max_speed, max_lateral_speed
        In m/s.
    position_gain
        Velocity per position error in 1/s.
    force_gain
        Velocity per force error in m/(N s), of the rig's own force control.
    command_timeout
        Time after which a velocity without a new command becomes 0, in s.
    height
        Where the probe begins, in m above the surface.
    force_noise, force_bias
        Standard deviation and bias of the measured force in N.
    displacement_noise
        Standard deviation of the measured position in m.
    seed
        Of the noise.
    """

    columns: tuple[Column, ...]
    area: float = 3.1416e-4
    thickness: float = 0.02
    step: float = 1e-3
    delay: float = 0.01
    servo_lag: float = 0.015
    max_speed: float = 0.05
    max_lateral_speed: float = 0.05
    position_gain: float = 20.0
    force_gain: float = 0.02
    command_timeout: float = 0.2
    height: float = 0.002
    force_noise: float = 1e-3
    force_bias: float = 0.05
    displacement_noise: float = 1e-6
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("area", "thickness", "max_speed", "max_lateral_speed", "command_timeout"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"rig: {name} is {getattr(self, name)}; it must be positive")
        for name in ("delay", "servo_lag", "force_noise", "displacement_noise"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"rig: {name} is {getattr(self, name)}; it must not be negative")


class Rig:
    """The probe, its axis and the tissue, moved on step by step.

    Attributes
    ----------
    time
        In s since the beginning.
    depth
        Of the probe, true, in m; negative above the surface.
    velocity
        Of the probe in m/s, into the tissue.
    force
        True force on the tissue in N.
    """

    def __init__(self, config: RigConfig) -> None:
        self.config = config
        self.tissue = Tissue(config.columns, config.step)
        self.depth = -config.height
        self.velocity = 0.0
        self.force = 0.0
        self._steps = 0
        self._lateral = list(config.columns[0].position)
        self._lateral_target = list(config.columns[0].position)
        self._kind, self._value = Command.POSITION, self.depth
        self._taken = 0.0
        self._queue: deque[tuple[float, Command, float]] = deque()
        self._noise = np.random.default_rng(config.seed)

    @property
    def time(self) -> float:
        """Seconds since the beginning."""
        return self._steps * self.config.step

    @property
    def column(self) -> int:
        """Index of the column under the probe."""
        return self.tissue.nearest(*self._lateral)

    @property
    def lateral_target(self) -> tuple[float, float]:
        """Where the probe is going, across the approach axis [m]."""
        x, y = self._lateral_target
        return x, y

    def command(self, kind: Command, value: float) -> None:
        """Give the axis something to do; it takes it after the delay.

        Raises
        ------
        InputError
            If the value is not finite.
        """
        if not math.isfinite(value):
            raise InputError(f"the commanded {kind.value} is {value}; it must be finite")
        self._queue.append((self.time + self.config.delay, kind, value))

    def move_to(self, x: float, y: float) -> None:
        """Send the probe to another place [m], across the approach axis."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InputError(f"the commanded place is ({x}, {y}); it must be finite")
        self._lateral_target = [x, y]

    def step(self) -> None:
        """Move on by one time step."""
        config = self.config
        while self._queue and self._queue[0][0] <= self.time + 1e-9:
            self._taken, self._kind, self._value = self._queue.popleft()
        wanted = min(max(self._wanted_velocity(), -config.max_speed), config.max_speed)
        part = -math.expm1(-config.step / config.servo_lag) if config.servo_lag > 0.0 else 1.0
        self.velocity += part * (wanted - self.velocity)
        self.depth += self.velocity * config.step
        self._move_sideways()
        stress = self.tissue.press(self.depth / config.thickness, self.column)
        self.force = stress * config.area
        self._steps += 1

    def measured_force(self) -> float:
        """Return the force as the sensor gives it, in N."""
        config = self.config
        return self.force + config.force_bias + config.force_noise * self._noise.standard_normal()

    def measured_position(self) -> tuple[float, float, float]:
        """Return the place and the depth of the probe as the axis gives them, in m."""
        noise = self.config.displacement_noise * self._noise.standard_normal(3)
        x, y = self._lateral
        return x + noise[0], y + noise[1], self.depth + noise[2]

    def _wanted_velocity(self) -> float:
        if self._kind is Command.POSITION:
            return self.config.position_gain * (self._value - self.depth)
        if self._kind is Command.FORCE:
            return self.config.force_gain * (self._value - self.force)
        expired = self.time - self._taken > self.config.command_timeout
        return 0.0 if expired else self._value

    def _move_sideways(self) -> None:
        (x, y), (to_x, to_y) = self._lateral, self._lateral_target
        left = math.hypot(to_x - x, to_y - y)
        reach = self.config.max_lateral_speed * self.config.step
        part = min(reach / left, 1.0) if left > 0.0 else 0.0
        self._lateral = [x + part * (to_x - x), y + part * (to_y - y)]
