# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether another law describes the tissue: a relaxation with a plateau, by its evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.special import expit

from fden_ros.core.estimation.filter import Filter
from fden_ros.core.estimation.grid import Grid, begun, laid, log_evidence_of, prior_of_log_g
from fden_ros.core.estimation.law import Plateau

#: It is asked for anew where the time of the press has grown by this factor, and at its end [1].
_GROWTH, _GROWTH_END = 2.0, 1.25
#: Rounds of a question [1].
_ROUNDS = 8


class Rival:
    """The plateau, of the record of a press: one round a block.

    Attributes
    ----------
    probability : float
        Of the plateau, against the law [1]; NaN: it was not asked for.
    """

    def __init__(self) -> None:
        self.probability = math.nan
        self._can_tell = False
        self._asked_at = 0.0
        self._grid: Grid | None = None
        self._rounds = 0

    def see(self, state: Filter, *, can_tell: bool) -> None:
        """Take a new grid of the law; `can_tell`: the press shows a relaxation."""
        self._can_tell = can_tell and not state.grid.law.config.is_order_given
        if not can_tell:
            self._grid = None

    def is_due(self, elapsed: float) -> bool:
        """Whether a round is due, at the time of the law's newest grid [s]."""
        if not self._can_tell:
            return False
        if self._grid is not None and self._rounds < _ROUNDS and not self._grid.is_settled:
            return True
        if elapsed < _GROWTH * self._asked_at:
            return False
        self._asked_at, self._rounds = elapsed, 0
        return True

    def lay(self, state: Filter) -> None:
        """Lay one round, of the record of the law's newest grid."""
        own = state.grid
        if not own.is_settled:
            return
        one, before = own.law, self._grid
        law = Plateau(one.config, one.geometry, one.place, one.rig, one.contact_point_sd)
        # A law that is softer where nothing was seen would have less noise of the motion: by
        # that alone tissue of an order of 0.55 was e^7 times likelier to have a plateau.
        noise = own.noise._replace(beside=own.covariance)
        if before is None or before.law.last_knot != law.last_knot:
            (start,) = begun(law, noise)
        else:
            # The law's grid may be of a longer record by now.
            start = before.after._replace(about=law.stressed(before.after.about))
            if not self._rounds:
                start = start._replace(is_continued=before.is_settled, rounds=0)
        try:
            self._grid = laid(law, noise, start)
        except np.linalg.LinAlgError:
            self._rounds = _ROUNDS
            return
        self._rounds += 1
        if self._grid.is_settled:
            self.probability = _probability(state.grid, self._grid)

    def end(self, state: Filter, elapsed: float) -> Iterator[None]:
        """Lay all rounds, one at a time, at the end of a press after this time [s]."""
        is_settled = self._grid is not None and self._grid.is_settled
        if not self._can_tell or (is_settled and elapsed < _GROWTH_END * self._asked_at):
            return
        # One at least: the record is longer than that of the round before.
        self._rounds, is_settled = 0, False
        while not is_settled and self._rounds < _ROUNDS and state.grid.is_settled:
            self.lay(state)
            yield
            is_settled = self._grid is not None and self._grid.is_settled


def _probability(law: Grid, rival: Grid) -> float:
    """Return the probability of a rival.

    Both count as if ln G were known before to 1 about what the law says: what is stated of a
    tissue must not decide between two laws. A rival that fits no better contradicts nothing: a
    law whose alpha the data know well is less likely before.
    """
    fits = float(rival.stiffness.log.max() - law.stiffness.log.max())
    return float(expit(min(_level(rival, law) - _level(law, law), fits)))


def _level(grid: Grid, law: Grid) -> float:
    mean, sd = prior_of_log_g(grid.law)
    about = float(law.weights @ law.stiffness.log_g)
    own = float(grid.weights @ grid.stiffness.log_g)
    spread = float(grid.weights @ (grid.stiffness.variance + (grid.stiffness.log_g - own) ** 2))
    stated = -0.5 * (((own - mean) ** 2 + spread) / sd**2) - math.log(sd)
    evidence = log_evidence_of(grid.law, grid.stiffness.log + grid.log_prior)
    return evidence - stated - 0.5 * ((own - about) ** 2 + spread)
