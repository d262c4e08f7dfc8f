# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measured slopes of force over displacement beside those of the same motion without noise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from benchmark.score import TWO_SIDED_95, Share, share
from benchmark.trial import feed_samples, last_summaries
from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.outputs import Output
from fden_ros.core.stiffness import MeasuredSlope, Slopes
from fden_ros.core.streams import Pair, StaticLinks, Synchronizer
from simulation.scenario import Scenario
from simulation.simulate import simulate

#: Way of the motion whose parabola gives the true slope [m].
_WAY = 5e-4


def slopes_held(scenario: Scenario, config: PipelineConfig, outputs: Iterable[Output]) -> Share:
    """Return of how many measured slopes of the contacts the 95 % interval holds the true one."""
    smooth = SmoothMotion(scenario, config)
    held = [
        abs(found.value - true) <= TWO_SIDED_95 * found.sd
        for summary in last_summaries(list(outputs)).values()
        for found, true in smooth.beside(summary.measured)
    ]
    return share(held)


class SmoothMotion:
    """A scenario without white noise, hum, vibration and steps of the readings."""

    def __init__(self, scenario: Scenario, config: PipelineConfig) -> None:
        pairs: list[Pair] = []
        joined = Synchronizer(config.synchronize, pairs.append, Counter(), StaticLinks())
        feed_samples(joined, simulate(_smooth(scenario)))
        self.stamps = np.array([pair.stamp_ns for pair in pairs])
        free = config.contact.compliance_free
        self.places = np.array([free(pair, pair.force) for pair in pairs])
        self.forces = np.array([pair.force for pair in pairs])

    def beside(self, measured: Slopes) -> Iterator[tuple[MeasuredSlope, float]]:
        """Give each measured slope with the true one where the probe was then."""
        for sign, found in zip((1.0, -1.0), measured, strict=True):
            if found is not None:
                yield found, self.slope(found, sign)

    def slope(self, found: MeasuredSlope, sign: float) -> float:
        """Return the slope of the motion at the stamp of a measured one [N/m].

        By a parabola over half a millimetre: before the end of a loading, or from it on.
        """
        at = int(np.searchsorted(self.stamps, found.stamp_ns))
        own = slice(at, None, -1) if sign > 0.0 else slice(at, None)
        ways, forces = _rising(self.places[at] - self.places[own], self.forces[own])
        inside = (ways > 0.0) & (ways <= _WAY)  # the last step may be part of the hold
        line = np.polynomial.Polynomial.fit(-ways[inside], forces[inside], 2)
        return float(line.deriv()(0.0))


def _rising(ways: Array, forces: Array) -> tuple[Array, Array]:
    """Return the samples that go further than all before them."""
    further = np.diff(np.maximum.accumulate(ways), prepend=-np.inf) > 0.0
    return ways[further], forces[further]


def _smooth(scenario: Scenario) -> Scenario:
    """Return the scenario with next to no noise."""
    return replace(
        scenario,
        # A signal without any is taken for one that is stuck.
        force=replace(scenario.force, noise_n=1e-7),
        displacement=replace(scenario.displacement, noise_m=1e-10),
        disturbances=replace(
            scenario.disturbances,
            hum_n=0.0,
            vibration_n=0.0,
            force_step_n=0.0,
            displacement_step_m=0.0,
        ),
    )
