# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the surface moves more than is stated, by one record with the law taken for exact."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.bent_law import LAW, BentLaw, stepped
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.record_noise import RecordNoise

#: How much more the surface moves than is stated is found by steps of this factor, up to this
#: multiple of what is stated [1].
_MOTION_STEP, _MOST_MOTION = 2.0, 16.0
#: Gauss-Newton steps for the evidence of a scale [1].
_EVIDENCE_STEPS = 4
#: Least deviation of alpha in a covariance [1]: that of one that is given exactly.
_LEAST_ORDER_SD = 1e-6

_ORDER, _ORIGIN = StateIndex.FRACTIONAL_ORDER, StateIndex.STRAIN_ORIGIN


class FoundMotion(NamedTuple):
    """What a motion of the surface makes of a record, with the law taken for exact."""

    log_evidence: float  #: by Laplace's approximation [1]
    covariance: Array  #: of ln G, ln Gn and alpha, shape (3, 3)


class MotionSearch:
    """Compares motions of the surface.

    Parameters
    ----------
    law : BentLaw
        Of the record.
    noise : RecordNoise
        Of the record.
    start : ndarray, shape (22,)
        State without any deviation.
    mean : ndarray, shape (4,)
        Of ln G, ln Gn, alpha and strain origin before the data.
    precision : ndarray, shape (4, 4)
        Inverse of their covariance.
    order_sd : float
        Standard deviation of alpha in the estimate [1], which may know it better.
    """

    def __init__(
        self,
        law: BentLaw,
        noise: RecordNoise,
        start: Array,
        mean: Array,
        precision: Array,
        order_sd: float,
    ) -> None:
        self._law, self._noise = law, noise
        self._state = start.copy()
        self._mean, self._precision = mean, precision.copy()
        self._order_sd = max(order_sd, _LEAST_ORDER_SD)

    def log_evidence(self, scales: Sequence[float]) -> list[float]:
        """Return the logarithm of the evidence for scales of the stated motion [1].

        Raises
        ------
        numpy.linalg.LinAlgError
            If the normal equations are singular.
        """
        found = []

        def compare() -> Iterator[None]:
            for scale in scales:
                motion = yield from self._at(scale, 0.0)
                found.append(motion.log_evidence)

        for _ in compare():
            pass
        return found

    def steps(self) -> Generator[None, None, FoundMotion | None]:
        """Find a motion above the stated one, by doubling as long as that helps, step by step.

        In two ways: a wider walk, which is rough as a heartbeat is, or a wave beside it, as smooth
        as a breath. A walk that is wide enough for a wave's data is too narrow for what the wave
        does to G, Gn and alpha, which absorb most of it. Returns None where nothing helps.
        """
        stated = best = yield from self._at(1.0, 0.0)
        for is_wave in (False, True):
            wide, scale = stated, 1.0
            while scale <= _MOST_MOTION:
                walk, wave = (1.0, scale) if is_wave else (_MOTION_STEP * scale, 0.0)
                tried = yield from self._at(walk, wave)
                if tried.log_evidence < wide.log_evidence:
                    break
                wide, scale = tried, _MOTION_STEP * scale
            best = max(best, wide, key=lambda motion: motion.log_evidence)
        return None if best is stated else best

    def _at(self, walk: float, wave: float) -> Generator[None, None, FoundMotion]:
        """Return what a motion makes of the law's parameters, from the last one's maximum on.

        `walk`, `wave`: scale of the walk, and deviation of the wave, both in the stated motion.
        """
        precision = self._precision
        whitening = self._noise.whitening(walk, wave)
        for _ in range(_EVIDENCE_STEPS):
            residual, jacobian = whitening.whiten(*self._law.residual(self._state))
            law, off = jacobian[:, LAW], self._state[LAW] - self._mean
            information = law.T @ law
            factor = cho_factor(information + precision)
            found_at = residual @ residual + off @ precision @ off
            step = cho_solve(factor, law.T @ residual - precision @ off)
            self._state = stepped(self._state, step)
            yield
        volume = np.linalg.slogdet(precision)[1] - 2.0 * np.sum(np.log(factor[0].diagonal()))
        evidence = 0.5 * float(volume - found_at) - whitening.log_volume
        # The fit leaves alpha open; the estimate does not.
        known = precision.copy()
        known[_ORDER, _ORDER] = self._order_sd**-2.0
        return FoundMotion(evidence, np.linalg.inv(information + known)[:_ORIGIN, :_ORIGIN])
