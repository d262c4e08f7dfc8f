# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The weighted nodes: quadrature over what is nonlinear, Gaussian algebra for the rest.

.. math::
    y = G\,r(\theta) + X z + w + v, \qquad \ln p(y \mid \theta, G) = b\,G - \tfrac12 a\,G^2 + c,
    \qquad a = r^T S^{-1} r,\; b = r^T S^{-1} y

theta are the relaxation's coordinates, ln Gn and the contact point. G is integrated in one
dimension. The nodes are a product grid in z of theta = m + L z, with mean m and covariance L L^T
of the grid before: a nested approximation (Rue, Martino and Chopin, J. R. Stat. Soc. B 71, 2009)
on a point-mass grid (Bucy and Senne, Automatica 7, 1971).

The columns X are taken about one node. Each node is linear about its own conditional mode: that of
the round before, kept as a line in theta (:class:`~.law.Expansion`). With one mode for all nodes
the rounds swing, and end 5 to 8 logarithmic units low.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.covariance import JITTER, Covariance, Noise, Scales, near, scales_of
from fden_ros.core.estimation.discrepancy import CURVE, KERNEL, RIG, spline_places, splines
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.law import Expansion, Law, Linear
from fden_ros.core.estimation.nuisance import with_tails
from fden_ros.core.parameter import TINY

#: A grid reaches as many standard deviations [1].
REACH = 3.0
#: A grid is too coarse below this part of the effective number of nodes of a Gaussian in it [1].
_LEAST_EFFECTIVE = 0.46
#: And along each axis of the box below this part of its standard deviation [1]: of one narrower
#: than 0.4 nearly all weight may lie at one place.
_LEAST_WIDTH = 0.3
#: A change of the log evidence that is one: a scale leads where it gains this, and a grid whose
#: evidence changes by less is settled [1].
_LEAST_GAIN = 0.5
#: A law that is said to be exact does not describe data whose chi squared is above this times the
#: cells, and as many of its standard deviations above them [1].
_MISFIT, _MISFIT_DEVIATIONS = 1.5, 4.0
#: A rough error of the stress counts as in 16 independent cells, however many there are [1].
_ROUGH_CELLS = 16
#: A step that leads out is halved as many times, and then not taken [1].
_HALVINGS = 20
#: Standard deviations of the box at another mode, over those of the prior, and by how much less
#: likely than the best node its best is at most, as a logarithm [1].
_NARROW, _POSSIBLE = 0.2, 10.0
#: Nodes at which scales are weighed.
_FEW = 6
#: A change of the law's errors that is taken as it is [1].
_SMALL_STEP = 0.02
#: Rounds after which steps are damped [1].
_DAMPED_FROM = 5
#: Rounds after which a grid that has not settled is given up [1].
LAST_ROUNDS = 12
#: Scales less likely than the best by this logarithm do not count [1].
_NEGLIGIBLE_SCALE = 4.0


class Box(NamedTuple):
    """Where a grid lies: theta = mean + lower z."""

    mean: Array
    lower: Array

    @property
    def deviations(self) -> Array:
        """Standard deviations of theta."""
        return np.asarray(np.linalg.norm(self.lower, axis=1))


class Start(NamedTuple):
    """From what a grid is laid."""

    about: Expansion
    box: Box
    scales: Scales
    log_evidence: float = -math.inf  #: of the round before
    is_continued: bool = False  #: that round was settled, of a shorter record
    rounds: int = 0  #: since the last that was settled


class Stiffness(NamedTuple):
    """G integrated out at each node."""

    log_g: Array  #: mode of ln G
    variance: Array  #: of ln G
    log: Array  #: log evidence, without that of y alone


def of_stiffness(
    a: Array, b: Array, mean: float, sd: float, begin: Array | None = None
) -> Stiffness:
    """Return ln G and the log evidence of b G - a G^2 / 2 with a Gaussian prior of ln G.

    Newton's steps in one dimension, at all nodes; the prior's mean and standard deviation are of
    ln G. `begin`: ln G near by.
    """
    a = np.maximum(a, 1e-300)
    if begin is None:
        begin = np.log(np.maximum(b, 1e-3 * np.sqrt(a)) / a)
    # A node without a response says nothing of G.
    g = np.clip(begin, mean - 8.0 * sd, mean + 8.0 * sd)
    for _ in range(30):
        e = np.exp(g)
        line, square = b * e, a * e**2
        curve = np.maximum(2.0 * square - line, 0.5 * square) + 1.0 / sd**2
        step = (line - square - (g - mean) / sd**2) / curve
        g = g + np.minimum(np.maximum(step, -1.0), 1.0)
        if np.abs(step).max() < 1e-4:  # quadratic convergence: the error is 1e-8 by now
            break
    e = np.exp(g)
    line, square = b * e, a * e**2
    curve = np.maximum(2.0 * square - line, 0.1 * square) + 1.0 / sd**2
    log = line - 0.5 * square - 0.5 * ((g - mean) / sd) ** 2 - 0.5 * np.log(curve * sd**2)
    return Stiffness(g, 1.0 / curve, log)


