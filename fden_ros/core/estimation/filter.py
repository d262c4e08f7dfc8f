# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The step of one block: exact for all nodes at once, where nodes and columns stay.

A new cell appends a row to S = L L^T, to its factor and to all that is whitened,

.. math::
    \ell = L^{-1} s, \qquad d^2 = S_{nn} - \ell^T \ell, \qquad \text{row} \leftarrow
    (\text{row} - \ell^T W) / d

so a and b of each node grow by one product, and its weight by the likelihood of its innovation: a
bank of exact conditional filters, marginalised over all that is linear (Schon, Gustafsson and
Nordlund, IEEE Trans. Signal Process. 53, 2005). There is no other approximation than the grid's.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.cells import Path, Press
from fden_ros.core.estimation.covariance import JITTER, Scales
from fden_ros.core.estimation.discrepancy import KERNEL, KERNEL_HATS
from fden_ros.core.estimation.face import Innovation
from fden_ros.core.estimation.grid import (
    Grid,
    Stiffness,
    cut,
    have_width,
    least_effective,
    log_evidence_of,
    log_sum,
    of_stiffness,
    prior_of_log_g,
    tempered,
    whitened,
)
from fden_ros.core.estimation.law import of_cells
from fden_ros.core.estimation.record import Block
from fden_ros.core.law import RATES

#: Cells that a filter takes before its grid is laid anew [1].
_ROOM = 48
#: A tool is bent by a stress of at most as many times the largest of the grid's cells [1]: where
#: the model bends it the wrong way, its stress would run away.
_MOST_STRESS = 10.0
#: Places of the scales that are less likely do not predict [1].
_LEAST_SHARE = 0.02


class _Row(NamedTuple):
    """What a new cell adds."""

    column: Array  #: (k,)
    responses: Array  #: (M,)
    rough: float  #: how far the walks have gone: of the roughness at a scale of 1 [Pa^2]
    force: float  #: [Pa^2]
    surface: float  #: [1]
    gain: float  #: stress by indentation of the surface [Pa]
    noise: float  #: variance [Pa^2]


