# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The plane of a surface through the places at which a probe touched it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import chi2
from scipy.stats import t as student

from fden_ros.core.arrays import Array

#: A normal is stated up to this standard deviation of each of its two tilts [rad]: at a tilt of
#: 10 degrees it then costs 0.6 % of the depth.
LARGEST_SD = math.radians(2.0)
#: Without stated deviations the touches' own scatter counts, which takes this number of them.
LEAST_TOUCHES, LEAST_UNSTATED = 3, 5
#: Across their longest line, touches spread by this root mean square [m], and by this share of
#: the spread along it; else they lie on one line.
_LEAST_SPREAD, _LEAST_SHARE = 1e-3, 0.1
#: On a paraboloid the slopes scatter by about this factor times the distances from the plane over
#: the spread of the touches; beyond this angle [rad] the surface has no one normal.
_SLOPE_FACTOR, _CURVED = 2.0, math.radians(5.0)
#: A plane explains the distances where chi-squared exceeds them by chance in this share.
_CHANCE = 0.01
#: Touches are nowhere known better than this [m].
_LEAST_SD = 1e-7


class NoPlaneError(ValueError):
    """Touches that show no plane.

    Parameters
    ----------
    reason : str
        Why, in one line.
    remedy : str
        What to do so that they would.
    """

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}: {remedy}")
        self.reason, self.remedy = reason, remedy


@dataclass(frozen=True)
class SurfacePlane:
    """A plane through touches, and how well it is known.

    Parameters
    ----------
    normal : Array
        Unit vector into the tissue (3,).
    centre : Array
        Mean of the touches (3,) [m].
    covariance : Array
        Of the normal (3, 3) [rad^2]; nothing along itself.
    residuals : Array
        Distances of the touches from the plane, into the tissue (n,) [m].
    """

    normal: Array
    centre: Array
    covariance: Array
    residuals: Array

    @property
    def sd(self) -> float:
        """Standard deviation of the normal in its less known direction [rad]."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    @property
    def flatness(self) -> float:
        """Root mean square distance from the plane, what the fit takes out counted [m]."""
        freedom = max(self.residuals.size - 3, 1)
        return math.sqrt(float(self.residuals @ self.residuals) / freedom)

    def tilt(self, direction: ArrayLike) -> tuple[float, float]:
        """Return the angle of a probe's `direction` (3,) to the normal, and its sd [rad]."""
        way = np.asarray(direction, dtype=float)
        way = way / np.linalg.norm(way)
        along = float(way @ self.normal)
        aside = way - along * self.normal
        size = float(np.linalg.norm(aside))
        towards = aside / max(size, 1e-12)
        variance = max(float(towards @ self.covariance @ towards), 0.0)
        return math.atan2(size, along), math.sqrt(variance)