def _of_white(law: Law, y: Array, responses: Array) -> Stiffness:
    """Return nodes by whitened data and responses, (N, M) each; the log is without that of |S|."""
    a, b, rest = (
        np.einsum("ij,ij->j", u, v) for u, v in ((responses, responses), (y, responses), (y, y))
    )
    found = of_stiffness(a, b, *prior_of_log_g(law))
    return found._replace(log=found.log - 0.5 * rest)


def log_sum(logs: Array, axis: int | None = None) -> Array:
    """Return the logarithm of a sum of exponentials."""
    most = logs.max(axis=axis, keepdims=True)
    found = np.log(np.exp(logs - most).sum(axis=axis, keepdims=True)) + most
    return np.asarray(found.reshape(()) if axis is None else np.squeeze(found, axis))


def solved(lower: Array, right: Array, trans: int = 0) -> Array:
    """Return L^-1 b, or L^-T b."""
    return np.asarray(lapack.dtrtrs(lower, right, lower=1, trans=trans)[0])


def cholesky(matrix: Array) -> Array:
    """Return the lower Cholesky factor."""
    lower, info = lapack.dpotrf(matrix, lower=1, clean=1)
    if info:
        raise np.linalg.LinAlgError("the covariance is not positive definite")
    return np.asarray(lower)


@dataclass(frozen=True, eq=False)
class Cells:
    """What nodes are weighed by: y as at the leading node and by theta, and their responses."""

    y: Array  #: (N, 1 + d)
    off: Array  #: theta of the nodes less that of the leading one, (M, d)
    responses: Array  #: for G = 1, (N, M)

    def some(self, nodes: Indices) -> Cells:
        """Return those of some nodes."""
        return Cells(self.y, self.off[nodes], self.responses[:, nodes])

    @property
    def own(self) -> Array:
        """The y of each node, (N, M)."""
        return np.asarray(self.y[:, :1] + self.y[:, 1:] @ self.off.T)


def table(law: Law, covariance: Covariance, places: Sequence[Scales], cells: Cells) -> Stiffness:
    r"""Return what nodes are at places of the scales, each of shape (places, M).

    With D of what is not smooth and A the scaled columns of the smooth errors, by Woodbury

    .. math:: u^T S^{-1} v = u^T D^{-1} v - (A^T D^{-1} u)^T M^{-1} (A^T D^{-1} v), \qquad
              M = 1 + A^T D^{-1} A .
    """
    own = np.hstack([*covariance.smooth, cells.y, cells.responses])
    widths = [part.shape[1] for part in covariance.smooth]
    # The y of a node is a product with these.
    heads = np.vstack([np.ones(len(cells.off)), cells.off.T])
    k, h = sum(widths), len(heads)
    kinds = {(one.roughness, one.motion): one for one in places}
    whites, logs = [], np.empty(len(kinds))
    for i, one in enumerate(kinds.values()):
        lower = cholesky(covariance.without_smooth(one))
        whites.append(lapack.dtrtri(lower, lower=1)[0] @ own)
        logs[i] = np.log(lower.diagonal()).sum()
    white = np.array(whites)
    at = [list(kinds).index((one.roughness, one.motion)) for one in places]
    both = white[:, :, :k].transpose(0, 2, 1) @ white
    # The sums of one kind: of its y and responses, less what the smooth errors explain.
    y, r = white[:, :, k : k + h] @ heads, white[:, :, k + h :]
    chi, b, a = (np.einsum("pij,pij->pj", u, v)[at] for u, v in ((y, y), (y, r), (r, r)))
    scale = np.repeat(np.array([one.smooth for one in places]), widths, axis=1)[:, :, None]
    inner = scale * both[at, :, :k] * scale.transpose(0, 2, 1) + np.eye(k)
    root = np.linalg.cholesky(inner)
    # An inverse and one product take a fifth of the time of a solution for each place.
    across = np.linalg.inv(root) @ (scale * both[at, :, k:])
    y, r = across[:, :, :h] @ heads, across[:, :, h:]
    chi, b, a = (
        whole - np.einsum("pij,pij->pj", u, v)
        for whole, u, v in ((chi, y, y), (b, y, r), (a, r, r))
    )
    rest = 0.5 * chi + (logs[at] + np.log(np.diagonal(root, 0, 1, 2)).sum(axis=1))[:, None]
    found = of_stiffness(a, b, *prior_of_log_g(law))
    log_prior = np.array([[one.log_prior] for one in places])
    return found._replace(log=found.log - rest + log_prior)


