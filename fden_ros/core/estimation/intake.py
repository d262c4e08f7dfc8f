# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The samples of one press on their way into its record."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Block, Sample
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.record import Record


class Intake:
    """Takes the samples of one press.

    Parameters
    ----------
    settings : sequence of PressSetting
        Of its hypotheses.
    start : float
        Time of the touch [s].
    compression_sd : float
        Standard deviation of a sample's compression [1]; 0: not known yet.
    path_variance : float
        Of the compression per sample, times the time between samples [s].
    way : ndarray, shape (3, n), optional
        Of the probe before the touch: times from it [s], compressions [1] and stresses [Pa].

    Attributes
    ----------
    deepest : float
        Largest compression of the press [1].
    now : float
        Time of the newest sample in the record [s].
    """

    def __init__(
        self,
        settings: Sequence[PressSetting],
        start: float,
        compression_sd: float = 0.0,
        path_variance: float = 0.0,
        way: Array | None = None,
    ) -> None:
        is_one_sided = settings[0].geometry.is_one_sided
        # As many of the origin's standard deviations before its nominal place the touch may be.
        reach = 6.0 * max(one.origin_sd for one in settings) if is_one_sided else 0.0
        is_at_rest = is_one_sided and any(one.carried is None for one in settings)
        self.record = Record(compression_sd, reach, is_at_rest=is_at_rest)
        if way is not None and (reach or is_at_rest):
            self.record.see_way(way + np.array([[start], [0.0], [0.0]]))
        self.deepest, self.compression_sd, self.now = -math.inf, compression_sd, start
        self._path_variance, self._steps, self._stepped = path_variance, 0, 0.0
        self._samples: list[Sample] = []
        self._is_pressed = False

    def take(self, sample: Sample, step: float, *, is_free: bool) -> None:
        """Take a sample, `step` seconds after the last."""
        self._steps += step > 0.0
        self._stepped += max(step, 0.0)
        if self._path_variance and self._steps:
            # By the mean step: the last alone may be short.
            own = math.sqrt(self._path_variance * self._steps / self._stepped)
            self.compression_sd, self.record.noise_sd = own, self.record.noise_sd or own
        self.now = sample.time
        self._is_pressed |= not is_free
        is_observed = not (is_free and self._is_pressed)
        self.record.add(*sample, is_observed=is_observed)
        if is_observed:
            self._samples.append(sample)
            self.deepest = max(self.deepest, sample.compression)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._samples = []

    def blocks(self) -> list[Block]:
        """Return the blocks of the samples since the last."""
        samples, self._samples = self._samples, []
        return self.record.blocks(samples) if samples else []
