# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When the deviation from the law is fitted: a step per block, and the rest at the end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import Prior, Uncertainty
from fden_ros.core.estimation.law_deviation import LawDeviation
from fden_ros.core.estimation.law_fit import LawFit, is_enough
from fden_ros.core.estimation.motion_scale import SCALES
from fden_ros.core.law.geometry import Geometry

#: The first fit begins after this time in contact [s], and every later one when it has lasted
#: longer by this factor [1]: the fits of a contact cost no more than three of the whole.
_FIRST_FIT, _LATER_FIT = 2.0, 1.5
#: While the loading's age is below this share of the contact's duration [1], kernel and curve
#: cannot be told apart: fits to the ramp alone called 6 of 10 presses of beef a mismatch.
_HOLD_SHARE = 0.4
#: Time of the data for which one step of a fit is done [s], so that a slow stream waits no longer
#: for it.
_STEP_TIME = 0.01


class LawWatch:
    """Follows the first contact of a site, which alone begins at rest.

    Parameters
    ----------
    geometry : Geometry
    prior : Prior
    uncertainty : Uncertainty
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1].

    Attributes
    ----------
    deviation : LawDeviation or None
        The newest; None before the first fit has ended.
    """

    def __init__(
        self,
        geometry: Geometry,
        prior: Prior,
        uncertainty: Uncertainty,
        noise_sd: float,
        origin_sd: float,
    ) -> None:
        self.deviation: LawDeviation | None = None
        self._geometry = geometry
        self._prior = prior
        self._uncertainty = uncertainty
        self._noise_sd, self._origin_sd = noise_sd, origin_sd
        self._record = ContactRecord()
        self._contacts = 0
        self._is_over = False
        self._next_fit = _FIRST_FIT
        #: Steps of a fit for each block.
        self._pace = 1
        self._fit: LawFit | None = None
        self._steps: Iterator[None] = iter(())
        self._begin_at: Array | None = None  # state from which the next fit begins
        self._is_ahead = False  # the step that the next block asks for is done
        self._result: LawDeviation | None = None  # of that step, if it was the last

    def begin_contact(self) -> None:
        """Start a contact."""
        self._contacts += 1
        if self._contacts > 1:
            self.stop()

    def stop(self) -> None:
        """Record no more: this contact is that of one tissue no longer."""
        self._is_over = True
        self._drop()

    def _drop(self) -> None:
        """Give up the fit under way."""
        self._fit = self._begin_at = self._result = None
        self._is_ahead = False

    def add(self, block: Block, age: float, state: Array) -> None:
        """Take a block where the loading is of `age` [s]; `state`: ln G, ln Gn, alpha, origin."""
        if self._is_over:
            return
        self.work_ahead()
        self._record.add(block, age)
        self._pace = max(1, round(block.duration / _STEP_TIME))
        if self._is_ahead:
            self._is_ahead = False
            self._publish()
            return
        duration = self._record.duration
        if duration >= self._next_fit and age >= _HOLD_SHARE * duration:
            self._next_fit = _LATER_FIT * duration
            self._begin_at = state.copy()

    def work_ahead(self) -> None:
        """Do the step of the fit that the next block asks for, unless it is done.

        The same comes of it whenever between two blocks it is called, or if it is not.
        """
        if self._begin_at is not None:
            self._begin(self._begin_at)
            self._begin_at = None
            self._advance()
        if self._fit is not None and not self._is_ahead:
            self._advance()
            self._is_ahead = True

    def _publish(self) -> None:
        if self._result is not None:
            self.deviation, self._result = self._result, None

    def finish(self, state: Array) -> None:
        """Fit to all that was recorded, at the end of a contact."""
        if self._is_over:
            return
        self._drop()
        self._begin(state)
        while self._fit is not None:
            self._advance()
        self._publish()

    def motion_evidence(self, state: Array, uncertainty: Uncertainty) -> list[float] | None:
        """Return the evidence for scales of the surface's motion; None where there is none.

        `state`: ln G, ln Gn, alpha, origin; `uncertainty`: of the rig, with the stated motion.
        """
        if self._is_over or not is_enough(self._record):
            return None
        try:
            evidence = self._new_fit(state, uncertainty).motion_evidence(SCALES)
        except (np.linalg.LinAlgError, ValueError):
            return None
        return evidence if np.all(np.isfinite(evidence)) else None

    def _begin(self, state: Array) -> None:
        if not is_enough(self._record):
            return
        self._fit = self._new_fit(state, self._uncertainty)
        self._steps = self._fit.steps()

    def _new_fit(self, state: Array, uncertainty: Uncertainty) -> LawFit:
        return LawFit(
            self._record,
            self._noise_sd,
            self._geometry,
            self._prior,
            uncertainty,
            state,
            self._origin_sd,
        )

    def _advance(self) -> None:
        """Do some steps of the fit under way; one that fails says nothing."""
        if self._fit is None:
            return
        try:
            for _ in range(self._pace):
                next(self._steps)
        except StopIteration:
            self._result = self._fit.result()
            self._fit = None
        except (np.linalg.LinAlgError, ValueError):
            self._fit = None
