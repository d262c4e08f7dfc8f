# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the state before the data: mean and covariance, independent or correlated."""

from __future__ import annotations

import numpy as np

from fden_ros.core.arrays import Array, Indices


class StatePrior:
    """A normal prior of n parameters.

    A parameter whose deviation is 0 is known and is not solved for.

    Parameters
    ----------
    mean : ndarray, shape (n,)
    deviations : ndarray, shape (n,)
        Standard deviations, in the parameters' units.
    """

    def __init__(self, mean: Array, deviations: Array) -> None:
        self.mean = mean.copy()
        self.deviations = deviations.copy()
        self._correlation = np.eye(mean.size)
        self._scaled_precision = np.eye(mean.size)

    def set(self, index: int, mean: float, deviation: float) -> None:
        """Make one parameter independent of the others, with this mean and deviation."""
        self.mean[index] = mean
        self.deviations[index] = deviation
        for matrix in (self._correlation, self._scaled_precision):
            matrix[index, :] = matrix[:, index] = 0.0
            matrix[index, index] = 1.0

    def set_group(self, indices: Indices, mean: Array, covariance: Array) -> None:
        """Give k parameters a joint prior, independent of the others.

        Parameters
        ----------
        indices : ndarray, shape (k,)
        mean : ndarray, shape (k,)
        covariance : ndarray, shape (k, k)
            Positive definite.
        """
        deviations = np.sqrt(covariance.diagonal())
        for index, value, deviation in zip(indices, mean, deviations, strict=True):
            self.set(int(index), float(value), float(deviation))
        correlation = covariance / np.outer(deviations, deviations)
        self._correlation[np.ix_(indices, indices)] = correlation
        self._scaled_precision[np.ix_(indices, indices)] = np.linalg.inv(correlation)

    @property
    def covariance(self) -> Array:
        """Covariance of all parameters, shape (n, n)."""
        return self._correlation * np.outer(self.deviations, self.deviations)

    @property
    def learned(self) -> Indices:
        """Indices of the parameters that are not known, shape (free,)."""
        return np.flatnonzero(self.deviations > 0.0)

    def precision(self, free: Indices) -> Array:
        """Return the precision of some parameters while the others are known.

        Parameters
        ----------
        free : ndarray, shape (free,)
            Indices of parameters whose deviations are not 0.

        Returns
        -------
        ndarray, shape (free, free)
        """
        deviations = self.deviations[free]
        scaled = self._scaled_precision[np.ix_(free, free)]
        precision: Array = scaled / np.outer(deviations, deviations)
        np.fill_diagonal(precision, scaled.diagonal() * deviations**-2.0)
        return precision

    def distance(self, states: Array, free: Indices) -> Array:
        """Return the squared Mahalanobis distance of some parameters from their mean.

        Parameters
        ----------
        states : ndarray, shape (..., n)
        free : ndarray, shape (free,)

        Returns
        -------
        ndarray, shape (...)
        """
        deviation = (states - self.mean)[..., free] / self.deviations[free]
        weighted = deviation @ self._scaled_precision[np.ix_(free, free)]
        distance: Array = np.sum(deviation * weighted, axis=-1)
        return distance
