# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an estimator takes from the pipeline and gives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Budget, Estimate
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law import Geometry


class Setting(NamedTuple):
    """What is known of a site before the first touch."""

    config: EstimatorConfig
    geometry: Geometry
    noise_sd: float  #: of the stress per sample [Pa]
    contact_point_sd: float = 0.0  #: [1]; 0: known
    path_variance: float = 0.0  #: of the indentation per sample, times the time between them [s]


class Touch(NamedTuple):
    """What is known at a touch."""

    bias_sd: float  #: of the stress's zero [Pa]
    drift_sd: float  #: of its slope [Pa/s]
    #: Motion before the first sample: times, counted from that [s], indentations [1] and stresses
    #: [Pa], (3, n).
    approach: Array


class Innovation(NamedTuple):
    """How the newest block compares with its prediction."""

    predicted_stress: float  #: [Pa]
    innovation: float  #: observed less predicted [Pa]
    variance: float  #: of the innovation [Pa^2]
    predicted_fractional_stress: float = math.nan  #: [Pa s^alpha]; NaN: not known

    @property
    def normalized_squared(self) -> float:
        """Normalised innovation squared (NIS) [1]."""
        return self.innovation**2 / self.variance


class Estimator:
    """The estimator of one site; the pipeline asks for nothing else.

    Attributes
    ----------
    innovation : Innovation or None
        Of the newest block; None: it was not predicted.
    """

    innovation: Innovation | None

    def touch(self, onset: Touch, pause: float) -> None:
        """Begin a press, a time without stress [s] after the last sample."""
        raise NotImplementedError

    def add(
        self,
        times: Sequence[float],
        indentation: Sequence[float],
        stress: Sequence[float],
        on_tissue: Sequence[bool],
        *,
        is_behind: bool = False,
    ) -> Estimate:
        """Take the samples of a block; return the estimate by now.

        Parameters
        ----------
        times : sequence of float
            Since the touch [s].
        indentation, stress : sequence of float
            From the nominal contact point [1]; [Pa].
        on_tissue : sequence of bool
            Whether the probe is on the tissue, as far as is known.
        is_behind : bool
            Newer samples wait: what takes time is put off.
        """
        raise NotImplementedError

    def work(self) -> None:
        """Do what the newest block has made due, once its estimate is published."""

    def settle(self) -> None:
        """Do a part of what the release takes: the probe is off the tissue."""

    def release(self) -> Estimate:
        """End the press; return the estimate."""
        raise NotImplementedError

    @property
    def is_changed(self) -> bool:
        """Whether the tissue under the probe has changed since the touch."""
        return False

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest block is not explained yet."""
        return False

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law."""
        return False

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        return 0.0

    def budget(self) -> Budget | None:
        """Return what makes the estimate uncertain; None: not known."""
        return None