def fit_plane(touches: ArrayLike, into: ArrayLike, sds: ArrayLike = 0.0) -> SurfacePlane:
    """Fit a plane to places of first touch, by total least squares.

    The touches scatter by their stated deviations and by an unevenness of the surface, or motion
    of it, that their distances from the plane show; what few touches show of it is taken wider by
    Student's factor, so that 1.96 deviations are 95 %.

    Parameters
    ----------
    touches : array_like
        Places (n, 3) [m].
    into : array_like
        Rough direction into the tissue (3,).
    sds : array_like
        Standard deviation of each along the normal (n,) or of all [m]; 0: not known.

    Raises
    ------
    NoPlaneError
        If there are too few, they lie on one line or close together, or show a curved surface.
    """
    places = np.asarray(touches, dtype=float).reshape(-1, 3)
    count = len(places)
    stated = np.broadcast_to(np.maximum(np.asarray(sds, dtype=float), 0.0), (count,))
    least = LEAST_TOUCHES if count and np.all(stated > 0.0) else LEAST_UNSTATED
    if count < least:
        raise NoPlaneError(
            f"{count} {'touch' if count == 1 else 'touches'} at places of their own",
            f"touch at {least} places or more that are not on one line",
        )
    known = np.maximum(stated, _LEAST_SD) ** 2
    spread = _spread(places)
    freedom = count - 3
    excess = _excess(places, known, freedom)
    fit = _Fit.of(places, known + excess)
    bend = _SLOPE_FACTOR * math.sqrt(excess) / spread
    chance = chi2.sf(_Fit.of(places, known).misfit, freedom) if freedom else 1.0
    if bend > _CURVED and (chance < _CHANCE or least == LEAST_UNSTATED):
        raise NoPlaneError(
            f"the touches lie {1e3 * math.sqrt(excess):.2g} mm off a plane, which is "
            f"{math.degrees(bend):.0f} degrees of slope: the surface is curved or moves",
            "touch within a smaller patch, or hold the surface still",
        )
    factor = float(student.ppf(0.975, freedom)) / 1.96 if freedom else 1.0
    covariance = fit.covariance(known + factor**2 * excess)
    sign = 1.0 if float(fit.normal @ np.asarray(into, dtype=float)) >= 0.0 else -1.0
    plane = SurfacePlane(sign * fit.normal, fit.centre, covariance, sign * fit.residuals)
    if plane.sd > LARGEST_SD:
        raise NoPlaneError(
            f"the normal is only known to {math.degrees(plane.sd):.1f} degrees from "
            f"{count} touches over {1e3 * spread:.2g} mm",
            "touch at more places, farther apart",
        )
    return plane


def _spread(places: Array) -> float:
    """Return how far the touches spread, the mean of both directions [m].

    Raises
    ------
    NoPlaneError
        If that is along one line.
    """
    scatter = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / math.sqrt(
        len(places)
    )
    long, wide = float(scatter[0]), float(scatter[1])
    if wide < max(_LEAST_SPREAD, _LEAST_SHARE * long):
        raise NoPlaneError(
            f"the {len(places)} touches lie on one line, within {1e3 * wide:.2g} mm",
            f"touch {1e3 * max(10.0 * _LEAST_SPREAD, 0.5 * long):.2g} mm aside of it, too",
        )
    return math.sqrt(long * wide)


@dataclass(frozen=True)
class _Fit:
    """A plane by total least squares, each place weighted by its variance."""

    normal: Array
    centre: Array
    residuals: Array
    misfit: float  #: chi-squared
    weights: Array
    lateral: Array  #: places from the centre, along the plane (n, 3)

    @classmethod
    def of(cls, places: Array, variance: Array) -> _Fit:
        weights = 1.0 / variance
        centre = weights @ places / weights.sum()
        apart = places - centre
        normal = np.linalg.eigh((weights[:, None] * apart).T @ apart)[1][:, 0]
        residuals = apart @ normal
        lateral = apart - np.outer(residuals, normal)
        return cls(normal, centre, residuals, float(weights @ residuals**2), weights, lateral)

    def covariance(self, variance: Array) -> Array:
        """Return that of the normal (3, 3) where the places scatter by `variance` (n,)."""
        pseudo = np.linalg.pinv(
            (self.weights[:, None] * self.lateral).T @ self.lateral, rcond=1e-9, hermitian=True
        )
        meat = ((self.weights**2 * variance)[:, None] * self.lateral).T @ self.lateral
        return np.asarray(pseudo @ meat @ pseudo)


def _excess(places: Array, known: Array, freedom: int) -> float:
    """Return the variance beyond the known with which chi-squared is as expected [m^2]."""
    most = float(np.ptp(places, axis=0).max()) ** 2

    def beyond(excess: float) -> float:
        return _Fit.of(places, known + excess).misfit - freedom

    if not freedom or beyond(0.0) <= 0.0 or beyond(most) >= 0.0:
        return 0.0
    return float(brentq(beyond, 0.0, most, xtol=1e-16))
