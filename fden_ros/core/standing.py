# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The flags of a site's estimate, and what may be claimed with them."""

from __future__ import annotations

import enum

from fden_ros.core.estimation import Estimate, EstimatorConfig, ParameterSet, widened
from fden_ros.core.outputs import WITHHELD, Flag


class SiteState(enum.IntEnum):
    """Whether the tissue's past is known; it never goes back."""

    OBSERVED = 0  #: from the first touch on, or that the tissue was at rest before
    UNOBSERVED = 1  #: touch or past not seen, dragged, or a long gap
    FAILED = 2  #: by an exception


class Standing:
    """The newest estimate of a site, without what its flags exclude."""

    def __init__(self, config: EstimatorConfig, flags: Flag) -> None:
        self.state = SiteState.OBSERVED
        self.flags = flags  #: of every estimate of the site
        self.estimate: Estimate | None = None  #: with the claims that the flags allow
        self._estimator_config = config
        self._own: Estimate | None = None  # of the data alone
        self._variance_factor = 1.0

    @property
    def is_observed(self) -> bool:
        """Whether the tissue's past is known, so that an estimate can be right."""
        return self.state is SiteState.OBSERVED

    @property
    def usable_estimate(self) -> Estimate | None:
        """The newest estimate, where the history has been seen."""
        return self.estimate if self.is_observed else None

    def find(self, own: Estimate | None) -> None:
        """Set the newest estimate of the data alone."""
        self._own = found = own
        if found is not None and self._variance_factor != 1.0:
            found = widened(self._estimator_config, found, self._variance_factor)
        if found is not None and self.flags & WITHHELD:
            found = found._replace(known=ParameterSet.NONE)
        self.estimate = found

    def doubt(self, flag: Flag, variance_factor: float = 1.0) -> None:
        """Apply a contradiction: raise a flag and widen the covariance by a factor."""
        self.flags |= flag
        self._variance_factor = max(self._variance_factor, variance_factor)
        self.find(self._own)

    def withdraw(self, flag: Flag = Flag.TOUCH_NOT_OBSERVED) -> None:
        """Invalidate the site: the tissue under the probe has a past that was not seen."""
        self._go(SiteState.UNOBSERVED, flag)

    def fail(self) -> None:
        """Invalidate the site after an exception."""
        self._go(SiteState.FAILED, Flag.ESTIMATION_FAILED)
        self.find(None)

    def _go(self, state: SiteState, flag: Flag) -> None:
        self.state = max(self.state, state)
        self.flags |= flag