def prior_of_log_g(law: Law) -> tuple[float, float]:
    """Return mean and standard deviation of ln G before the data."""
    prior = law.config.prior
    return float(prior.mean[0]), prior.linear_stiffness_log_sd


def tempered(log: Array, least: float) -> tuple[Array, float]:
    """Return weights of an effective number of `least` or more, and their inverse temperature."""

    def weights(beta: float) -> Array:
        found = np.exp(beta * (log - log.max()))
        return np.asarray(found / found.sum())

    whole = weights(1.0)
    if 1.0 / float(whole @ whole) >= least:
        return whole, 1.0
    low, high = 0.0, 1.0
    for _ in range(20):
        beta = 0.5 * (low + high)
        low, high = (beta, high) if 1.0 / np.sum(weights(beta) ** 2) >= least else (low, beta)
    return weights(low), low


def least_effective(law: Law) -> float:
    """Return the effective number of nodes, 1 / sum w^2, that a grid has at least.

    A Gaussian of unit variance has sqrt(4 pi) / h of them at a distance of h.
    """
    counts = np.array(law.counts)[open_of(law)]
    gaussian = math.sqrt(4.0 * math.pi) * (counts - 1) / (2.0 * REACH)
    return float(np.prod(np.maximum(_LEAST_EFFECTIVE * gaussian, 1.0)))


def places_in(law: Law, box: Box, nodes: Array) -> Array:
    """Return the places of nodes along the axes of a box, in its standard deviations."""
    is_open = open_of(law)
    lower = box.lower[np.ix_(is_open, is_open)]
    return np.asarray(np.linalg.solve(lower, (nodes - box.mean)[:, is_open].T).T)


def have_width(places: Array, weights: Array) -> bool:
    """Whether weights resolve each axis of a box, at places in it."""
    off = places - weights @ places
    return bool(np.all(weights @ (off * off) > _LEAST_WIDTH**2))


@dataclass(eq=False)
class Weighed:
    """Nodes laid in a box, and weighed at the leading scales.

    Attributes
    ----------
    log_prior : ndarray, shape (M,)
        Of theta, with the volume of a cell.
    lower : ndarray, shape (N, N)
        Cholesky factor of S at the leading scales.
    white : ndarray, shape (N, 1 + d + k + M)
        y, X P and the responses, whitened by it.
    residual : ndarray, shape (N, M)
        y of each node less its response, whitened.
    log : ndarray, shape (M,)
        Log evidence with the prior.
    """

    law: Law
    noise: Noise
    start: Start
    linear: Linear
    covariance: Covariance
    nodes: Array
    cells: Cells
    log_prior: Array
    lower: Array
    white: Array
    residual: Array
    stiffness: Stiffness
    log: Array


@dataclass(eq=False)
class Grid(Weighed):
    """A round: weighed nodes, and what follows from them.

    Attributes
    ----------
    stiffness : Stiffness
        Of all nodes, mixed over the scales.
    scales : list of (Scales, float)
        The likely ones, and their weights.
    is_settled : bool
        The grid resolves the posterior, and another round would change nothing.
    after : Start
        Of the next round.
    """

    scales: list[tuple[Scales, float]]
    is_settled: bool
    after: Start

    @property
    def is_misfit(self) -> bool:
        """Whether the residuals are not noise, though the law is said to be exact.

        The errors of another one are random walks too: measured beef has 2 to 9 a cell.
        """
        if not self.is_settled and self.after.rounds < LAST_ROUNDS:
            return False
        if self.law.config.uncertainty.characteristic_sd:
            return False
        count = len(self.lower)
        chi_squared = float(np.sum(self.residual[:, int(np.argmax(self.log))] ** 2))
        beyond = chi_squared - count > _MISFIT_DEVIATIONS * math.sqrt(2.0 * count)
        return beyond and chi_squared > _MISFIT * count

    @property
    def about(self) -> Expansion:
        """What the columns are taken about."""
        return self.start.about

    @functools.cached_property
    def prior(self) -> Array:
        """The covariance of a state at the leading scales, (k, k)."""
        return self.covariance.prior(self.start.scales)

    @functools.cached_property
    def places(self) -> Array:
        """The nodes along the axes of the box."""
        return places_in(self.law, self.start.box, self.nodes)

    @functools.cached_property
    def relaxations(self) -> Array:
        """The relaxation of the nodes by its rates, (34, M)."""
        return self.law.weights(self.nodes)

    @property
    def weights(self) -> Array:
        """Of the nodes, (M,)."""
        log = self.stiffness.log + self.log_prior
        return np.asarray(np.exp(cut(self.law, self.nodes, log)))


