# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The law as the mean of all presses of a place, and by what each unknown changes it.

The stress at G = 1 of press q is

.. math::
    r_q = M_q\, d\max(\psi_q - F_q, 0), \qquad F_q = E_q\,(w(\alpha)\,m_q), \qquad
    m_{q+1} = D\,m_q + A_q \max(r_q, 0)

with psi the elastic response of the motion, M_q the relaxation of the press's rises, and m the
moments of the stress at the rates of the creep, which is what the tissue remembers: F is its free
surface. All of it is homogeneous in G. Another law is a subclass.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.cells import CREEP_RATES, Place, Press
from fden_ros.core.estimation.discrepancy import (
    CURVE,
    KERNEL,
    KERNEL_HATS,
    KERNEL_SLOPES,
    RIG,
    between_rates,
    last_knot,
    splines,
)
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.nuisance import Motion, Nuisance, Rig
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    MAX_EXPONENT,
    RATES,
    SPACING,
    Geometry,
    relaxation_weights,
)

#: States beyond as many standard deviations count as there [1].
_MOST = 8.0


@dataclass(frozen=True, eq=False)
class Expansion:
    """What columns are taken about: a node, G, and the unknowns z as a line in theta."""

    theta: Array  #: (d,)
    log_g: float
    state: Array  #: of the errors at their knots, and of the rig in deviations, (k,)
    by_theta: Array  #: (k, d)
    stresses: Array  #: at the points, by the model [Pa], (n,)
    rig: Array  #: variances of the rig's unknowns before the data, in deviations, (slots,)

    def at(self, places: slice | list[int], nodes: Array) -> Array:
        """Return some unknowns at nodes, (k, M)."""
        found = self.state[places, None] + self.by_theta[places] @ (nodes - self.theta).T
        return np.asarray(np.minimum(np.maximum(found, -_MOST), _MOST))


class AtNodes(NamedTuple):
    """An expansion at its own node, the first, and at others: what no motion changes."""

    about: Expansion
    nodes: Array  #: (1 + M, d)
    bend: Array  #: epsilon at its knots, (22, 1 + M)
    moving: Array  #: what moves the points, in deviations, (moves, 1 + M)


class Moments(NamedTuple):
    """Moments of the stress of presses at the rates of the creep.

    Times the weights of the creep they are the free surface that these presses have left. A model
    is an array with columns of the leading node, times its G, of the changes of that by the k
    unknowns, and of M nodes for G = 1.
    """

    end: float  #: when they ended [s]
    model: Array  #: (33, 1 + k + M)

    def times(self, weights: Array | float) -> Moments:
        """Return their product with weights."""
        return Moments(self.end, weights * self.model)

    def after(self, press: Press, model: Array, size: int) -> Moments:
        """Return them after a press, of whose cells the model is given; `size`: k."""
        decay = np.exp(-CREEP_RATES * (press.end - self.end))[:, None]
        return Moments(press.end, decay * self.model + press.into_moments @ _pushed(model, size))

    def left(self, press: Press) -> Array:
        """Return the sum of what is left at the points of a later press, (n, 1 + k + M)."""
        elapsed = np.maximum(press.times - self.end, 0.0)
        return np.asarray(np.exp(-np.multiply.outer(elapsed, CREEP_RATES)) @ self.model)


class Linear(NamedTuple):
    """The cells of a place about one node."""

    stresses: Array  #: by the model [Pa], (N,)
    columns: Array  #: by what one standard deviation of each unknown changes them, (N, k)
    loads: Array  #: psi at the cells [Pa s^alpha], (N,)
    gains: Array  #: stress by indentation at the cells, without relaxation, (N,)
    steepest: Array  #: the same at the steeper end of a cell, (N,)
    driven: Array  #: the model of psi less the free surface, at the points of the newest press
    free: Moments | None  #: the free surface before that; None: no press was before
    weights: Array  #: of the relaxation of each column of a model by rate, (34, 1 + k + M)
    at: AtNodes


