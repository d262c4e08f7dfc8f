# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The response of the FDEN law on a grid of parameters, in constant memory.

The stress :math:`f = D^\alpha \varphi(x; G, G_n)` is linear in G and smooth in ln Gn and alpha. So
it is computed once per sample at nodes of the two, from the same exponentials as the fractional
integral, and interpolated in between: any parameters can be tried later on samples that are gone.

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

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import phi
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
#: steps ten times as long, in up to eight parts, then err by less than 1e-3.
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
    """

    def __init__(self, geometry: Geometry, log_gn_nodes: Array) -> None:
        self._geometry = geometry
        self._gn = np.exp(log_gn_nodes)
        self._rates = relaxation_rates()
        self._weights = derivative_weights()
        # After the law's signals, one for each order: what phi was while nobody touched.
        self._free = slice(log_gn_nodes.size, log_gn_nodes.size + len(order_nodes()))
        self._memory = np.zeros((self._rates.size, self._free.stop))
        self._last = np.zeros(self._free.stop)
        self._waiting: list[tuple[float, float]] = []
        #: None: in the air.
        self._compression: float | None = None

    def press(self, step: float, compression: float) -> None:
        """Take a sample in contact `step` seconds after the last."""
        before = self._compression
        change = compression - before if before is not None and step > 0.0 else 0.0
        parts = min(max(math.ceil(abs(change) / _LONGEST_PART), 1), _MOST_PARTS)
        for left in range(parts - 1, -1, -1):
            self._waiting.append((step / parts, compression - change * left / parts))
        self._compression = compression
        if len(self._waiting) >= MOST_WAITING:
            self._catch_up()

    def _catch_up(self) -> None:
        """Take the samples that wait, all at once: several times faster than one by one."""
        if not self._waiting:
            return
        steps, compressions = zip(*self._waiting, strict=True)
        self._waiting.clear()
        if steps[0] <= 0.0:
            # The first sample of all: the memory begins here.
            steps, compressions = steps[1:], compressions[1:]
            if not steps:
                return
        # Above the strain origin there is no contact.
        strains = np.array([max(self._geometry.strain(u), 0.0) for u in compressions])
        signals = np.zeros((len(steps), self._last.size))
        signals[:, : self._gn.size] = phi(strains[:, None], 1.0, self._gn)
        self._take(signals, decays_of(steps, (1.0,) * len(steps)))

    def _take(self, signals: Array, decays: Decays) -> None:
        change = np.diff(signals, axis=0, prepend=self._last[None])
        self._memory *= decays.whole[:, None]
        self._memory += (decays.mean * decays.to_end) @ change
        self._last = signals[-1]

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
        self._take(signals, Decays(steps, (1.0,) * len(steps)))

    def held(self, times: Array) -> tuple[Array, Array]:
        """Return the responses while the motion stands still from the last sample on.

        Parameters
        ----------
        times : ndarray, shape (k,)
            Since the last sample [s], at least :data:`~fden_ros.core.law.kernel.SHORTEST_STEP`.

        Returns
        -------
        law : ndarray, shape (k, n, orders)
            D^alpha phi at G = 1.
        free : ndarray, shape (k, orders)
            D^alpha of what phi was in the air before.
        """
        self._catch_up()
        decays = np.exp(-np.outer(times, self._rates))
        total = np.einsum("kj,oj,jc->koc", decays, self._weights, self._memory, optimize=True)
        law = total[:, :, : self._gn.size].transpose(0, 2, 1)
        free = np.diagonal(total[:, :, self._free], axis1=1, axis2=2).copy()
        return law, free