def log_evidence_of(law: Law, log: Array) -> float:
    """Return the log evidence of nodes, with the prior of the scales normalised."""
    return float(log_sum(log)) - _log_prior_of_scales(law.config.uncertainty)


@functools.lru_cache(maxsize=16)
def _log_prior_of_scales(uncertainty: Uncertainty) -> float:
    return float(log_sum(np.array([one.log_prior for one in scales_of(uncertainty)])))


def cut(law: Law, nodes: Array, log: Array) -> Array:
    """Return normalised log weights: those of an alpha that is given are its prior's."""
    if not law.has_kernel_error or not law.config.is_order_given:
        return np.asarray(log - log_sum(log))
    orders, which = np.unique(nodes[:, 0].round(12), return_inverse=True)
    mean, sd = law.coordinates[0][0], max(float(law.coordinates[1][0]), 1e-9)
    prior = -0.5 * ((orders - mean) / sd) ** 2
    prior -= log_sum(prior)
    totals = np.array([log_sum(log[which == k]) for k in range(orders.size)])
    return np.asarray(log - totals[which] + prior[which])


def open_of(law: Law) -> Array:
    """Return which coordinates of a node are not known."""
    return np.asarray(law.coordinates[1] > 0.0)


def log_prior_of(law: Law, nodes: Array) -> Array:
    """Return the log density of theta."""
    (mean, sds), is_open = law.coordinates, open_of(law)
    z = (nodes - mean)[:, is_open] / sds[is_open]
    size = np.log(sds[is_open]).sum() + 0.5 * is_open.sum() * math.log(2.0 * math.pi)
    return np.asarray(-0.5 * np.einsum("ij,ij->i", z, z) - size)


def _nodes(law: Law, box: Box, counts: Sequence[int], reach: float) -> tuple[Array, float]:
    """Return the nodes of a product grid within a ball, and the log volume of a cell."""
    own = tuple(c if o else 1 for c, o in zip(counts, open_of(law), strict=True))
    z, steps = _unit_nodes(own, reach)
    sides, nodes = steps * box.lower.diagonal(), box.mean + z @ box.lower.T
    return nodes[law.inside(nodes)], float(np.log(sides[steps > 0.0]).sum())


@functools.lru_cache(maxsize=16)
def _unit_nodes(counts: tuple[int, ...], reach: float) -> tuple[Array, Array]:
    """Return these nodes in the unit box, and their distances along its axes."""
    axes = [np.linspace(-reach, reach, n) if n > 1 else np.zeros(1) for n in counts]
    z = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))
    steps = np.array([axis[1] - axis[0] if axis.size > 1 else 0.0 for axis in axes])
    return z[np.einsum("ij,ij->i", z, z) <= (1.13 * reach) ** 2], steps


def begun(law: Law, noise: Noise, known: Grid | None = None) -> list[Start]:
    """Return where to begin: about the best of a broad grid, under a rough error of the stress.

    Where the strain is near 1/Gn, a curve that bends and one that does not, with less relaxation,
    may explain a press alike: these are two modes. Where the other than the `known` one may, it
    is where to begin as well.
    """
    mean, sds = law.coordinates
    d, stresses = mean.size, law.place.joined("stresses")
    n = sum(press.times.size for press in law.place.presses)
    zero = np.zeros((law.size, d))
    rig = np.ones(len(law.slots))
    about = Expansion(mean, prior_of_log_g(law)[0], zero[:, 0], zero, np.zeros(n), rig)
    nodes, _ = _nodes(law, Box(mean, np.diag(sds)), law.broad, 2.4)
    rough = np.sqrt(noise.stress**2 + (0.05 * stresses) ** 2 + (0.02 * np.ptp(stresses)) ** 2)
    # It is that of a whole press, not of each cell anew.
    rough *= math.sqrt(max(stresses.size / _ROUGH_CELLS, 1.0))
    white = law.responses(nodes, about)[0] / rough[:, None]
    y = stresses / rough
    found = of_stiffness(np.einsum("ij,ij->j", white, white), y @ white, *prior_of_log_g(law))
    log = found.log + log_prior_of(law, nodes)
    weights, _ = tempered(log, least_effective(law))
    best = int(np.argmax(log))
    places = [(best, _moments(law, nodes, weights, Box(mean, np.diag(sds))))]
    if known is not None:
        is_other = law.are_beyond(nodes) != law.are_beyond(known.after.box.mean[None])
        there = int(np.argmax(np.where(is_other, log, -math.inf)))
        if is_other[there] and log[there] > log[best] - _POSSIBLE:
            # A wide box would be drawn to the mode that is broader.
            places.append((there, Box(nodes[there], np.diag(_NARROW * sds))))
    middle = np.array([0.1, 0.1, 0.06, 1.0]) + 1e-4
    scales = min(
        scales_of(law.config.uncertainty),
        key=lambda one: float(np.abs(np.log((np.array(one.sizes) + 1e-4) / middle)).sum()),
    )
    starts = []
    for k, box in places:
        own = replace(about, theta=nodes[k], log_g=float(found.log_g[k]))
        starts.append(Start(law.stressed(own), box, scales))
    return starts