@dataclass(frozen=True, eq=False)
class Law:
    """FDEN: alpha, ln Gn and the contact point are what a node has.

    The first `kernels` coordinates of a node are of the relaxation, the next is of the
    stress-strain curve, the last is the contact point.
    """

    config: EstimatorConfig
    geometry: Geometry
    place: Place
    rig: Rig
    contact_point_sd: float

    kernels: ClassVar = 1
    #: Nodes along each coordinate, and of the broad grid that begins.
    counts: ClassVar[tuple[int, ...]] = (7, 9, 7)
    broad: ClassVar[tuple[int, ...]] = (9, 13, 7)
    #: They have the moments of the posterior, not its evidence alone.
    has_close_nodes: ClassVar = True
    has_kernel_error: ClassVar = True

    @functools.cached_property
    def deepest(self) -> float:
        """The largest indentation of a cell [1]."""
        return max(float(p.indentations[p.last].max()) for p in self.place.presses)

    @functools.cached_property
    def last_knot(self) -> float:
        """The strain of the last knot of epsilon [1]: beyond the largest one."""
        return last_knot(self.geometry.strain(max(self.deepest + self.contact_point_sd, 0.0)))

    def are_beyond(self, nodes: Array) -> Array:
        """Return whether the largest strain is beyond 1/Gn, where the curve bends, (M,)."""
        strain, _ = self.strain(self.deepest - nodes[:, -1])
        return np.asarray(strain * np.exp(nodes[:, self.kernels]) > 1.0)

    # What another law has otherwise

    @functools.cached_property
    def slots(self) -> list[tuple[Nuisance, tuple[int, ...]]]:
        """The rig's places in a state: nuisances, and the presses of which one is."""
        every, spots = tuple(range(len(self.place.presses))), [p.spot for p in self.place.presses]
        found = [(one, every) for one in self.rig.nuisances if not one.is_per_press]
        for q, spot in enumerate(spots):
            found += [(one, (q,)) for one in self.rig.nuisances if one.is_per_press]
            if self.place.is_new_spot(q):
                of_spot = tuple(k for k, own in enumerate(spots) if own == spot)
                found += [(one, of_spot) for one in self.rig.spots[spot]]
        return found

    @property
    def of_spot(self) -> tuple[int, int] | None:
        """The places in a state of what the newest spot has otherwise: G, and its contact point.

        None: it is the first spot.
        """
        press = self.place.presses[-1]
        if press.spot == self.place.presses[0].spot:
            return None
        stiffness, contact_point = self.rig.spots[press.spot]
        own = [one for one, _ in self.slots]
        return RIG + own.index(stiffness), RIG + own.index(contact_point)

    @property
    def size(self) -> int:
        """Unknowns in a state."""
        return RIG + len(self.slots)

    @property
    def coordinates(self) -> tuple[Array, Array]:
        """The prior's means and standard deviations of a node."""
        p = self.config.prior
        pairs = (
            (p.fractional_order, p.fractional_order_sd),
            (p.mean[1], p.nonlinear_stiffness_log_sd),
            (0.0, self.contact_point_sd),
        )
        mean, sds = np.array(pairs).T
        return mean, sds

    def inside(self, nodes: Array) -> Array:
        """Return whether there are such nodes; an alpha that is given may be 0."""
        if self.coordinates[1][0] == 0.0:
            return np.ones(len(nodes), dtype=bool)
        return np.asarray((nodes[:, 0] >= LOWEST_ORDER) & (nodes[:, 0] <= HIGHEST_ORDER))

    def weights(self, nodes: Array) -> Array:
        """Return the relaxation of nodes by its rates, (34, M)."""
        return relaxation_weights(np.clip(nodes[:, 0], LOWEST_ORDER, HIGHEST_ORDER))

    def creep(self, nodes: Array, errors: Array) -> tuple[Array, Array]:
        """Return the creep of nodes by its rates, (33, M), and ln of the first by its errors.

        A relaxation whose weights are h about the rate 1/t is there as t^-n, with n = alpha less
        the slope of delta over ln t; the weights of the creep are (sin(pi n) / pi)^2 / (t h).

        Parameters
        ----------
        errors : ndarray, shape (11, M)
            delta at its knots.
        """
        orders = np.clip(nodes[:, 0], LOWEST_ORDER, HIGHEST_ORDER)
        local = orders - KERNEL_SLOPES @ errors
        inside = np.clip(local, LOWEST_ORDER, HIGHEST_ORDER)
        ratio = np.sin(np.pi * inside) / np.sin(np.pi * orders)
        by_slope = 2.0 * np.pi / np.tan(np.pi * inside[:, 0]) * (inside == local)[:, 0]
        by_errors = -KERNEL_HATS[:-1] - by_slope[:, None] * KERNEL_SLOPES
        slow = RATES[0] ** (1.0 - orders) / np.expm1(SPACING * (1.0 - orders))
        weights = SPACING * np.sin(np.pi * orders) / np.pi * ratio**2
        weights = weights * np.vstack([np.power.outer(RATES, 1.0 - orders), slow])
        return weights * np.exp(-(KERNEL_HATS @ errors)[:-1]), by_errors

    def relaxed(self, node: Array, times: Array) -> Array:
        """Return what is left of a unit step after times [s]."""
        order = float(np.clip(node[0], LOWEST_ORDER, HIGHEST_ORDER))
        return np.asarray(times**-order / math.gamma(1.0 - order))

    # The elastic response

    def shape(self, strain: Array, log_gn: Array | float) -> Array:
        """Return phi for G = 1."""
        gn = np.exp(log_gn)
        excess = gn * np.abs(strain)
        excess -= 1.0
        found = np.asarray(np.maximum(excess, 0.0))
        np.exp(np.minimum(found, MAX_EXPONENT, out=found), out=found)
        found += np.minimum(excess, 0.0)
        found /= gn
        return found if self.geometry.is_one_sided else np.copysign(found, strain)

    def slope(self, strain: Array, log_gn: Array | float) -> Array:
        """Return its derivative by the strain."""
        excess = np.exp(log_gn) * np.abs(strain) - 1.0
        found = np.exp(np.clip(excess, 0.0, MAX_EXPONENT))
        return np.where(strain > 0.0, found, 0.0) if self.geometry.is_one_sided else found

    def strain(self, indentation: Array) -> tuple[Array, Array]:
        """Return strains and their derivatives by the indentation from the contact point."""
        if not self.geometry.is_one_sided:
            return indentation, np.ones_like(indentation)
        u = np.maximum(indentation, 0.0)
        if self.geometry.exponent == 1.0:
            return u, np.ones_like(u)
        found = self.geometry.strains(u)
        return found.values, found.slopes

    def indentations(self, press: Press, contact_points: Array) -> Array:
        """Return the indentations of points from contact points (M,), as measured, (n, M).

        The contact point of another spot is one of the unknowns that move the points.
        """
        spot = self.place.presses[self.place.number_of(press)].spot
        is_first = spot == self.place.presses[0].spot
        return np.asarray(press.indentations[:, None] - is_first * contact_points)

    @functools.cached_property
    def moving(self) -> list[int]:
        """The places in a state of what moves points."""
        return [k for k, (one, _) in enumerate(self.slots, RIG) if one.moves]

    def moves(self, press: Press, stresses: Array, about: Expansion) -> Array:
        """Return the columns of what moves points, (n, moves)."""
        motion = Motion(
            press.times - press.start, press.indentations, press.speeds, stresses, press.earlier
        )
        number = self.place.number_of(press)
        found = np.zeros((press.times.size, len(self.moving)))
        for j, k in enumerate(self.moving):
            one, presses = self.slots[k - RIG]
            if number in presses:
                found[:, j] = one.column(motion._replace(size=float(about.state[k])))
        return found

    def at_nodes(self, about: Expansion, nodes: Array) -> AtNodes:
        """Return an expansion at its node and at others, (M, d)."""
        both = np.vstack([about.theta, nodes])
        return AtNodes(about, both, about.at(CURVE, both), about.at(self.moving, both))

    def drive(
        self, press: Press, stresses: Array, at: AtNodes, free: Moments | None
    ) -> tuple[Array, Array]:
        """Return what drives the relaxation at points of a press; `stresses`: there [Pa].

        Returns
        -------
        model : ndarray, shape (n, 1 + k + M)
            psi less the free surface.
        slopes : ndarray, shape (n,)
            Of the leading node's stress by the indentation.
        """
        moves = self.moves(press, stresses, at.about)
        strain, by_u = self.strain(self.indentations(press, at.nodes[:, -1]) + moves @ at.moving)
        n, k, lead_strain = press.times.size, self.size, strain[:, 0]
        near = np.concatenate([lead_strain, np.abs(lead_strain) + 1e-4])
        basis, ahead = splines(near, self.last_knot).reshape(2, n, -1)
        psi = self.shape(strain, at.nodes[:, self.kernels])
        if at.bend.any():
            psi *= np.exp(basis @ at.bend)
        g, own = math.exp(at.about.log_g), at.bend[:, 0]
        lead = g * psi[:, 0]
        tilted = (ahead - basis) @ own / 1e-4
        slopes = g * self.slope(lead_strain, at.nodes[0, self.kernels]) * np.exp(basis @ own)
        slopes = (slopes + np.abs(lead) * tilted) * by_u[:, 0]
        model = np.hstack([lead[:, None], np.zeros((n, k)), psi[:, 1:]])
        changes = model[:, 1 : 1 + k]
        changes[:, CURVE] = lead[:, None] * basis
        changes[:, self.moving] = slopes[:, None] * moves
        if free is None:
            return model, slopes
        model -= free.left(press)
        return _pushed(model, k), slopes * (model[:, 0] > 0.0)

    # The stress of the cells

    def kernels_of(self, nodes: Array, about: Expansion) -> tuple[Indices, Array, Array, Array]:
        """Return the different relaxations of the expansion's node and of others.

        Returns
        -------
        which : ndarray, shape (1 + k + M,)
            That of each column of a model.
        weights : ndarray, shape (34, 1 + kernels)
            By rate; the expansion's own are the first.
        some, errors : ndarray, shape (1 + kernels, d), (11, 1 + kernels)
            Nodes that have these, and delta there at its knots.
        """
        keys = nodes[:, : self.kernels].round(12) @ np.array([1.0, 997.0])[: self.kernels]
        _, first, own = np.unique(keys, return_index=True, return_inverse=True)
        some = np.vstack([about.theta, nodes[first]])
        errors = about.at(KERNEL, some)
        weights = self.weights(some) * np.exp(KERNEL_HATS @ errors)
        which = np.append(np.zeros(1 + self.size, dtype=np.intp), 1 + own)
        return which, weights, some, errors

    def response(self, about: Expansion) -> Array:
        """Return the stress of all cells at the expansion's node for G = 1, (N,)."""
        place, node = self.place, about.theta[None]
        _, weights, some, errors = self.kernels_of(node[:0], about)
        at = self.at_nodes(about, node[:0])
        past = Moments(place.older_end, place.older[:, None] * math.exp(-about.log_g))
        found: list[Array] = []
        for q, (press, points) in enumerate(zip(place.presses, place.point_slices, strict=True)):
            moves = self.moves(press, about.stresses[points], about)
            strain = self.strain(self.indentations(press, node[:, -1]) + moves @ at.moving)[0]
            psi = self.shape(strain, about.theta[self.kernels])
            if at.bend.any():
                psi *= np.exp(splines(strain[:, 0], self.last_knot) @ at.bend)
            if place.is_new_spot(q):
                past = past.times(0.0)
            elif past.model.any():
                free = past.times(self.creep(some, errors)[0])
                psi = np.maximum(psi - free.left(press), 0.0)
            found.append(weights[:, 0] @ (press.memory @ np.diff(psi[:, 0], prepend=0.0)))
            if len(found) < len(place.presses):
                past = past.after(press, found[-1][:, None], 0)
        return np.concatenate(found)

    def responses(self, nodes: Array, about: Expansion) -> tuple[Array, Linear]:
        """Return the stress of all cells at nodes for G = 1, (N, M), and what is linear.

        Each press of the place meets the free surface of those before.
        """
        which, weights, some, errors = self.kernels_of(nodes, about)
        place, k = self.place, self.size
        model = np.zeros((place.cell_slices[-1].stop, which.size))
        loads, gains, steepest = np.zeros((3, len(model)))
        older = np.outer(
            place.older, np.where(np.arange(which.size) > k, math.exp(-about.log_g), 0.0)
        )
        older[:, 0] = place.older
        past, free, at = Moments(place.older_end, older), None, self.at_nodes(about, nodes)
        slices = zip(place.point_slices, place.cell_slices, strict=True)
        for q, (press, (points, cells)) in enumerate(zip(place.presses, slices, strict=True)):
            if place.is_new_spot(q):
                past, free = past.times(0.0), None
            elif past.model.any():
                back, by_errors = self.creep(some, errors)
                free = past.times(back[:, which])
                free.model[:, 1 : 1 + k][:, KERNEL] += free.model[:, :1] * by_errors
            driven, slopes = self.drive(press, about.stresses[points], at, free)
            kernels = (weights.T @ press.memory.reshape(len(weights), -1)).reshape(
                -1, *press.memory.shape[1:]
            )
            rises, own = np.diff(driven, axis=0, prepend=0.0), model[cells]
            for j, kernel in enumerate(kernels):
                own[:, which == j] = kernel @ rises[:, which == j]
            stresses, columns = own[:, 0], own[:, 1 : 1 + k]
            if self.has_kernel_error:
                left = press.memory @ rises[:, 0]
                columns[:, KERNEL] += (weights[:, :1] * left).T @ KERNEL_HATS
            self.add_stress_columns(press, stresses, columns)
            loads[cells], gains[cells], steepest[cells] = of_cells(press, driven[:, 0], slopes)
            if q + 1 < len(place.presses):
                past = past.after(press, own, k)
        linear = Linear(
            model[:, 0], model[:, 1 : 1 + k], loads, gains, steepest, driven, free,
            weights[:, which], at,
        )  # fmt: skip
        return model[:, 1 + k :], linear

    def add_stress_columns(self, press: Press, stresses: Array, columns: Array) -> None:
        """Add what changes the stress of a press directly to the columns of its cells."""
        first, last, number = press.first, press.last, self.place.number_of(press)
        points = press.indentations, press.speeds
        indentations, speeds = (0.5 * (values[first] + values[last]) for values in points)
        motion = Motion(press.middles - press.start, indentations, speeds, stresses)
        for k, (one, presses) in enumerate(self.slots, RIG):
            if not one.moves and number in presses:
                columns[:, k] = one.column(motion)

    def stressed(self, about: Expansion) -> Expansion:
        """Return it with the stress at the points by the model: it bends a compliant tool."""
        n = sum(press.times.size for press in self.place.presses)
        about = replace(about, stresses=np.zeros(n)) if about.stresses.size != n else about
        if not any(one.name == "compliance" for one in self.rig.nuisances):
            return about
        return self.stressed_by(about, math.exp(about.log_g) * self.response(about))

    def stressed_by(self, about: Expansion, stresses: Array) -> Expansion:
        """Return it with the stress at the points that follows from that of the cells [Pa]."""
        found = []
        for press, cells in zip(self.place.presses, self.place.cell_slices, strict=True):
            at = np.append(press.times[0], press.middles)
            found.append(np.interp(press.times, at, np.append(0.0, stresses[cells])))
        return replace(about, stresses=np.concatenate(found))


