# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the weighted nodes say at one moment: moments, components, parts of the variance."""

from __future__ import annotations

import copy
import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.covariance import Scales
from fden_ros.core.estimation.discrepancy import CURVE, KERNEL, KERNEL_HATS, RIG, splines
from fden_ros.core.estimation.estimate import Component, LawError
from fden_ros.core.estimation.filter import Filter
from fden_ros.core.estimation.grid import Grid, Stiffness, cholesky, open_of, solved
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER, left_after, relaxation_weights

#: Nodes less likely than the best by this factor do not count [1].
_LEAST = 1e-3
#: Places at which errors of the law are read off; the loaded part of the curve [1].
_PLACES, _LOADED = 16, 0.7
#: Another spot has at least this part of the first one's G [1].
_LEAST_GAIN = 0.1
#: Steps of theta for its derivatives, over its standard deviation [1].
_STEP = 0.1


class Spot(NamedTuple):
    """ln G and the contact point where the newest press is, at the nodes."""

    log_g: Array  #: (M,)
    contact_point: Array  #: (M,)
    by_state: Array  #: of both, by the unknowns, (2, k, M); at the first spot (2, 0, M)
    covariance: Array  #: of both, at each node, (2, 2, M)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The nodes of a filter at one moment."""

    grid: Grid
    nodes: Array  #: those that count, (M,)
    weights: Array  #: they add up to 1, (M,)
    stiffness: Stiffness  #: of these
    top: Indices  #: their places among those of the grid, (M,)
    state: Filter  #: as it was

    @classmethod
    def of(cls, state: Filter) -> Posterior:
        """Return the posterior of a filter by now."""
        grid, weights = state.grid, state.weights
        top = np.flatnonzero(weights > _LEAST * weights.max())
        stiffness = Stiffness(*(values[top] for values in state.stiffness))
        share = weights[top] / weights[top].sum()
        return cls(grid, grid.nodes[top], share, stiffness, top, copy.copy(state))

    @functools.cached_property
    def moments(self) -> tuple[Array, Array]:
        """Mean and covariance of (ln G, theta)."""
        mean, covariance = _moments(self._values, self.weights, self.spot.covariance[0, 0])
        _, across, contact_point = self.spot.covariance.reshape(4, -1)[1:] @ self.weights
        covariance[[0, -1], [-1, 0]] += across
        covariance[-1, -1] += contact_point
        return mean, covariance

    @property
    def _values(self) -> Array:
        return np.column_stack([self.spot.log_g, self.nodes[:, :-1], self.spot.contact_point])

    @functools.cached_property
    def spot(self) -> Spot:
        """Where the newest press is: another spot has a G and a contact point of its own."""
        law, log_g, contact_point = self.grid.law, self.stiffness.log_g, self.nodes[:, -1]
        if law.of_spot is None:
            covariance = np.zeros((2, 2, log_g.size))
            covariance[0, 0] = self.stiffness.variance
            return Spot(log_g, contact_point, np.zeros((2, 0, log_g.size)), covariance)
        by_state = np.zeros((2, law.size, log_g.size))
        at = list(law.of_spot)
        stiffness, contact_point_sd = (law.slots[k - RIG][0].sd for k in at)
        gain = np.maximum(1.0 + stiffness * self.states[at[0]], _LEAST_GAIN)
        by_state[0, at[0]], by_state[1, at[1]] = stiffness / gain, contact_point_sd
        rows, left = by_state[[0, 1], at], self.left[np.ix_(at, at)]
        by_g = np.array([[1.0], [0.0]]) - rows * self.by_response[at]
        covariance = np.einsum("im,ij,jm->ijm", rows, left, rows)
        covariance += by_g[:, None] * by_g * self.stiffness.variance
        return Spot(
            log_g + np.log(gain), contact_point_sd * self.states[at[1]], by_state, covariance
        )

    @property
    def _order(self) -> list[int]:
        """Places of (ln G, ln Gn, alpha, contact point) in the moments."""
        k = self.grid.law.kernels
        return [0, 1 + k, 1, 2 + k]

    @functools.cached_property
    def tissue(self) -> tuple[Array, Array]:
        """Mean and covariance of (ln G, ln Gn, alpha, contact point), with the thickness."""
        mean, covariance = self.moments
        at = self._order
        return mean[at], self._with_thickness(covariance[np.ix_(at, at)])

    def _with_thickness(self, covariance: Array) -> Array:
        found = covariance.copy()
        found[:2, :2] += self.grid.law.config.uncertainty.thickness_sd**2
        return found

    def components(self, most: int) -> tuple[Component, ...]:
        """Return at most `most` Gaussians of (ln G, ln Gn, alpha).

        They reproduce mean and covariance. The nodes are parted by weight along the axis in which
        they are widest.
        """
        values, covariance = self._values[:, self._order[:3]], self.tissue[1][:3, :3]
        unit = np.sqrt(np.maximum(covariance.diagonal(), 1e-30))
        axis = np.linalg.eigh(covariance / np.outer(unit, unit))[1][:, -1]
        order = np.argsort(values @ (axis / unit), kind="stable")
        weights = self.weights[order]
        part = ((np.cumsum(weights) - 0.5 * weights) * most).astype(np.intp)
        found = []
        for group in np.split(order, np.flatnonzero(np.diff(part)) + 1):
            weight = float(self.weights[group].sum())
            mean, own = _moments(
                values[group], self.weights[group] / weight, self.spot.covariance[0, 0, group]
            )
            found.append(Component(weight, mean, self._with_thickness(own)))
        return tuple(found)

    def probability_beyond(self, deepest: float) -> float:
        """Return P(largest strain > 1/Gn) [1]; `deepest`: the largest indentation [1]."""
        law = self.grid.law
        strain, _ = law.strain(deepest - self.spot.contact_point)
        reach = np.log(np.maximum(strain, 1e-12)) + self.nodes[:, law.kernels]
        # Between the nodes it is smooth over the distance of two.
        width = self.grid.start.box.lower[law.kernels, law.kernels] / math.sqrt(12.0)
        return float(self.weights @ ndtr(reach / max(width, 1e-9)))

    @functools.cached_property
    def by_response(self) -> Array:
        """What a response that is larger by a factor e would take from the unknowns z, (k, M)."""
        heads = self.grid.cells.y.shape[1]
        responses = self.state.products[:, heads + self.grid.law.size + self.top]
        return np.asarray(responses * np.exp(self.stiffness.log_g))

    @property
    def known(self) -> Array:
        """By how much less than before the covariance of the unknowns is at a given G, (k, k)."""
        heads = self.grid.cells.y.shape[1]
        return self.state.products[:, heads : heads + self.grid.law.size]

    @functools.cached_property
    def left(self) -> Array:
        """The covariance of the unknowns at a given G, (k, k)."""
        return np.asarray(self.grid.prior - self.known)

    @functools.cached_property
    def states(self) -> Array:
        """The unknowns z of each node given all data, (k, M)."""
        cells, products = self.grid.cells, self.state.products
        own = products[:, :1] + products[:, 1 : cells.y.shape[1]] @ cells.off[self.top].T
        return np.asarray(own - self.by_response)

    def law_error(self, elapsed: float, deepest: float) -> LawError | None:
        """Return how far the data bend the law; None: it is said to be exact.

        Parameters
        ----------
        elapsed : float
            Since the touch [s].
        deepest : float
            Largest indentation [1].
        """
        law = self.grid.law
        if not law.config.uncertainty.characteristic_sd:
            return None
        state = self.states @ self.weights
        off = (self.states - state[:, None]) * np.sqrt(self.weights)
        covariance = self.left + off @ off.T
        mean, _ = self.tissue
        # From 0.03 of the elapsed time on, and from a tenth of the largest strain.
        times = np.geomspace(0.03 * elapsed, elapsed, _PLACES)
        bend, slope = _relaxation_functionals(float(mean[2]), times)
        strain = max(float(law.strain(np.array([deepest - mean[3]]))[0][0]), 1e-6)
        strains = np.linspace(0.1 * strain, strain, _PLACES)
        curve = splines(strains, law.last_knot)
        sizes = [
            _root_mean_square(rows @ state[at], rows @ covariance[at, at] @ rows.T)
            for at, rows in (
                (KERNEL, bend),
                (CURVE, curve),
                (CURVE, curve[strains >= _LOADED * strain]),
            )
        ]
        along = slope @ self.states[KERNEL]
        order = self.nodes[:, 0] - along
        middle = float(self.weights @ order)
        spread = float(self.weights @ (order - middle) ** 2)
        spread += float(slope @ covariance[KERNEL, KERNEL] @ slope)
        spread -= float(self.weights @ (along - self.weights @ along) ** 2)
        return LawError(*sizes[0], *sizes[1], *sizes[2], middle, math.sqrt(max(spread, 0.0)))

    @functools.cached_property
    def rig_conflict(self) -> float:
        """How far the data say that the rig is from what is stated, in standard deviations [1].

        Over those of what is stated and what the data say, of which a hundredth at least counts.
        """
        law, before, off = self.grid.law, self.grid.prior.diagonal(), 0.0
        for k, (one, _) in enumerate(law.slots, RIG):
            if one.has_tails:
                told = max(float(self.known[k, k] / before[k]), 0.01)
                variance = max(float(before[k]) * (1.0 / told - 1.0), 0.0)
                mean = float(self.states[k] @ self.weights)
                off = max(off, abs(mean) / told / math.sqrt(1.0 + variance))
        return off

    def shares(self) -> dict[str, tuple[float, float]]:
        """Return the parts of the variances of ln G and ln Gn by source; they add up to these.

        About the mean an estimate is a line in the data: its variance is the sum of what each part
        of S makes of it, and of the prior, in the mean over the scales.
        """
        grid = self.grid
        jacobian, variance = self._jacobian(), grid.law.config.uncertainty.thickness_sd**2
        each = [(weight, self._shares(jacobian, scales)) for scales, weight in grid.scales]
        parts = {name: sum(weight * own[name] for weight, own in each) for name in each[0][1]}
        now = np.diag(self.tissue[1])[:2] - variance
        factors = now / np.maximum(sum(parts.values()), 1e-30)
        found = {name: tuple((factors * part).tolist()) for name, part in parts.items()}
        return found | {"thickness": (variance, variance)}

    def _shares(self, jacobian: Array, scales: Scales) -> dict[str, Array]:
        """Return the parts at some scales, (2,) each."""
        grid, law = self.grid, self.grid.law
        is_open = np.append(True, open_of(law))
        lower = cholesky(grid.covariance.at(scales))
        white = solved(lower, jacobian[:, is_open])
        sds = np.append(law.config.prior.linear_stiffness_log_sd, law.coordinates[1])[is_open]
        covariance = np.linalg.inv(white.T @ white + np.diag(sds**-2.0))
        gain = covariance @ solved(lower, white, trans=1).T
        at = [0, int(is_open[: 1 + law.kernels].sum())]
        gain, own = gain[at], covariance[at] ** 2 / sds**2
        parts = {
            name: np.einsum("ij,jk,ik->i", gain, part, gain)
            for name, part in grid.covariance.parts(scales).items()
        }
        surface = own[:, -1] * is_open[-1]
        parts["surface"] = parts.get("surface", 0.0) + surface
        return parts | {"prior": own.sum(axis=1) - surface}

    def _jacobian(self) -> Array:
        """Return the derivatives of the cells' stress by (ln G, theta), (N, 1 + d)."""
        grid, law = self.grid, self.grid.law
        mean, sds = grid.start.box.mean, grid.start.box.deviations
        steps = _STEP * np.diag(np.maximum(sds, 1e-9))
        nodes = np.vstack([mean, mean + steps])
        responses, _ = law.responses(nodes, grid.about)
        shift = grid.covariance.shifts()[:, 1:] @ steps
        g = math.exp(grid.about.log_g)
        by_theta = (g * (responses[:, 1:] - responses[:, :1]) - shift) / steps.diagonal()
        return np.column_stack([g * responses[:, 0], by_theta])


def _relaxation_functionals(order: float, times: Array) -> tuple[Array, Array]:
    """Return the kernel's error at times less its line in ln t, and the line's slope, by knots."""
    weights = relaxation_weights(float(np.clip(order, LOWEST_ORDER, HIGHEST_ORDER)))
    after = weights * left_after(times)
    errors = (after / after.sum(axis=1, keepdims=True)) @ KERNEL_HATS
    logs = np.log(times)
    line = np.column_stack([np.ones(times.size), logs - logs.mean()])
    fit = np.linalg.pinv(line)
    return errors - line @ fit @ errors, fit[1] @ errors


def _root_mean_square(values: Array, covariance: Array) -> tuple[float, float]:
    size = math.sqrt(float(np.mean(values**2)))
    return size, math.sqrt(max(float(np.mean(covariance.diagonal())), 0.0))


def _moments(values: Array, weights: Array, variances: Array) -> tuple[Array, Array]:
    """Return mean and covariance of weighed values, the first of which have variances."""
    mean = weights @ values
    off = values - mean
    root = off * np.sqrt(weights)[:, None]
    covariance = root.T @ root
    covariance[0, 0] += float(weights @ variances)
    return mean, covariance