def continued(law: Law, grid: Grid, mean: Array, covariance: Array, log_evidence: float) -> Start:
    """Return where to go on: from a grid of a shorter record.

    `mean`, `covariance`: of theta by now; `log_evidence`: by now, at the leading scales.
    """
    about, d = grid.after.about, mean.size
    line = np.column_stack([about.state, about.by_theta])[: law.size]
    line = np.pad(line, ((0, law.size - len(line)), (0, 0)))
    if law.last_knot != grid.law.last_knot:
        line[CURVE] = splines(spline_places(law.last_knot), grid.law.last_knot) @ line[CURVE]
    # The line goes through the new mean.
    state = line[:, 0] + line[:, 1:] @ (mean - about.theta)
    log_g = float(grid.weights @ grid.stiffness.log_g)
    size = len(law.slots)
    rig = np.append(about.rig, np.ones(size))[:size]
    about = Expansion(mean, log_g, state, line[:, 1:], np.zeros(0), rig)
    own = covariance + np.diag((0.02 * grid.start.box.deviations) ** 2)
    lower, both = np.zeros((d, d)), np.ix_(open_of(law), open_of(law))
    lower[both] = np.linalg.cholesky(own[both])
    box, rounds = Box(mean, lower), 0
    if not grid.is_settled:
        # The round that is under way goes on, with what is new.
        box, rounds = grid.after.box, grid.after.rounds
    return Start(
        law.stressed(about), box, grid.after.scales, log_evidence, grid.is_settled, rounds
    )


def _weighed(law: Law, noise: Noise, start: Start) -> Weighed:
    about = start.about
    nodes, log_volume = _nodes(law, start.box, law.counts, REACH)
    log_prior = log_prior_of(law, nodes) + log_volume
    responses, linear = law.responses(nodes, about)
    covariance = Covariance(law, about, linear, noise)
    y = covariance.shifts()
    y[:, 0] += law.place.joined("stresses")
    cells = Cells(y, nodes - about.theta, responses)
    lower, white = whitened(law, covariance, start.scales, cells)
    rows = white[:, y.shape[1] + law.size :]
    own = white[:, :1] + white[:, 1 : y.shape[1]] @ cells.off.T
    found = _of_white(law, own, rows)
    log = found.log - np.log(lower.diagonal()).sum() + log_prior
    log = cut(law, nodes, log) + log_sum(log)
    residual = own - rows * np.exp(found.log_g)
    return Weighed(
        law, noise, start, linear, covariance, nodes, cells, log_prior, lower, white, residual,
        found, log,
    )  # fmt: skip


def laid(law: Law, noise: Noise, start: Start) -> Grid:
    """Lay a grid: one round."""
    own = _weighed(law, noise, start)
    weights, beta = tempered(own.log, least_effective(law))
    is_coarse, has_width = beta < 1.0, True
    if law.has_close_nodes:
        has_width = have_width(places_in(law, start.box, own.nodes), weights)
    has_moments = law.has_close_nodes and not is_coarse
    box = _moments(law, own.nodes, weights, start.box) if has_moments else _around(own)
    if start.rounds >= _DAMPED_FROM and has_width:
        box = _between(start.box, box)
    mixture, scales = _likely_scales(own)
    total = float(log_sum(own.log))
    is_near = abs(total - start.log_evidence) < _LEAST_GAIN or start.is_continued
    settled = (
        not is_coarse
        and has_width
        and scales == start.scales
        and is_near
        and _is_near(law, start.box, box)
    )
    about = _relinearised(own, weights)
    if settled:
        mixed, mixture = _mixed(own, [one for one, _ in mixture])
    else:
        mixed = _led(own, mixture)
    after = Start(about, box, scales, total, rounds=start.rounds + 1)
    return Grid(
        **vars(own) | {"stiffness": mixed}, scales=mixture, is_settled=settled, after=after
    )