class Filter:
    """The weighted nodes, block by block.

    Attributes
    ----------
    grid : Grid
        Which was laid last.
    count : int
        Cells by now.
    stiffness : Stiffness
        Ln G, its variance and the log evidence of all nodes, mixed over the scales. These are
        weighed at a laying; between two the likelihood under the leading ones counts.
    weights : ndarray, shape (M,)
        Of the nodes; tempered where these are too coarse for the posterior.
    is_coarse : bool
        They are.
    has_width : bool
        The weights resolve each axis of the grid's box.
    log_evidence : float
        Of the record by now.
    products : ndarray, shape (k, 1 + d + k + M)
        Of X P with y, itself and the responses, whitened.
    path : Path
        The newest points of the press.
    """

    stiffness: Stiffness
    weights: Array
    is_coarse: bool
    has_width: bool
    log_evidence: float

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        law, linear = grid.law, grid.linear
        self._heads = grid.cells.y.shape[1]
        press = law.place.presses[-1]
        self.path = Path(press.times, press.indentations, press.start).needed
        self._taken: list[tuple[_Row, float]] = []  #: new cells, and their stresses [Pa]
        self._begin(grid.start.scales, grid.lower, grid.white, grid.stiffness)
        # Rates of the lead, its changes, and the nodes.
        rises = np.diff(linear.driven, axis=0, prepend=0.0)
        self._driven = linear.driven[-1]
        elapsed = np.diff(press.times, prepend=press.times[0])
        y = np.maximum(np.multiply.outer(RATES, elapsed), 1e-12)
        since = press.times[-1] - press.times
        self._left = (np.exp(-np.multiply.outer(RATES, since)) * -np.expm1(-y) / y) @ rises
        self._weights = linear.weights
        self._stresses = linear.stresses[-2:].tolist()
        self._most_stress = _MOST_STRESS * float(linear.stresses.max())
        self._middles = press.middles[-2:].tolist()
        self._loading = grid.covariance.loading
        self._rough = float(grid.covariance.clocks.roughness[-1])

    def _begin(
        self, scales: Scales, lower: Array, white: Array, stiffness: Stiffness | None
    ) -> None:
        """Begin at the grid's own cells, at some scales.

        `stiffness`: of the nodes, mixed over the scales; None: at these alone.
        """
        grid, law = self.grid, self.grid.law
        self.scales, self._prior = scales, grid.covariance.prior(scales)
        self._least = least_effective(law)
        self._prior_of_log_g = prior_of_log_g(law)
        self.count, width = white.shape
        size = self.count + _ROOM
        self.lower = np.zeros(size * (size + 1) // 2)  #: rows of L, one after the other
        self.lower[: self.count * (self.count + 1) // 2] = lower[np.tril_indices(self.count)]
        self.white = np.zeros((size, width))
        self.white[: self.count] = white
        self.products = white[:, self._heads : self._heads + law.size].T @ white
        self.columns = np.zeros((size, law.size))
        self.columns[: self.count] = grid.linear.columns
        rows, own = white[:, self._heads + law.size :], white[:, : self._heads]
        own = own[:, :1] + own[:, 1:] @ grid.cells.off.T
        self._a = np.einsum("ij,ij->j", rows, rows)
        self._b = np.einsum("ij,ij->j", own, rows)
        self._rest = 0.5 * np.einsum("ij,ij->j", own, own) + np.log(lower.diagonal()).sum()
        clocks = grid.covariance.clocks
        # Covariances of the walks with those at a later cell: as they are, and by its gain.
        self._walks = np.zeros((2, size))
        self._walks[:, : self.count] = (clocks.press == clocks.press[-1]) * np.array(
            [
                scales.roughness**2 * clocks.roughness + clocks.force,
                scales.motion**2 * clocks.gain * clocks.surface,
            ]
        )
        self._first = self._now = self._weighed(None)
        self._mixed = stiffness or self._first
        self._mix()

    @property
    def is_resolved(self) -> bool:
        """Whether its grid has settled and still resolves the posterior."""
        return self.grid.is_settled and not self.is_coarse and self.has_width

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another cell."""
        return self.count >= len(self.white)

    def _mix(self) -> None:
        """Weigh the nodes."""
        grid, mixed, first, now = self.grid, self._mixed, self._first, self._now
        self.stiffness = Stiffness(
            mixed.log_g + now.log_g - first.log_g,
            mixed.variance * now.variance / first.variance,
            mixed.log + now.log - first.log,
        )
        log = self.stiffness.log + grid.log_prior
        # Nodes too far apart for their posterior: one of them alone would seem to know it.
        own = cut(grid.law, grid.nodes, log)
        self.weights, beta = tempered(own, self._least)
        self.is_coarse = beta < 1.0
        self.has_width = have_width(grid.places, self.weights)
        self.log_evidence = log_evidence_of(grid.law, log)

    @property
    def log_leading(self) -> float:
        """Log evidence of the record by now at the leading scales, with their prior as it is."""
        return float(log_sum(self._now.log + self.grid.log_prior))

    def _weighed(self, begin: Array | None) -> Stiffness:
        found = of_stiffness(self._a, self._b, *self._prior_of_log_g, begin)
        return found._replace(log=found.log - self._rest)

    @property
    def mean_dwell_time(self) -> float:
        """Mean time since the load was built up [s]."""
        return self._loading.age

    @property
    def sums(self) -> tuple[Array, Array]:
        """The sums a and b of all nodes, (M,) each."""
        return self._a, self._b

    def stress_ahead(self, times: Array) -> Array:
        """Return the stress that bends the tool at times ahead: as the model has come to."""
        middles = self._middles
        slope = (self._stresses[1] - self._stresses[0]) / max(middles[1] - middles[0], 1e-9)
        found = self._stresses[1] + slope * (times - middles[1])
        return np.clip(found, 0.0, self._most_stress)

    def append(self, tail: Press) -> Innovation | None:
        """Take the tail of the path; None: it was not observed, or there is no room."""
        row = self._row(tail)
        if row is None or self.is_full:
            return None
        stress = float(tail.stresses[0])
        self._taken.append((row, stress))
        return self._take(row, stress)

    def compared(self, tail: Press, stress: float) -> Innovation | None:
        """Compare the tail of the path with its prediction, and go along it without its stress."""
        row = self._row(tail)
        if row is None:
            return None
        ((mean, variance),) = self._predicted([row])
        return Innovation(mean, stress - mean, variance)

    def _take(self, row: _Row, stress: float) -> Innovation:
        n, heads, k = self.count, self._heads, self._heads + self.grid.law.size
        own, root, white = self._whitened(row, stress)
        end = n * (n + 1) // 2
        self.lower[end : end + n], self.lower[end + n], self.white[n] = own, root, white
        self.columns[n], self.count = row.column, n + 1
        self._walks[:, n] = self._walks_at(row)
        self.products = self.products + white[heads:k, None] * white
        seen = white[0] + self.grid.cells.off @ white[1:heads]
        off, variance = self._off(root, seen, white[k:])
        self._a = self._a + white[k:] ** 2
        self._b = self._b + seen * white[k:]
        self._rest = self._rest + 0.5 * seen**2 + math.log(root)
        self._now = self._weighed(self._now.log_g)
        self._mix()
        return Innovation(stress - off, off, variance)

    def ahead(self, times: Array, indentations: Array) -> tuple[Array, Array]:
        """Return mean and variance of the stress along a motion to come [Pa, Pa^2], (n,) each.

        Given the data each node predicts it as a Gaussian (kriging), at each likely place of the
        scales; the parameters are its times [s] and indentations [1], of shape (n,).
        """
        rows, state = [], copy.copy(self)
        for time, indentation in zip(times.tolist(), indentations.tolist(), strict=True):
            block = Block(time, 0.0, indentation, 0.0, 0.0, 0.0, 0.0, 1, 0.0, True)
            row = state._row(state.path.tail(block, 0.0))
            assert row is not None
            rows.append(row)
        likely = [(one, share) for one, share in self.grid.scales if share > _LEAST_SHARE]
        shares = np.array([share for _, share in likely])
        found = np.array([self._at(one)._predicted(rows) for one, _ in likely])
        means, variances = found.transpose(2, 0, 1)
        shares /= shares.sum()
        mean = shares @ means
        return mean, shares @ (variances + (means - mean) ** 2)

    def _at(self, scales: Scales) -> Filter:
        """Return the filter of the same cells at other scales."""
        found, grid = copy.copy(self), self.grid
        found._begin(scales, *whitened(grid.law, grid.covariance, scales, grid.cells), None)
        for row, stress in self._taken[: self.count - len(grid.lower)]:
            found._take(row, stress)
        return found

    def _predicted(self, rows: Sequence[_Row]) -> list[tuple[float, float]]:
        """Return mean and variance of the stress of cells of which there are no data."""
        found, k = [], self._heads + self.grid.law.size
        for row in rows:
            _, root, white = self._whitened(row, 0.0)
            seen = white[0] + self.grid.cells.off @ white[1 : self._heads]
            off, variance = self._off(root, seen, white[k:])
            found.append((-off, variance))
        return found

    def _whitened(self, row: _Row, stress: float) -> tuple[Array, float, Array]:
        """Return the row of L of a new cell, its diagonal, and the cell's row, whitened."""
        n, x = self.count, self._prior @ row.column
        at = self._walks_at(row)
        across = self.columns[:n] @ x + self._walks[0, :n] + row.gain * self._walks[1, :n]
        own = blas.dtpsv(n, self.lower[: n * (n + 1) // 2], across, lower=0, trans=1)
        variance = float(row.column @ x) + at[0] + row.gain * at[1] + row.noise
        root = math.sqrt(max(variance * (1.0 + JITTER) - float(own @ own), 1e-30))
        shift = row.column @ self.grid.covariance.expected
        shift[0] += stress
        white = (np.concatenate([shift, x, row.responses]) - own @ self.white[:n]) / root
        return own, root, white

    def _walks_at(self, row: _Row) -> tuple[float, float]:
        scales = self.scales
        rough = scales.roughness**2 * row.rough + row.force
        return rough, scales.motion**2 * row.gain * row.surface

    def _off(self, root: float, seen: Array, rows: Array) -> tuple[float, float]:
        """Return by how much a cell is off its prediction, and the variance of that."""
        by_g = rows * np.exp(self.stiffness.log_g)
        each = root * (seen - by_g)
        mean = float(self.weights @ each)
        spread = root**2 * (1.0 + by_g**2 * self.stiffness.variance) + (each - mean) ** 2
        return mean, float(self.weights @ spread)

    def _row(self, tail: Press) -> _Row | None:
        """Take the points of a block; return the row of its cell, None where it has none."""
        grid, law = self.grid, self.grid.law
        # A press that was gathered anew may begin elsewhere.
        tail = replace(tail, start=law.place.presses[-1].start)
        times, newest = tail.times, self.path.times[-1]
        at, free = grid.linear.at, grid.linear.free
        driven, slopes = law.drive(tail, self.stress_ahead(times), at, free)
        self.path = self.path.after(tail)
        rises = driven - np.concatenate([self._driven[None], driven[:-1]])
        seconds = np.maximum(times - np.concatenate([[newest], times[:-1]]), 1e-9)
        y = np.maximum(np.multiply.outer(RATES, seconds), 1e-12)
        since = times[:, None] - times
        left = np.exp(np.multiply.outer(-RATES, np.where(since >= 0.0, since, np.inf)))
        mean = np.full(times.size, 1.0 / times.size)
        # What is left of the rises, and of all before, at each point.
        into = left * (-np.expm1(-y) / y)[:, None, :]
        decay = left[:, :, 0] * np.exp(-y[:, :1])
        before = self._left
        self._left, self._driven = decay[:, -1:] * before + into[:, -1] @ rises, driven[-1]
        if not tail.middles.size:
            return None
        # A cell is the mean of the points that the tail has.
        rates = np.vstack(
            [
                (decay @ mean)[:, None] * before + mean @ into @ rises,
                mean @ driven,
                mean / seconds @ rises,
            ]
        )
        total = np.einsum("rc,rc->c", self._weights, rates)
        k = 1 + law.size
        column = total[1:k]
        if law.has_kernel_error:
            column[KERNEL] += (self._weights[:, 0] * rates[:, 0]) @ KERNEL_HATS
        law.add_stress_columns(tail, total[:1], column[None])
        load, gain, steepest = of_cells(tail, driven[:, 0], slopes)
        noise = grid.covariance.noise_of(tail, gain, steepest, total[:1])
        return self._row_of(tail, total[:k], total[k:], float(load[0]), float(gain[0]), noise)

    def _row_of(
        self, tail: Press, lead: Array, responses: Array, load: float, gain: float, noise: Array
    ) -> _Row:
        """Return the row of the newest cell from now on."""
        covariance, stress, middle = self.grid.covariance, float(lead[0]), float(tail.middles[0])
        seconds = middle - self._middles[-1]
        self._loading, turned = self._loading.after(load + covariance.floor, seconds)
        self._stresses = [self._stresses[-1], stress]
        self._middles = [self._middles[-1], middle]
        self._rough = self._rough + stress**2 * turned
        force, surface = covariance.walked(tail)
        gain *= covariance.surface_factor
        return _Row(lead[1:], responses, self._rough, float(force[0]), float(surface[0]), gain,
                    float(noise[0]))  # fmt: skip