def of_cells(press: Press, lead: Array, slopes: Array) -> tuple[Array, Array, Array]:
    """Return load, stiffness and largest stiffness of cells."""
    first, last = press.first, press.last
    load = 0.5 * (np.abs(lead[first]) + np.abs(lead[last]))
    gain, steepest = 0.5 * (slopes[first] + slopes[last]), np.maximum(slopes[first], slopes[last])
    return load, gain, steepest


def _pushed(model: Array, size: int) -> Array:
    """Return a model of a probe that leaves the surface where it would pull; `size`: k."""
    found = np.maximum(model, 0.0)
    found[:, 1 : 1 + size] = model[:, 1 : 1 + size] * (model[:, :1] > 0.0)
    return found


class Plateau(Law):
    """Another law: the same curve, and the relaxation of a standard linear solid.

    Its coordinates are the logit of the part that stays, ln of the rate, ln Gn and the contact
    point.
    """

    kernels: ClassVar = 2
    counts: ClassVar[tuple[int, ...]] = (5, 5, 5, 3)
    broad: ClassVar[tuple[int, ...]] = (5, 5, 7, 3)
    has_close_nodes: ClassVar = False
    has_kernel_error: ClassVar = False

    @property
    def coordinates(self) -> tuple[Array, Array]:
        """The prior's means and standard deviations of a node."""
        mean, sds = super().coordinates
        newest = self.place.presses[-1]
        rate = -math.log(0.3 * float(newest.middles[-1] - newest.times[0]))
        return np.array([0.0, rate, *mean[1:]]), np.array([1.5, 1.5, *sds[1:]])

    def inside(self, nodes: Array) -> Array:
        """Return whether there are such nodes: beyond the rates they are as at the last."""
        return np.ones(len(nodes), dtype=bool)

    def weights(self, nodes: Array) -> Array:
        """Return a constant, and an exponential between two rates."""
        part = 1.0 / (1.0 + np.exp(-nodes[:, 0]))
        found = np.zeros((RATES.size + 2, len(nodes)))
        found[:-2] = (1.0 - part) * between_rates(nodes[:, 1])
        found[-2] = part
        return found

    def relaxed(self, node: Array, times: Array) -> Array:
        """Return what is left of a unit step after times [s]."""
        part = 1.0 / (1.0 + math.exp(-node[0]))
        return np.asarray(part + (1.0 - part) * np.exp(-math.exp(node[1]) * times))
