# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The response of the FDEN law on a grid of parameters, in constant memory.

The stress :math:`f = D^\alpha \varphi(x(u - o); G, G_n)` is linear in G and smooth in ln Gn, alpha
and the strain origin o. So it is computed once per sample at nodes of the three, from the same
exponentials as the fractional integral, and interpolated in between: any parameters can be tried
later on samples that are gone.

For strain linear in time between samples, with :math:`q_j` the decayed memory of the exponential j
and :math:`w_j` the weights of the kernel of order :math:`1-\alpha`:

.. math::
    (D^\alpha \varphi)_k = \sum_j w_j q_j + \frac{h^{-\alpha}}{\Gamma(2-\alpha)}
    (\varphi_k - \varphi_{k-1}), \qquad
    z_j \leftarrow q_j + \frac{1 - e^{-s_j h}}{s_j h} (\varphi_k - \varphi_{k-1})

(Caputo's derivative; the L1 scheme on the newest step, exact for the piecewise linear signal.)
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import MAX_EXPONENT, phi
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.kernel import (
    MOST_WAITING,
    Decays,
    decays_of,
    derivative_weights,
    order_nodes,
    relaxation_rates,
)

#: Between two samples the compression is linear in time, and phi in parts no longer than this [1]:
#: steps ten times as long, in up to eight parts, then err by less than 1e-3
#: (test_core_stress_basis).
_LONGEST_PART = 0.002
#: Parts of one step at most [1], so that a jump of the motion costs no more than this.
_MOST_PARTS = 8


class StressBasis:
    """Responses to one motion at all nodes.

    Parameters
    ----------
    geometry : Geometry
    log_gn_nodes : ndarray, shape (n,)
        Nodes of ln Gn [1].
    origin_nodes : ndarray, shape (m,)
        Nodes of the strain origin, as compression [1].
    """

    def __init__(self, geometry: Geometry, log_gn_nodes: Array, origin_nodes: Array) -> None:
        self._geometry = geometry
        self._origins = [float(origin) for origin in origin_nodes]
        #: Gn of the law's signals, shape (n, 1): the nodes of the origin run fastest.
        self._gn = np.exp(log_gn_nodes)[:, None]
        self._shape = (log_gn_nodes.size, origin_nodes.size)
        self._signal_count = log_gn_nodes.size * origin_nodes.size
        self._rates = relaxation_rates()
        self._weights = derivative_weights()
        self._orders = np.array(order_nodes())
        self._local_scale = 1.0 / gamma(2.0 - self._orders)
        # After the law's signals, one for each order: what phi was while nobody touched; then a
        # pulse of phi in the past.
        self._free = slice(self._signal_count, self._signal_count + self._orders.size)
        # Last, at the running linearisation, phi' times the force, which a compliance multiplies,
        # phi' times the noise of the motion, and phi' in this contact, which a shift of the
        # surface multiplies.
        self._pulse, self._yielding = self._free.stop, self._free.stop + 1
        self._jittering = self._yielding + 1
        self._shifting = self._jittering + 1
        self._linearised = slice(self._yielding, self._shifting + 1)
        self._running_gn = float(np.exp(np.mean(log_gn_nodes)))
        self._running_origin = np.full(origin_nodes.size, 1.0 / origin_nodes.size)
        self._force = self._last_force = self._last_jitter = self._last_shift = 0.0
        columns = self._shifting + 1
        self._memory = np.zeros((self._rates.size, columns))
        #: Of the responses at every sample of the block.
        self._sum = np.zeros((self._orders.size, columns))
        self._last = np.zeros(columns)
        self._count = 0
        self._prepared_steps: tuple[tuple[float, ...], ...] = ()
        self._waiting: list[tuple[float, float, float, float]] = []
        #: None: in the air.
        self._compression: float | None = None
        self._strains = np.zeros(len(self._origins))

    def linearise(self, gn: float, in_origin: Array, force: float) -> None:
        """Set where the response to a compliance is linearised from here on.

        Parameters
        ----------
        gn : float
            Gn [1].
        in_origin : ndarray, shape (m,)
            Weights of the origin's nodes.
        force : float
            Force that bends the tool at the last sample [N]; it has grown since it was set before.
        """
        self._running_gn, self._running_origin, self._force = gn, in_origin, force

    def _slopes(self, strains: Array) -> Array:
        """Return dphi/dx at G = 1 for strains (n, origins), at the linearisation, shape (n,)."""
        strain = strains @ self._running_origin
        excess = np.minimum(np.maximum(self._running_gn * strain - 1.0, 0.0), MAX_EXPONENT)
        slopes: Array = np.where(strain > 0.0, np.exp(excess), 0.0)
        return slopes

    def press(self, step: float, compression: float, jitter: float = 0.0) -> None:
        """Take a sample in contact `step` seconds after the last, off the motion by `jitter`."""
        before = self._compression
        way = compression - before if before is not None and step > 0.0 else 0.0
        parts = min(max(math.ceil(abs(way) / _LONGEST_PART), 1), _MOST_PARTS)
        for left in range(parts - 1, 0, -1):
            self._waiting.append((step / parts, compression - way * left / parts, 0.0, jitter))
        self._waiting.append((step / parts, compression, 1.0, jitter))
        self._compression = compression
        self._count += 1
        if len(self._waiting) >= MOST_WAITING:
            self._catch_up()

    def _catch_up(self) -> None:
        """Take the samples that wait, all at once: several times faster than one by one."""
        if not self._waiting:
            return
        steps, compressions, counts, jitters = zip(*self._waiting, strict=True)
        self._waiting.clear()
        strain = self._geometry.strain
        strains = np.array([[strain(u - o) for o in self._origins] for u in compressions])
        if steps[0] <= 0.0:
            # The first sample of all: the memory begins here.
            steps, counts, jitters = steps[1:], counts[1:], jitters[1:]
            self._strains, strains = strains[0], strains[1:]
            if not steps:
                return
        # From here on with what was before the first step.
        strains = np.concatenate([self._strains[None], strains])
        self._strains = strains[-1]
        signals = np.zeros((len(steps) + 1, self._last.size))
        signals[0] = self._last
        signals[1:, : self._signal_count] = self._law(strains[1:])
        change = signals[1:] - signals[:-1]
        moved = np.ones((len(steps) + 1, 3))
        force_step = (self._force - self._last_force) / len(steps)
        moved[:, 0] = self._last_force + force_step * np.arange(len(steps) + 1)
        moved[0, 1], moved[1:, 1] = self._last_jitter, jitters
        moved[0, 2] = self._last_shift
        moved *= self._slopes(strains)[:, None]
        change[:, self._linearised] = moved[1:] - moved[:-1]
        kept = self._last[self._linearised] + moved[-1] - moved[0]
        self._last, self._last_force = signals[-1], self._force
        self._last_jitter, self._last_shift = jitters[-1], 1.0
        self._last[self._linearised] = kept
        if (steps, counts) != self._prepared_steps:
            self._prepare(steps, counts)
            self._prepared_steps = (steps, counts)
        size = self._rates.size
        gained = self._gains @ change
        self._sum += self._start_weights @ self._memory
        self._sum += gained[size:]
        self._memory *= self._whole_decay
        self._memory += gained[:size]
        before, strains = strains[:-1], strains[1:]
        touches = (before < 0.0) & (strains > 0.0)
        for k, origin in np.argwhere(touches) if touches.any() else ():
            share = strains[k, origin] / (strains[k, origin] - before[k, origin])
            columns = slice(origin, self._signal_count, self._shape[1])
            self._begin_within(int(k), share * float(steps[k]), columns, change[k, columns])

    def _prepare(self, steps: tuple[float, ...], counts: tuple[float, ...]) -> None:
        self._decays = decays_of(steps, counts)
        self._gain = self._decays.mean
        self._local = self._locals(np.array(steps)) * np.array(counts)
        self._counts = counts
        after = self._weights @ (self._gain * self._decays.sums_after) + self._local
        #: What a change over each step adds to the memory, and to the sum of the responses.
        self._gains = np.concatenate([self._gain * self._decays.to_end, after])
        self._start_weights = self._weights * self._decays.sum_of_start
        self._whole_decay = self._decays.whole[:, None]

    def _begin_within(self, k: int, duration: float, columns: slice, change: Array) -> None:
        """Let the change over step k have begun at the touch, `duration` before its end."""
        own = slice(k, k + 1)
        gain = Decays((duration,), (1.0,)).mean - self._gain[:, own]
        local = self._locals(np.array([duration])) * self._counts[k]
        after = self._weights @ (gain * self._decays.sums_after[:, own])
        self._memory[:, columns] += gain * self._decays.to_end[:, own] * change
        self._sum[:, columns] += (after + local - self._local[:, own]) * change

    def _law(self, strains: Array) -> Array:
        """Return phi at G = 1 for strains (n, origins), shape (n, nodes * origins).

        Above the strain origin there is no contact, and phi is 0.
        """
        touching = np.maximum(strains, 0.0)[:, None, :]
        return phi(touching, 1.0, self._gn).reshape(strains.shape[0], -1)

    def _locals(self, steps: Array) -> Array:
        """Return what a change over each step counts for at its end, shape (orders, n)."""
        result: Array = steps ** -self._orders[:, None] * self._local_scale[:, None]
        return result

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air, where phi is D^-alpha of the stress so far.

        Parameters
        ----------
        steps : tuple of float
            [s].
        free_responses : ndarray, shape (steps, orders)
            phi at the end of each step; in between it is taken for linear.
        """
        self._catch_up()
        self._compression = None
        signals = np.zeros((len(steps), self._last.size))
        signals[:, self._free] = free_responses
        change = np.diff(signals, axis=0, prepend=self._last[None])
        decays = Decays(steps, (1.0,) * len(steps))
        self._memory *= decays.whole[:, None]
        self._memory += (decays.mean * decays.to_end) @ change
        self._last = signals[-1]
        self._last_force = self._last_jitter = self._last_shift = 0.0

    def begin_contact(self) -> None:
        """Forget the block so far, and the response to a shift of the surface before."""
        self.discard_block()
        self._memory[:, self._shifting] = 0.0

    def freeze(self, first: int, law: Array, pulse_duration: float) -> None:
        """Let all motion so far be remembered as that of a tissue now left behind.

        The time of the change is uncertain by up to `pulse_duration`: a pulse of phi, which lasts
        that long and ends now, is kept in a column of its own.

        Parameters
        ----------
        first : int
            First node of ln Gn that counts.
        law : ndarray, shape (k, m)
            Weights of the nodes of ln Gn from `first` on and of the origin, G included.
        pulse_duration : float
            Time for which the new tissue may have been there already [s].
        """
        self._catch_up()
        count = self._signal_count
        start = first * self._shape[1]
        used = slice(start, start + law.size)
        self._memory[:, self._free] += (self._memory[:, used] @ law.ravel())[:, None]
        self._last[self._free] += self._last[used] @ law.ravel()
        self._memory[:, self._pulse] = np.expm1(-self._rates * pulse_duration)
        for columns in (slice(0, count), self._linearised):
            self._memory[:, columns] = 0.0
            self._last[columns] = 0.0

    def take_block(self) -> tuple[Array, Array, Array, Array]:
        """Return the mean responses since the last call.

        Returns
        -------
        law : ndarray, shape (n, m * orders)
            D^alpha phi at G = 1.
        free : ndarray, shape (orders,)
            D^alpha of what phi was in the air before.
        pulse : ndarray, shape (orders,)
            D^alpha of the pulse.
        linearised : ndarray, shape (3, orders)
            D^alpha of dphi/dx at G = 1 times the force [N], times the noise of the motion [1], and
            times 1 in this contact [1].
        """
        self._catch_up()
        total = self._sum / max(self._count, 1)
        self._sum.fill(0.0)
        self._count = 0
        law = total[:, : self._signal_count].T.reshape(self._shape[0], -1)
        free = np.diagonal(total[:, self._free]).copy()
        return law, free, total[:, self._pulse].copy(), total[:, self._linearised].T.copy()

    def held(self, times: Array) -> tuple[Array, Array]:
        """Return the responses while the motion stands still from the last sample on.

        Parameters
        ----------
        times : ndarray, shape (k,)
            Since the last sample [s], at least :data:`~fden_ros.core.law.kernel.SHORTEST_STEP`.

        Returns
        -------
        law : ndarray, shape (k, n, m * orders)
            D^alpha phi at G = 1.
        free : ndarray, shape (k, orders)
            D^alpha of what phi was in the air before.
        """
        self._catch_up()
        decays = np.exp(-np.outer(times, self._rates))
        total = np.einsum("kj,oj,jc->koc", decays, self._weights, self._memory, optimize=True)
        law = total[:, :, : self._signal_count].transpose(0, 2, 1)
        free = np.diagonal(total[:, :, self._free], axis1=1, axis2=2).copy()
        return law.reshape(times.size, self._shape[0], -1), free

    def discard_block(self) -> None:
        """Forget the samples since the last block, not their memory."""
        self._catch_up()
        self._sum.fill(0.0)
        self._count = 0
