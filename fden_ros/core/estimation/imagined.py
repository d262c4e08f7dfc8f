# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A press that is not made: what the posterior of its record would tell.

Response, error processes, priors and modes are those of the posterior that is given a real record.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.budget import budget_of
from fden_ros.core.estimation.density import Belief
from fden_ros.core.estimation.estimate import Budget
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.loops import Evaluation
from fden_ros.core.estimation.maxima import Solutions, completed, find_maxima
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE as UNSOLVABLE
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.record import Record
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.search import Solved
from fden_ros.core.estimation.unknowns import LAW_PLACES, ORIGIN, Lifetime
from fden_ros.core.law import Geometry


class ImaginedPress:
    """A press into tissue of which a Gaussian is known; only the motion of its record is needed.

    Parameters
    ----------
    stress_sd, zero_sd, compression_sd : float
        Standard deviations of a sample's stress [Pa], of its zero [Pa], of its compression [1].
    origin_sd : float
        Standard deviation of the strain origin [1].
    deepest : float
        Largest compression [1].
    mean, covariance : ndarray, shape (3,), (3, 3)
        Of ln G, ln Gn and alpha; what has no variance is known.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        *,
        stress_sd: float,
        zero_sd: float,
        compression_sd: float,
        origin_sd: float,
        deepest: float,
        mean: Array,
        covariance: Array,
    ) -> None:
        self._setting = PressSetting(
            config,
            config.uncertainty,
            geometry,
            origin_sd,
            stress_sd,
            zero_sd,
            0.0,
            RigKnowledge.stated(config),
        )
        self._strain = geometry.strain(deepest)
        posterior = self._setting.posterior((), compression_sd, deepest)
        self._posterior = _given(posterior, mean, covariance)

    def _state(self, tissue: Array) -> Array:
        state: Array = self._posterior.belief.mean.copy()
        state[LAW_PLACES] = tissue
        return state

    def stress(self, points: Points, tissue: Array) -> Array:
        """Return the stress [Pa] of each block of a record in a tissue (3,)."""
        return self._posterior.model.response(points, self._state(tissue)).stress

    def evaluate(self, points: Points, tissue: Array) -> Evaluation:
        """Return response and derivatives of a record in a tissue (3,)."""
        return self._posterior.evaluate(points, self._state(tissue))

    def variances(
        self,
        points: Points,
        tissue: Array,
        evaluation: Evaluation,
        shares: Array,
        *,
        origin_sd: float,
        observed: int,
        presses: int,
    ) -> Array:
        """Return the variances of ln G, ln Gn and alpha [1] after each of such presses.

        Parameters
        ----------
        tissue : ndarray, shape (3,)
        evaluation : Evaluation
            Of these; its derivative by the origin is scaled.
        shares : ndarray, shape (3,)
            Scales of the law's errors over the stated one [1].
        origin_sd : float
            That the touch shows, in place of that of the press [1].
        observed : int
            Blocks that are observed.

        Returns
        -------
        ndarray, shape (presses, 3)
        """
        setting, posterior, state = self._setting, self._posterior, self._state(tissue)
        kernel, characteristic, roughness = shares * setting.stated.characteristic_sd
        scales = Scales(kernel, characteristic, roughness, 1.0)
        if setting.origin_sd:
            evaluation.jacobian[:, ORIGIN] *= origin_sd / setting.origin_sd
        errors = posterior.error_model.errors(points, state, evaluation)
        white = posterior.error_model.whitened(
            evaluation.jacobian, errors, scales.roughness, scales.motion
        )
        normal = white[:observed].T @ white[:observed]
        prior = posterior.precision(state, scales)
        # Which unknowns are one for all presses, and the law's errors are.
        lasting = [u.lifetime is not Lifetime.CONTACT for u in posterior.model.unknowns]
        lasting += [True] * (posterior.model.size - len(lasting))
        covariances = _repeated(normal, prior, np.array(lasting), presses)
        return np.array([c.diagonal()[LAW_PLACES] for c in covariances])

    def solved(
        self, points: Points, tissue: Array, stress: Array, observed: int
    ) -> Parts[Solutions]:
        """Return the solution, in parts, of a record with a stress that is measured.

        Parameters
        ----------
        tissue : ndarray, shape (3,)
            From which the search begins.
        stress : ndarray, shape (blocks,)
            [Pa].
        observed : int
            Blocks that are observed.
        """
        posterior, strain = self._posterior, self._strain
        own = _until(replace(points, stresses=stress), observed)
        scales = posterior.grid[len(posterior.grid) // 2].scales
        maxima = yield from find_maxima(posterior, own, [self._state(tissue)], scales, (), strain)
        return (yield from completed(posterior, own, maxima, strain))

    def budget(self, solutions: Solutions) -> Budget:
        """Return what makes the estimate of a solution uncertain."""
        solved = Solved(self._posterior, solutions, None, False)
        return budget_of(self._setting, solved)


def _given(posterior: Posterior, mean: Array, covariance: Array) -> Posterior:
    """Return a posterior with what is known of the tissue for a prior."""
    means, precision = posterior.belief.mean.copy(), posterior.belief.precision.copy()
    means[LAW_PLACES] = mean
    unknown = np.flatnonzero(covariance.diagonal() > 0.0)
    block = np.ix_(unknown, unknown)
    precision[block] = np.linalg.inv(covariance[block])
    posterior.belief = Belief(means, precision)
    return posterior


def imagined_record(
    times: Array, compressions: Array, compression_sd: float, reach: float
) -> Points:
    """Return the record of a motion, of which the stresses are 0.

    Parameters
    ----------
    times, compressions : ndarray, shape (n,)
        Of samples: [s] from the touch, [1].
    compression_sd : float
        Noise of a sample [1].
    reach : float
        How far before its nominal place the touch may be, as compression [1].
    """
    own = Record(compression_sd, reach)
    for time, compression in zip(times.tolist(), compressions.tolist(), strict=True):
        own.add(time, compression, 0.0, is_observed=True)
    return own.points()


def _until(points: Points, count: int) -> Points:
    """Return a record of which only the first blocks are observed."""
    names = ("first", "last", "middles", "durations", "counts", "stresses")
    return replace(points, **{name: getattr(points, name)[:count] for name in names})


def _repeated(normal: Array, prior: Array, lasting: Array, presses: int) -> list[Array]:
    """Return the covariances after each press: what a contact alone has begins anew."""
    found = [_inverse(normal + prior)]
    for _ in range(presses - 1):
        before = prior.copy()
        kept = np.ix_(lasting, lasting)
        before[kept] = _inverse(found[-1][kept])
        found.append(_inverse(normal + before))
    return found


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a precision."""
    root = np.linalg.inv(np.linalg.cholesky(matrix))
    if not np.isfinite(root).all():
        raise np.linalg.LinAlgError("the precision is not finite")
    return root.T @ root
