# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The samples of a contact: into the site's memory, and block by block into outputs."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator

from fden_ros.core.block import BlockSums, PhaseMeter
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.estimator_config import Observation
from fden_ros.core.oscillation.complex_modulus import ComplexModulusMeter
from fden_ros.core.outputs import Flag, Output
from fden_ros.core.plausibility import Plausibility
from fden_ros.core.press import Press
from fden_ros.core.site import Site
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: Samples from before the detection of a touch are made up for within about this time [s].
_CATCH_UP_TIME = 0.03


class InContact:
    """Takes the samples of a contact, and gives what is to be put out.

    Parameters
    ----------
    config : PipelineConfig
    plausibility : Plausibility
        Judges each contact.
    """

    def __init__(self, config: PipelineConfig, plausibility: Plausibility) -> None:
        self._config = config
        self._plausibility = plausibility
        observation = config.estimator.observation
        self._observes_stress = observation is not Observation.FRACTIONAL_STRESS
        self._meter = (
            ComplexModulusMeter(config.dither_frequencies, config.dither_periods)
            if config.dither_frequencies
            else None
        )
        self._sums = BlockSums(config.block_duration, config.block_compression)
        self._phase = PhaseMeter()
        self.forget()

    def forget(self) -> None:
        """Forget the contact, and number the blocks anew."""
        self._behind: deque[Pair] = deque()  # samples that are not taken yet
        self._pace = 1
        self._sums.restart(0)
        self._phase.clear()
        self._blocks = 0

    def interrupt(self) -> None:
        """Begin an oscillation anew: it cannot be followed over missing samples."""
        if self._meter is not None:
            self._meter.reset()

    def drop(self) -> None:
        """Drop the samples that are not taken, or not put out yet."""
        self._behind.clear()
        self._sums.clear()
        self.interrupt()

    def end(self) -> None:
        """Drop the samples of the block that the release cuts."""
        self._sums.clear()

    def passes(self, stamp_ns: int) -> bool:
        """Whether a block's duration has passed without samples; if so the next begins."""
        return self._sums.passes(stamp_ns)

    def begin(self, onset: Onset, press: Press, site: Site) -> Iterator[Output]:
        """Begin with a contact; the samples from before its detection are made up for."""
        first = onset.samples[0]
        self._plausibility.begin(onset)
        self._sums.restart(first.stamp_ns)
        if site.has_failed:
            return
        self._phase.clear()
        self.interrupt()
        self._behind.extend(onset.samples)
        # As many samples at a time that a touch delays no later sample for long.
        lasted = (onset.samples[-1].stamp_ns - first.stamp_ns) / NANOSECONDS
        self._pace = 1 + math.ceil(lasted / _CATCH_UP_TIME)
        yield from self._catch_up(self._pace, press, site)

    def add(self, pair: Pair, press: Press, site: Site) -> Iterable[Output]:
        """Take a sample."""
        if not self._behind:
            return self._add(pair, press, site)
        self._behind.append(pair)
        return self._catch_up(self._pace, press, site)

    def take_all(self, press: Press, site: Site) -> Iterator[Output]:
        """Take every sample that waits."""
        return self._catch_up(len(self._behind), press, site)

    def _catch_up(self, count: int, press: Press, site: Site) -> Iterator[Output]:
        """Take samples that wait since the touch; only of the newest an output is made.

        States of the time before the detection would contradict those put out then, in the air.
        """
        behind = self._behind
        for _ in range(min(count, len(behind))):
            pair = behind.popleft()
            yield from self._add(pair, press, site, is_silent=bool(behind))

    def _add(
        self, pair: Pair, press: Press, site: Site, *, is_silent: bool = False
    ) -> Iterable[Output]:
        force = press.net_force(pair)
        stress = force * self._config.geometry.stress_per_force
        compression = site.compression(self._config.contact.compliance_free(pair, force))
        step = site.seconds_to(pair.stamp_ns)
        is_free = press.leaves_tissue(step, force, compression)
        if not is_free:
            site.left = pair.position
            if site.is_usable and site.is_dragged_over(pair):
                site.withdraw()
                press.flags |= Flag.ORIGIN_UNCERTAIN
        learns = not press.has_ended
        site.add(pair, compression, stress, is_free=is_free, learns=learns)
        moduli: Iterable[Output] = ()
        if self._meter is not None:
            moduli = press.moduli(self._meter, pair.stamp_ns, compression, stress, is_free)
        press.count(force)
        if is_silent:
            moduli = ()
        if not self._sums.add(pair.stamp_ns, step, compression, stress, force, is_free):
            return moduli
        block = self._close_block(pair.stamp_ns, press, site, is_silent=is_silent)
        return itertools.chain(moduli, block)

    def _close_block(
        self, stamp_ns: int, press: Press, site: Site, *, is_silent: bool
    ) -> Iterator[Output]:
        means = self._sums.close(stamp_ns)
        block = site.block_of(means)
        fractional_stress = site.fractional_stress(block)
        self._blocks += 1
        innovation = None
        if site.is_learning and not press.has_ended:
            # Without contact the law does not hold.
            if press.is_informative(means, by_stress=self._observes_stress):
                innovation = site.update(block)
                press.judge()
            else:
                site.skip()
            if not is_silent:
                site.refresh()
        phase = self._phase.add(stamp_ns, block.compression)
        signals = press.signals(block, fractional_stress)
        self.judge_units(stamp_ns, press, site)
        if is_silent:
            return
        yield press.state(stamp_ns, signals, block.compression, phase, innovation)
        for answer in press.label(stamp_ns, self._blocks):
            yield press.classification(stamp_ns, answer)

    def judge_units(
        self, stamp_ns: int, press: Press, site: Site, *, is_over: bool = False
    ) -> None:
        """Withhold the estimate of a contact that cannot be what its units say."""
        if press.has_ended:
            return
        if self._plausibility.is_implausible(
            stamp_ns, press.nominal_strain, press.max_force, press.max_stress, is_over=is_over
        ):
            press.flags |= Flag.IMPLAUSIBLE
            site.withhold(Flag.IMPLAUSIBLE)