def _likely_scales(own: Weighed) -> tuple[list[tuple[Scales, float]], Scales]:
    """Return the likely places next to the leading one, and that which leads from now on.

    With their weights, by the best nodes alone.
    """
    law, start = own.law, own.start
    few = np.argsort(-own.log)[:_FEW]
    places = near(law.config.uncertainty, start.scales)
    logs = table(law, own.covariance, places, own.cells.some(few)).log + own.log_prior[few]
    sums = log_sum(logs, 1)
    gain = 4.0 * _LEAST_GAIN if start.rounds >= _DAMPED_FROM else _LEAST_GAIN
    best = places[int(np.argmax(sums))]
    leads = best if sums.max() > sums[places.index(start.scales)] + gain else start.scales
    likely = np.flatnonzero(sums > sums.max() - _NEGLIGIBLE_SCALE)
    if not likely.size:
        raise np.linalg.LinAlgError("no scale has a finite likelihood")
    weights = np.exp(sums[likely] - log_sum(sums[likely]))
    return [(places[k], w) for k, w in zip(likely, weights.tolist(), strict=True)], leads


def _is_near(law: Law, box: Box, other: Box) -> bool:
    """Whether a box resolves what another one is laid in."""
    is_open = open_of(law)
    sds = other.deviations[is_open]
    ratio = sds / box.deviations[is_open]
    moved = np.abs(other.mean - box.mean)[is_open] / sds
    return bool(np.all(moved < 0.4) and np.all((ratio > 0.7) & (ratio < 1.4)))


def leads_to(grid: Grid, other: Grid) -> bool:
    """Whether the rounds of a grid are about to end where another one is, of the same record."""
    own, there = grid.after, other.after
    return own.scales == there.scales and _is_near(grid.law, own.box, there.box)


def whitened(
    law: Law, covariance: Covariance, scales: Scales, cells: Cells
) -> tuple[Array, Array]:
    """Return the Cholesky factor of S, and y, X P and the responses whitened by it."""
    lower = cholesky(covariance.at(scales))
    columns = covariance.linear.columns @ covariance.prior(scales)
    return lower, solved(lower, np.hstack([cells.y, columns, cells.responses]))


def _mixed(own: Weighed, likely: Sequence[Scales]) -> tuple[Stiffness, list[tuple[Scales, float]]]:
    """Return the nodes mixed over likely scales, and these with their weights."""
    found, log_prior = table(own.law, own.covariance, likely, own.cells), own.log_prior
    log = log_sum(found.log, axis=0)
    share = np.exp(found.log - log)
    log_g = (share * found.log_g).sum(axis=0)
    variance = (share * (found.variance + found.log_g**2)).sum(axis=0) - log_g**2
    whole = np.exp(log_sum(found.log + log_prior, axis=1) - log_sum(log + log_prior))
    mixture = list(zip(likely, whole.tolist(), strict=True))
    return Stiffness(log_g, np.maximum(variance, 0.0), log), mixture


def _led(own: Weighed, mixture: Sequence[tuple[Scales, float]]) -> Stiffness:
    """Return the nodes at the leading scales alone: another round comes.

    Their evidence is that of all scales, by the best nodes.
    """
    leading = own.start.scales
    share = sum(weight for one, weight in mixture if one == leading)
    gain = leading.log_prior - math.log(max(share, math.exp(-_NEGLIGIBLE_SCALE)))
    return own.stiffness._replace(log=own.log - own.log_prior + gain)


def moments_of(weights: Array, nodes: Array) -> tuple[Array, Array]:
    """Return mean and covariance of weighed nodes."""
    mean = weights @ nodes
    off = nodes - mean
    return mean, (off * weights[:, None]).T @ off


def _moments(law: Law, nodes: Array, weights: Array, box: Box) -> Box:
    """Return the box of nodes."""
    is_open = open_of(law)
    mean, own = moments_of(weights, nodes)
    own += np.diag((0.03 * box.deviations) ** 2)
    lower, at = np.zeros_like(own), np.ix_(is_open, is_open)
    # Where much lies at an edge of the box, the next is wider there.
    z = np.zeros_like(nodes)
    z[:, is_open] = places_in(law, box, nodes)
    edge = weights @ (np.abs(z) > 0.8 * REACH) > 0.05
    own += 4.0 * box.lower[:, edge] @ box.lower[:, edge].T
    lower[at] = np.linalg.cholesky(own[at])
    return Box(np.where(is_open, mean, law.coordinates[0]), lower)


