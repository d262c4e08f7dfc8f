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
from fden_ros.core.measured_stiffness import BothWays, MeasuredStiffness
from fden_ros.core.outputs import Output
from fden_ros.core.streams import Pair, StaticLinks, Synchronizer
from simulation.scenario import Scenario
from simulation.simulate import simulate

#: Points of a window, evenly over the way.
_POINTS = 400


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

    def beside(self, measured: BothWays) -> Iterator[tuple[MeasuredStiffness, float]]:
        """Give each measured slope with the true one of its window."""
        for sign, found in zip((1.0, -1.0), measured, strict=True):
            if found is not None:
                yield found, self.slope(found, sign)

    def slope(self, found: MeasuredStiffness, sign: float) -> float:
        """Return the slope of the line through the window of a measured one [N/m]."""
        stop = int(np.searchsorted(self.stamps, found.stamp_ns, side="right"))
        ways = sign * (self.places[:stop] - found.depth)
        outside = np.flatnonzero(ways < -0.5 * found.width)
        start = max(int(outside[-1]), 0) if outside.size else 0
        way = np.linspace(-0.5, 0.5, _POINTS) * found.width
        force = np.interp(way, *_rising(ways[start:], self.forces[start:stop]))
        return sign * float(np.polyfit(way, force, 1)[0])


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
