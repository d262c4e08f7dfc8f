# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an estimator offers the pipeline, the blocks it takes, and its innovations."""

from __future__ import annotations

from typing import NamedTuple

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Budget, Estimate


class Block(NamedTuple):
    """Means over a block of samples."""

    compression: float  #: u, from the nominal strain origin [1]
    stress: float  #: f [Pa]
    memory_time: float  #: t since the memory began [s]
    size: int  #: samples in the block
    duration: float  #: from the first sample to the last and one step more [s]
    memory: Array  #: of the stress, as :meth:`~..law.stress_memory.StressMemory.means` gives it
    is_past: bool = False  #: later samples have come already, and are made up for


class Innovation(NamedTuple):
    """How one block compared with its prediction."""

    predicted_fractional_stress: float  #: [Pa s^alpha]
    predicted_stress: float  #: [Pa]
    innovation: float  #: observed less predicted [Pa]
    variance: float  #: of the innovation [Pa^2]

    @property
    def normalized_squared(self) -> float:
        """Normalised innovation squared (NIS) [1]."""
        return self.innovation**2 / self.variance


class Estimator:
    """An observation model with its filter; the pipeline asks for nothing else.

    One that has no use for something leaves it as it is here.
    """

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law."""
        return False

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest data are not explained yet."""
        return False

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        return 0.0

    def budget(self) -> Budget | None:
        """Return what makes the estimate uncertain; None: not known."""
        return None

    def begin_contact(self, bias_sd: float, drift_sd: float, way: Array | None = None) -> None:
        """Start a contact whose stress has a bias [Pa] and a drift [Pa/s] of its own.

        `way`: of the probe, before the first sample: times, counted from that [s], compressions
        [1] and stresses [Pa], shape (3, n).
        """

    def take(self, step: float, compression: float, stress: float, *, is_free: bool) -> None:
        """Take a sample of a contact, `step` seconds after the last.

        `is_free`: its stress tells nothing of the tissue, which is not on the probe, as far as is
        known, or comes off a round one.
        """

    def rest(self, duration: float) -> None:
        """Let time [s] pass between two contacts."""

    def skip(self) -> None:
        """Let the samples since the last block go by."""

    def update(self, block: Block) -> Innovation | None:
        """Take one block; return how it compared with the prediction; None: it was not used.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        raise NotImplementedError

    def put_away(self) -> None:
        """Keep of the last contact what the next one goes on from."""

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        raise NotImplementedError

    def begin_finish(self) -> None:
        """Begin to bring the estimate to its best at the end of a contact."""

    @property
    def is_working(self) -> bool:
        """Whether that is under way."""
        return False

    def work(self, seconds: float) -> None:
        """Go on with that by the work of a time without samples [s]."""

    def finish(self) -> None:
        """Bring the estimate to its best at the end of a contact, as was begun."""