def _around(own: Weighed) -> Box:
    """Return the box of a Gaussian about a likely theta: nodes are too far apart for moments.

    From the best node at each ln Gn by a step of Gauss and Newton, at most as far as the nodes are
    apart: the likeliest of these. The best node alone may be of another mode, that is broader.
    """
    law, start = own.law, own.start
    box, is_open, k = start.box, open_of(law), law.kernels
    places = np.linalg.solve(
        box.lower + np.diag(np.where(is_open, 0.0, 1.0)), (own.nodes - box.mean).T
    )[k]
    order = np.lexsort((-own.log, places.round(6)))
    heads = order[np.unique(places[order].round(6), return_index=True)[1]]
    sds = np.maximum(box.deviations, 1e-12)
    moves = np.diag(0.05 * sds)[is_open]
    nodes = own.nodes[heads]
    around = np.concatenate([nodes, *(nodes + move for move in moves)])
    white = solved(
        own.lower,
        np.hstack(
            [
                own.cells.some(heads).own,
                law.responses(around, start.about)[0],
                own.cells.y[:, 1:] @ moves.T,
            ]
        ),
    )
    m, d = len(heads), len(moves)
    found = [
        _stepped(law, box, nodes[i], white[:, i], white[:, m + i : m * (d + 2) : m], white[:, -d:])
        for i in range(m)
    ]
    ends = np.array([one.mean for one in found])
    cells = Cells(own.cells.y, ends - start.about.theta, law.responses(ends, start.about)[0])
    y, rows = solved(own.lower, cells.own), solved(own.lower, cells.responses)
    log = _of_white(law, y, rows).log + log_prior_of(law, ends)
    return found[int(np.argmax(log))]


def _stepped(law: Law, box: Box, middle: Array, y: Array, responses: Array, shifts: Array) -> Box:
    """Return the box after a step of Gauss and Newton from a node.

    Parameters
    ----------
    y : ndarray, shape (N,)
        Whitened.
    responses, shifts : ndarray, shape (N, 1 + d), (N, d)
        Whitened, of the node and of d moves by 0.05 of the box, and what these add to y.
    """
    is_open = open_of(law)
    steps, base = 0.05 * np.maximum(box.deviations[is_open], 1e-12), responses[:, 0]
    mean_g, sd_g = prior_of_log_g(law)
    # The response may be none, or against the data: then the prior limits G.
    limits = math.exp(mean_g - REACH * sd_g), math.exp(mean_g + REACH * sd_g)
    g = min(max(float(y @ base) / max(float(base @ base), 1e-300), limits[0]), limits[1])
    jacobian = np.column_stack(
        [g * base, (g * (responses[:, 1:] - base[:, None]) - shifts) / steps]
    )
    (mean, sds), at = law.coordinates, np.ix_(is_open, is_open)
    sds = np.append(sd_g, sds[is_open])
    off = np.append(math.log(g) - mean_g, (middle - mean)[is_open])
    curvature = jacobian.T @ jacobian
    # Columns may be parallel, and so steep that the prior is below their rounding.
    found = np.linalg.inv(curvature + np.diag(sds**-2.0 + JITTER * curvature.diagonal()))
    step = (found @ (jacobian.T @ (y - g * base) - off / sds**2))[1:]
    most = 1.5 * box.deviations[is_open]
    step /= max(1.0, float(np.max(np.abs(step) / most)))
    # The first of the way back that is inside; of a step that is no number there is none.
    ends = np.repeat(middle[None], _HALVINGS + 1, axis=0)
    ends[:-1, is_open] += 0.5 ** np.arange(_HALVINGS)[:, None] * step
    end = ends[int(np.argmax(np.append(law.inside(ends[:-1]), True)))]
    root = np.zeros_like(box.lower)
    # Wide: the next grid finds what it is.
    root[at] = np.linalg.cholesky(2.0 * found[1:, 1:] + np.diag((0.02 * most) ** 2))
    return Box(end, root)


def _between(box: Box, other: Box) -> Box:
    """Return a box half way: rounds would else swing about a broad posterior."""
    spread = 0.5 * (box.lower @ box.lower.T + other.lower @ other.lower.T)
    lower, at = np.zeros_like(spread), np.flatnonzero(spread.diagonal() > 0.0)
    lower[np.ix_(at, at)] = np.linalg.cholesky(spread[np.ix_(at, at)])
    return Box(0.5 * (box.mean + other.mean), lower)


