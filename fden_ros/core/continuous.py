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

"""A probe that stays on the tissue: what its palpation tells of each place on its path.

Where it touched and what the tissue went through before is not known, so there is no strain, and
neither G nor Gn. What an oscillation of the probe tells needs neither: the stiffness dF/dd at its
frequency, alpha by its phase, and with a flat geometry the complex modulus. The trend of each
window takes up the bias of the force, relaxation, drift and the height of the surface.

A *place* ends when the probe has moved on by `site_distance` to the side; each is a site with one
contact, so summaries, map and table hold the path.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from fden_ros.core.block import BlockSums, PhaseMeter
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.complex_modulus import ComplexModulus, ComplexModulusMeter
from fden_ros.core.estimation.local_stiffness import LocalStiffness, Stiffness
from fden_ros.core.estimation.palpation import Palpated, palpated
from fden_ros.core.estimation.palpation_frequency import PalpationFrequency
from fden_ros.core.outputs import (
    ApparentStiffness,
    ContactSummary,
    DynamicModulus,
    Flag,
    Output,
    Phase,
    Status,
    TissueState,
    edge_flag,
    order_source,
)
from fden_ros.core.plausibility import stands_against
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, lateral_distance

#: Periods of a window [1], and harmonics that are fitted beside the trend: with one period, or
#: without the second harmonic, the harmonics of a nonlinear tissue pass for trend.
_PERIODS, _HARMONICS = 2, (1.0, 2.0)
#: Least amplitude, as a share of the geometry's length [1].
_LEAST_AMPLITUDE = 1e-4
#: What a window told is current for this many windows [1].
_CURRENT = 2.5
#: Time without an oscillation [s] after which it is missed.
_SILENT_TIME = 10.0


class Place:
    """What is gathered at one place of the path."""

    def __init__(self, number: int, start_ns: int, position: Position | None) -> None:
        self.number = number
        self.start_ns = self.end_ns = start_ns
        self.first = position
        self.samples = 0
        self.max_force = 0.0
        self.flags = Flag.ORIGIN_UNCERTAIN
        self.rejected = 0
        self.found: Palpated | None = None
        self._sum = (0.0, 0.0, 0.0)
        self._windows = 0

    def add(self, window: Window, found: Palpated | None) -> None:
        """Take a window of this place."""
        self.end_ns = window.stop_ns
        self.samples += window.samples
        self.max_force = max(self.max_force, window.max_force)
        self.found = found if found is not None else self.found
        self._windows += 1
        if window.position is not None:
            x, y, z = (a + b for a, b in zip(self._sum, window.position, strict=True))
            self._sum = (x, y, z)

    @property
    def position(self) -> Position | None:
        """Mean position of its windows [m]."""
        if self.first is None:
            return None
        x, y, z = (value / self._windows for value in self._sum)
        return x, y, z


class Window:
    """The samples of one window of the palpation."""

    def __init__(self) -> None:
        self.samples = self.stop_ns = self.start_ns = 0
        self.max_force = 0.0
        self._sum = (0.0, 0.0, 0.0)
        self._located = 0

    def add(self, pair: Pair) -> None:
        """Take a sample."""
        self.start_ns = self.start_ns or pair.stamp_ns
        self.stop_ns = pair.stamp_ns
        self.samples += 1
        self.max_force = max(self.max_force, pair.force)
        if pair.position is not None:
            x, y, z = (a + b for a, b in zip(self._sum, pair.position, strict=True))
            self._sum = (x, y, z)
            self._located += 1

    @property
    def position(self) -> Position | None:
        """Mean position [m]; None where one is not known."""
        if not self._located or self._located < self.samples:
            return None
        x, y, z = (value / self._located for value in self._sum)
        return x, y, z


class ContinuousContact:
    """From pairs to states, moduli and one summary a place.

    Parameters
    ----------
    config : PipelineConfig
    first_number : int
        Of the places from here on.

    Attributes
    ----------
    place_count : int
        Number of the newest place.
    """

    def __init__(self, config: PipelineConfig, first_number: int = 1) -> None:
        self._config = config
        self.place_count = first_number - 1
        self._place: Place | None = None
        self._blocks = BlockSums(config.block_duration, math.inf)
        self._stated = config.dither_frequencies[0] if config.dither_frequencies else None
        self._has_found = False
        self._elapsed = 0.0
        self._lags = 0
        # A sphere's modulus would need its depth.
        geometry = config.geometry
        self._is_flat = not stands_against(geometry) and geometry.strain_slope(0.0) > 0.0
        self._modulus_per_stiffness = geometry.length * geometry.stress_per_force
        self._forget()

    def _forget(self) -> None:
        """Forget all but the numbers."""
        self._frequency = PalpationFrequency()
        self._stiffness = LocalStiffness()
        self._phase = PhaseMeter()
        self._start_ns: int | None = None
        self._meter: ComplexModulusMeter | None = None
        self._meter_frequency = 0.0
        self._window = Window()
        self._found: Palpated | None = None
        self._found_ns = 0

    @property
    def warnings(self) -> dict[str, int]:
        """What was odd, in words, and how often."""
        is_silent = self._elapsed > _SILENT_TIME and not self._has_found
        counts = {
            "no oscillation of the displacement between 0.4 and 5 Hz was found, sampled 16 times "
            "a period, so no stiffness: contact.mode continuous wants a probe that palpates": (
                is_silent
            ),
            "the force follows the displacement out of step with any tissue: is "
            "displacement.delay right?": self._lags,
        }
        return {words: int(count) for words, count in counts.items() if count}

    # Samples

    def add(self, pair: Pair, input_flags: Callable[[], Flag], rejected: int) -> list[Output]:
        """Take a pair; return what comes of it.

        `input_flags` gives those since the last state, `rejected` is the count of samples rejected
        so far.
        """
        if self._start_ns is None:
            self._start_ns = pair.stamp_ns
            self._blocks.restart(pair.stamp_ns)
        outputs: list[Output] = []
        time = self._elapsed = (pair.stamp_ns - self._start_ns) / NANOSECONDS
        displacement = pair.displacement - self._config.contact.series_compliance * pair.force
        modulus = self._measure(time, displacement, pair.force)
        if modulus is not None:
            outputs += self._close_window(modulus, pair.stamp_ns, rejected)
        self._window.add(pair)
        if self._blocks.passes(pair.stamp_ns):
            outputs.append(self._state(pair.stamp_ns, displacement, input_flags()))
        return outputs

    def _measure(self, time: float, displacement: float, force: float) -> ComplexModulus | None:
        """Return k of the window that ends before this sample, in N/m, if one does."""
        self._frequency.add(time, displacement)
        frequency = self._stated or self._frequency.value
        if frequency is None:
            self._meter = None
            return None
        if self._meter is None or frequency != self._meter_frequency:
            least = _LEAST_AMPLITUDE * self._config.geometry.length
            tones = [frequency * harmonic for harmonic in _HARMONICS]
            self._meter = ComplexModulusMeter(tones, _PERIODS, least)
            self._meter_frequency = frequency
            self._window = Window()
        omega = 2.0 * math.pi * frequency
        found = [
            one
            for one in self._meter.add(time, displacement, force)
            if math.isclose(one.angular_frequency, omega)
        ]
        return found[0] if found else None

    def _close_window(self, modulus: ComplexModulus, stamp_ns: int, rejected: int) -> list[Output]:
        window, self._window = self._window, Window()
        config, amplitude = self._config, modulus.strain_amplitude
        self._has_found = True
        self._stiffness.add(complex(modulus.storage, modulus.loss), amplitude, modulus.sd)
        value = self._stiffness.value()
        self._found = value and palpated(
            value,
            modulus.angular_frequency,
            amplitude,
            config.apparent_stiffness_time_scale,
            config.estimator,
            self._stiffness.windows * modulus.samples,
        )
        self._found_ns = stamp_ns
        outputs = self._follow(window, stamp_ns, rejected)
        if self._found is None or self._place is None:
            return outputs
        self._lags += bool(self._found.estimate.at_edge)
        if self._is_flat:
            outputs.append(self._modulus(window, modulus, self._found.stiffness, stamp_ns))
        return outputs

    # Places

    def _follow(self, window: Window, stamp_ns: int, rejected: int) -> list[Output]:
        """Give a window to its place; return the summary of one that the probe has left."""
        outputs: list[Output] = []
        place = self._place
        if place is None or self._is_elsewhere(place, window.position):
            outputs = self._leave(stamp_ns, rejected, complete=True)
            self.place_count += 1
            place = self._place = Place(self.place_count, window.start_ns, window.position)
            place.rejected = rejected
        place.add(window, self._found)
        return outputs

    def _is_elsewhere(self, place: Place, position: Position | None) -> bool:
        if place.first is None or position is None:
            return (place.first is None) != (position is None)
        contact = self._config.contact
        apart = lateral_distance(contact.approach_axis, place.first, position)
        return apart > contact.site_distance

    def _leave(self, stamp_ns: int, rejected: int, *, complete: bool) -> list[Output]:
        place, self._place = self._place, None
        return [self._summary(place, stamp_ns, rejected, complete)] if place is not None else []

    def see_gap(self) -> None:
        """Take note that samples are missing before the next."""
        if self._meter is not None:
            self._meter.reset()
        self._window = Window()
        if self._place is not None:
            self._place.flags |= Flag.GAP

    def end(self, stamp_ns: int, rejected: int, flags: Flag = Flag.NONE) -> list[Output]:
        """Forget all but the numbers; return the summary of the place that is still open.

        `flags` say why it ends.
        """
        if self._place is not None:
            self._place.flags |= flags
        outputs = self._leave(stamp_ns, rejected, complete=False)
        self._forget()
        return outputs

    # Outputs

    def _is_current(self, stamp_ns: int) -> bool:
        if self._meter is None:
            return False
        return stamp_ns - self._found_ns < _CURRENT * self._meter.window * NANOSECONDS

    def _apparent(self, found: Palpated | None) -> ApparentStiffness | None:
        if found is None:
            return None
        time_scale = self._config.apparent_stiffness_time_scale
        return ApparentStiffness(found.apparent, found.apparent_sd, time_scale)

    def _state(self, stamp_ns: int, displacement: float, flags: Flag) -> TissueState:
        found = self._found if self._is_current(stamp_ns) else None
        estimate = found.estimate if found is not None else None
        place = self._place
        own = place.flags if place is not None else Flag.ORIGIN_UNCERTAIN
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.CONVERGING,
            flags=own | flags | edge_flag(estimate),
            site_id=self.place_count,
            contact_id=self.place_count,
            phase=self._phase_at(stamp_ns, displacement),
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate,
            apparent_stiffness=self._apparent(found),
        )

    def _phase_at(self, stamp_ns: int, displacement: float) -> Phase:
        return self._phase.add(stamp_ns, displacement / self._config.geometry.length)

    def _modulus(
        self, window: Window, modulus: ComplexModulus, stiffness: Stiffness, stamp_ns: int
    ) -> DynamicModulus:
        """Return k as a modulus: with the deviation of the filter, and of the thickness."""
        scale = self._modulus_per_stiffness
        thickness_sd = self._config.estimator.uncertainty.thickness_sd * abs(stiffness.value)
        variance = float(stiffness.covariance.diagonal().max()) + thickness_sd**2
        return DynamicModulus(
            stamp_ns=stamp_ns,
            start_ns=window.start_ns,
            site_id=self.place_count,
            contact_id=self.place_count,
            modulus=modulus._replace(
                mean_strain=0.0,
                strain_amplitude=modulus.strain_amplitude / self._config.geometry.length,
                storage=scale * stiffness.value.real,
                loss=scale * stiffness.value.imag,
                sd=scale * math.sqrt(variance),
            ),
        )

    def _summary(
        self, place: Place, stamp_ns: int, rejected: int, complete: bool
    ) -> ContactSummary:
        estimate = place.found.estimate if place.found is not None else None
        count = rejected - place.rejected
        return ContactSummary(
            stamp_ns=stamp_ns,
            start_ns=place.start_ns,
            end_ns=place.end_ns,
            site_id=place.number,
            contact_id=place.number,
            flags=place.flags
            | edge_flag(estimate)
            | (Flag.INPUT_REJECTED if count else Flag.NONE),
            converged=False,
            complete=complete,
            position=place.position,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate,
            max_strain=0.0,
            max_stress=0.0,
            max_force=place.max_force,
            sample_count=place.samples,
            rejected_count=count,
            classes=None,
            apparent_stiffness=self._apparent(place.found),
        )
