# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that stays on the tissue: the stiffness of each place on the path of its palpation.

The contact point and the tissue's history are not known, so there is no strain, and no G. An
oscillation of the probe needs neither: it shows the stiffness dF/dd at its frequency, alpha by its
phase, and with a flat geometry the complex modulus. The trend of each window absorbs
the bias of the force, relaxation, drift and the height of the surface.

A *place* ends when the probe has moved on by `site_distance` to the side; each is a site with one
contact, so summaries, map and table hold the path.
"""

from __future__ import annotations

import math
from collections import Counter

from fden_ros.core.block import BlockSums, PhaseMeter
from fden_ros.core.config import PipelineConfig
from fden_ros.core.oscillation import (
    LEAST_AMPLITUDE,
    ComplexModulus,
    Palpated,
    PalpationMeter,
    Stiffness,
)
from fden_ros.core.outputs import (
    ContactSummary,
    DynamicModulus,
    Flag,
    Output,
    Status,
    TissueState,
    estimate_flags,
    order_source,
)
from fden_ros.core.plausibility import stands_against
from fden_ros.core.streams import NANOSECONDS, Pair, Position

#: Time without an oscillation [s] after which it is missed.
_SILENT_TIME = 10.0


class _MeanPosition:
    """The mean of positions, where all are known."""

    def __init__(self) -> None:
        self._sum, self._count, self._is_known = (0.0, 0.0, 0.0), 0, True

    def add(self, position: Position | None) -> None:
        """Add a position [m]."""
        if position is None:
            self._is_known = False
            return
        x, y, z = (a + b for a, b in zip(self._sum, position, strict=True))
        self._sum = (x, y, z)
        self._count += 1

    @property
    def value(self) -> Position | None:
        """The mean [m]; None where a position is not known."""
        if not (self._is_known and self._count):
            return None
        x, y, z = (value / self._count for value in self._sum)
        return x, y, z


class Stretch:
    """What is gathered over some time: of a window of the palpation, or of a place."""

    def __init__(self, start_ns: int) -> None:
        self.start_ns = self.end_ns = start_ns
        self.samples = 0
        self.max_force = 0.0
        self.position = _MeanPosition()

    def _add(self, end_ns: int, samples: int, force: float, position: Position | None) -> None:
        self.end_ns = end_ns
        self.samples += samples
        self.max_force = max(self.max_force, force)
        self.position.add(position)


class Window(Stretch):
    """The samples of one window of the palpation."""

    def take(self, pair: Pair) -> None:
        """Add a sample."""
        self._add(pair.stamp_ns, 1, pair.force, pair.position)


class Place(Stretch):
    """What is gathered at one place of the path."""

    def __init__(self, number: int, window: Window, rejected: int) -> None:
        super().__init__(window.start_ns)
        self.number = number
        self.first = window.position.value
        self.flags = Flag.TOUCH_NOT_OBSERVED
        self.rejected = rejected  #: samples before it
        self.found: Palpated | None = None

    def take(self, window: Window, found: Palpated | None) -> None:
        """Add a window of this place."""
        self._add(window.end_ns, window.samples, window.max_force, window.position.value)
        self.found = found if found is not None else self.found


class ContinuousSession:
    """From pairs to states, moduli and one summary per place."""

    #: No touch is detected.
    in_contact = never_lifts = False
    air_events = (0, 0, False)
    surface = math.nan
    air = 0.0, 0.0, 0.0, 0.0

    def __init__(self, config: PipelineConfig, rejected: Counter[str]) -> None:
        self._config, self._rejected = config, rejected
        self.site_count = 0  #: places so far: number of the newest
        self._place: Place | None = None
        # A sphere's modulus would need its depth.
        geometry = config.geometry
        self._is_flat = not stands_against(geometry) and geometry.strain_slope(0.0) > 0.0
        self._modulus_per_stiffness = geometry.length * geometry.stress_per_force
        self.forget()

    def withdraw(self, flag: Flag) -> None:
        """Do nothing: no contact is known."""

    def forget(self, *, keeps_contact: bool = False) -> None:
        """Reset all but the numbers of the places."""
        self._blocks = BlockSums(self._config.block_duration, math.inf)
        self._has_found = False
        self._elapsed = 0.0
        self._lags = 0
        self._out_of_step: str | None = None
        self._restart()

    def _restart(self) -> None:
        """Look for an oscillation anew."""
        config, frequencies = self._config, self._config.dither_frequencies
        self._meter = PalpationMeter(
            frequencies[0] if frequencies else None,
            LEAST_AMPLITUDE * config.geometry.length,
            config.apparent_stiffness_time_scale,
            config.estimator,
        )
        self._phase = PhaseMeter()
        self._start_ns: int | None = None
        self._window = Window(0)

    def zero(self) -> str:
        """Return why there is no force in the air."""
        return "contact.mode is continuous: the zero of the force does not matter"

    @property
    def contact_count(self) -> int:
        """Places so far."""
        return self.site_count

    @property
    def place(self) -> tuple[int, int]:
        """Number of the present place, as a site and as a contact; 0: there is none."""
        return self.site_count, self.site_count

    @property
    def warnings(self) -> dict[str, int]:
        """Problems, in words, with counts."""
        is_silent = self._elapsed > _SILENT_TIME and not self._has_found
        counts = {
            "no oscillation of the displacement between 0.4 and 5 Hz, with 16 samples per period, "
            "was found, so there is no stiffness. contact.mode continuous needs a probe that "
            "palpates: sliding alone does not separate stiffness from the surface's height": (
                is_silent
            ),
            self._out_of_step
            or "no tissue has the phase of this force: is displacement.delay right?": self._lags,
        }
        return {words: int(count) for words, count in counts.items() if count}

    # Samples

    def take(self, pair: Pair) -> list[Output]:
        """Add a pair; return its outputs."""
        if self._start_ns is None:
            self._start_ns = pair.stamp_ns
            self._blocks.restart(pair.stamp_ns)
        outputs: list[Output] = []
        time = self._elapsed = (pair.stamp_ns - self._start_ns) / NANOSECONDS
        displacement = self._config.contact.compliance_free(pair, pair.force)
        measured = self._meter.add(time, displacement, pair.force)
        if measured is not None:
            outputs += self._close_window(*measured, pair.stamp_ns)
        if self._meter.begins_window or not self._window.samples:
            self._window = Window(pair.stamp_ns)
        self._window.take(pair)
        if self._blocks.passes(pair.stamp_ns):
            outputs.append(self._state(pair.stamp_ns, time, displacement))
        return outputs

    def _close_window(
        self, modulus: ComplexModulus, found: Palpated | None, stamp_ns: int
    ) -> list[Output]:
        window, self._has_found = self._window, True
        outputs = self._follow(window, found, stamp_ns)
        self._out_of_step = self._out_of_step or self._meter.out_of_step
        if found is None:
            self._lags += self._meter.out_of_step is not None
            return outputs
        self._lags += bool(found.estimate.at_edge)
        if self._is_flat and found.apparent is not None:
            outputs.append(self._modulus(window, modulus, found.stiffness, stamp_ns))
        return outputs

    # Places

    def _follow(self, window: Window, found: Palpated | None, stamp_ns: int) -> list[Output]:
        """Add a window to its place; return the summary of a place that the probe has left."""
        outputs: list[Output] = []
        place, position = self._place, window.position.value
        if place is None or self._is_elsewhere(place, position):
            outputs = self._leave(stamp_ns, complete=True)
            self.site_count += 1
            place = self._place = Place(self.site_count, window, self._rejected.total())
        place.take(window, found)
        return outputs

    def _is_elsewhere(self, place: Place, position: Position | None) -> bool:
        if place.first is None or position is None:
            return (place.first is None) != (position is None)
        return self._config.is_apart(place.first, position)

    def _leave(self, stamp_ns: int, *, complete: bool) -> list[Output]:
        place, self._place = self._place, None
        return [self._summary(place, stamp_ns, complete)] if place is not None else []

    def see_gap(self, before_ns: int, *, is_long: bool) -> list[Output]:
        """Handle samples missing since a stamp; a long gap ends the place."""
        if is_long:
            return self.break_off(before_ns)
        self._meter.skip()
        if self._place is not None:
            self._place.flags |= Flag.GAP
        return []

    def break_off(self, stamp_ns: int) -> list[Output]:
        """Return the summary of the place that is still open; look for an oscillation anew."""
        outputs = self._leave(stamp_ns, complete=False)
        self._restart()
        return outputs

    finish = break_off

    def fail(self, stamp_ns: int) -> list[Output]:
        """End the place after an exception."""
        if self._place is not None:
            self._place.flags |= Flag.ESTIMATION_FAILED
        return self.break_off(stamp_ns)

    # Outputs

    def _state(self, stamp_ns: int, time: float, displacement: float) -> TissueState:
        found = self._meter.current(time)
        estimate = found.estimate if found is not None else None
        place = self._place
        own = place.flags if place is not None else Flag.TOUCH_NOT_OBSERVED
        return TissueState(
            stamp_ns=stamp_ns,
            status=Status.CONVERGING,
            flags=own | estimate_flags(estimate),
            site_id=self.site_count,
            contact_id=self.site_count,
            phase=self._phase.add(stamp_ns, displacement / self._config.geometry.length),
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate,
            apparent_stiffness=found.apparent if found is not None else None,
        )

    def _modulus(
        self, window: Window, modulus: ComplexModulus, stiffness: Stiffness, stamp_ns: int
    ) -> DynamicModulus:
        """Return k as a modulus, with the deviation of the filter and of the thickness."""
        scale = self._modulus_per_stiffness
        thickness_sd = self._config.estimator.uncertainty.thickness_sd * abs(stiffness.value)
        variance = float(stiffness.covariance.diagonal().max()) + thickness_sd**2
        return DynamicModulus(
            stamp_ns=stamp_ns,
            start_ns=window.start_ns,
            site_id=self.site_count,
            contact_id=self.site_count,
            modulus=modulus._replace(
                mean_strain=math.nan,
                strain_amplitude=modulus.strain_amplitude / self._config.geometry.length,
                storage=scale * stiffness.value.real,
                loss=scale * stiffness.value.imag,
                sd=scale * math.sqrt(variance),
            ),
        )

    def _summary(self, place: Place, stamp_ns: int, complete: bool) -> ContactSummary:
        estimate = place.found.estimate if place.found is not None else None
        count = self._rejected.total() - place.rejected
        return ContactSummary(
            stamp_ns=stamp_ns,
            start_ns=place.start_ns,
            end_ns=place.end_ns,
            site_id=place.number,
            contact_id=place.number,
            flags=place.flags
            | estimate_flags(estimate)
            | (Flag.INPUT_REJECTED if count else Flag.NONE),
            converged=False,
            complete=complete,
            position=place.position.value,
            order_source=order_source(estimate, self._config.estimator),
            estimate=estimate,
            max_strain=0.0,
            max_stress=0.0,
            max_force=place.max_force,
            sample_count=place.samples,
            rejected_count=count,
            classes=None,
            apparent_stiffness=place.found.apparent if place.found is not None else None,
        )