def _relinearised(own: Weighed, weights: Array) -> Expansion:
    """Return the expansion about the mean of the nodes, with all conditional modes as lines."""
    law, about, heads = own.law, own.start.about, own.cells.y.shape[1]
    top = np.flatnonzero(weights > 1e-3 * weights.max())
    told = own.white[:, heads : heads + law.size].T @ own.residual[:, top]
    nodes, weights = own.nodes[top], weights[top] / weights[top].sum()
    mean, spread = moments_of(weights, nodes)
    # Where one place of a coordinate has nearly all weight, there is no line along it.
    variances = 1e-3 * spread.diagonal() + (1e-3 * own.start.box.deviations) ** 2
    spread += np.diag(np.where(variances > 0.0, variances, 1.0))
    inverse, k = np.linalg.inv(spread), law.kernels
    of_kernel = np.zeros_like(inverse)
    of_kernel[:k, :k] = np.linalg.inv(spread[:k, :k])  # one kernel for all that share these
    before = about.at(slice(None), nodes)
    # What is linear in e^z goes on by the logarithm of a step.
    step = (told - before)[:RIG]
    told[:RIG] = before[:RIG] + np.sign(step) * np.log1p(np.abs(step))
    rig = _with_tails(own, top, weights, told)
    if own.start.rounds >= _DAMPED_FROM:
        told[RIG:], rig = 0.5 * (before + told)[RIG:], np.sqrt(about.rig * rig)
    state = told @ weights
    cross = ((told - state[:, None]) * weights) @ (nodes - mean)
    by_theta = cross @ inverse
    by_theta[KERNEL] = cross[KERNEL] @ of_kernel
    log_g = float(weights @ own.stiffness.log_g[top])
    wanted = Expansion(mean, log_g, state, by_theta, about.stresses, rig)
    return _damped(own, wanted)


def _with_tails(own: Weighed, top: Indices, weights: Array, states: Array) -> Array:
    """Return the variances of the rig's unknowns before the data, wider where it is off, (slots,).

    `top`: the nodes that count, with their weights and the unknowns there (k, M).
    """
    first, found = own.cells.y.shape[1] + RIG, own.covariance.variances.copy()
    columns = own.white[:, first : first + found.size]
    rows = own.white[:, first + found.size + top] * np.exp(own.stiffness.log_g[top])
    known, by_g = np.einsum("ij,ij->j", columns, columns), columns.T @ rows
    mean = states[RIG:] @ weights
    spread = (states[RIG:] - mean[:, None]) ** 2 + by_g**2 * own.stiffness.variance[top]
    variances = np.maximum(found - known + spread @ weights, TINY)
    for k, (one, _) in enumerate(own.law.slots):
        if one.has_tails:
            found[k] = with_tails(float(mean[k]), float(variances[k]), float(found[k]))
    return found


def _damped(own: Weighed, wanted: Expansion) -> Expansion:
    """Return a step of the law's errors, halved until it makes the mean node likelier."""
    law, covariance, start = own.law, own.covariance, own.start
    before = start.about.at(slice(None), wanted.theta[None])[:RIG, 0]
    step = wanted.state[:RIG] - before
    if np.max(np.abs(step)) < _SMALL_STEP:
        return wanted
    scales = start.scales
    roots = zip(covariance.roots, scales.smooth, strict=True)
    inverse = [(places, np.linalg.pinv(size * root)) for (places, root), size in roots if size]
    lower = cholesky(covariance.without_smooth(scales))
    columns = covariance.linear.columns[:, law.moving]
    rig = law.place.joined("stresses") + columns @ wanted.state[law.moving]

    def at(part: float) -> tuple[float, Expansion, Array]:
        state = np.append(before + part * step, wanted.state[RIG:])
        tried = replace(wanted, state=state)
        response = law.response(tried)
        white = solved(lower, np.column_stack([rig, response]))
        square, both = float(white[:, 1] @ white[:, 1]), float(white[:, 0] @ white[:, 1])
        cost = float(white[:, 0] @ white[:, 0]) - max(both, 0.0) ** 2 / max(square, 1e-300)
        cost += sum(float(np.sum((root @ state[places]) ** 2)) for places, root in inverse)
        log_g = math.log(max(both, 1e-9 * square, 1e-300) / max(square, 1e-300))
        # A record that the law cannot describe would have no stress but by an endless G.
        log_g = min(max(log_g, wanted.log_g - 1.0), wanted.log_g + 1.0)
        return cost, replace(tried, log_g=log_g), math.exp(log_g) * response

    first = at(0.0)[0]
    for part in (1.0, 0.5, 0.25, 0.1, 0.03):
        cost, found, stresses = at(part)
        if cost < first + 0.1:
            break
    return law.stressed_by(found, stresses)


def rounds(law: Law, noise: Noise, known: Grid | None = None) -> Iterator[Grid]:
    """Lay grids from nothing until each is settled or given up; the parameters are of `begun`."""
    for start in begun(law, noise, known):
        for _ in range(LAST_ROUNDS):
            grid = laid(law, noise, start)
            yield grid
            if grid.is_settled:
                break
            start = grid.after._replace(about=law.stressed(grid.after.about))
