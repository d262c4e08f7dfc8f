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

import functools
import math

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.special import gamma

from fden_ros.core.fractional_integral import kernel_weights, relaxation_rates
from fden_ros.core.geometry import Geometry

Array = NDArray[np.float64]

#: Orders alpha between which the response can be interpolated.
LOWEST_ORDER, HIGHEST_ORDER = 0.01, 0.65
_ORDER_NODES = 11
#: Nodes of ln Gn stand so far apart, and so many of them serve one value.
LOG_SPACING = 0.1
STENCIL = 8
#: Beyond this exponent a node says nothing about any tissue.
_MAX_EXPONENT = 60.0


@functools.cache
def order_nodes() -> tuple[float, ...]:
    """Return the Chebyshev nodes of alpha, ascending."""
    points = np.sort(chebyshev.chebpts1(_ORDER_NODES))
    middle, half = 0.5 * (LOWEST_ORDER + HIGHEST_ORDER), 0.5 * (HIGHEST_ORDER - LOWEST_ORDER)
    return tuple(float(middle + half * point) for point in points)


class Lagrange:
    """Interpolation by the polynomial through given nodes.

    Parameters
    ----------
    nodes : ndarray, shape (n,)
        Ascending and distinct.
    """

    def __init__(self, nodes: Array) -> None:
        self._middle = 0.5 * float(nodes[0] + nodes[-1])
        self._half = 0.5 * float(nodes[-1] - nodes[0]) or 1.0
        scaled = (nodes - self._middle) / self._half
        cardinal = np.linalg.inv(chebyshev.chebvander(scaled, nodes.size - 1))
        slope = np.zeros_like(cardinal)
        slope[: max(nodes.size - 1, 1)] = chebyshev.chebder(cardinal) / self._half
        self._size = nodes.size
        self._coefficients = np.hstack([cardinal, slope])

    def __call__(self, value: float | Array) -> tuple[Array, Array]:
        """Return the weight of each node at `value` and its derivative, shape (..., n)."""
        x = (value - self._middle) / self._half
        polynomials = [x**0, x]
        for _ in range(2, self._size):
            polynomials.append(2.0 * x * polynomials[-1] - polynomials[-2])
        both = np.array(polynomials[: self._size]).T @ self._coefficients
        return both[..., : self._size], both[..., self._size :]


def order_interpolation() -> Lagrange:
    """Return the interpolation between :func:`order_nodes`."""
    return Lagrange(np.array(order_nodes()))


class LogStiffnessGrid:
    """Uniform nodes of ln Gn, with local interpolation between them.

    Local, because far nodes differ by orders of magnitude at large strain.

    Parameters
    ----------
    centre, half_width : float
        What values of ln Gn must be covered [1].
    """

    def __init__(self, centre: float, half_width: float) -> None:
        count = max(math.ceil(half_width / LOG_SPACING), STENCIL // 2)
        offsets: Array = np.arange(-float(count), count + 1.0)
        self.nodes = centre + LOG_SPACING * offsets
        self._interpolation = Lagrange(np.arange(float(STENCIL)))

    @property
    def lowest(self) -> float:
        """Smallest node."""
        return float(self.nodes[0])

    @property
    def highest(self) -> float:
        """Largest node."""
        return float(self.nodes[-1])

    def stencil(self, value: float) -> tuple[int, Array, Array]:
        """Return the first node used at `value`, the weights and their slopes, shape (8,)."""
        position = (value - self.lowest) / LOG_SPACING
        first = min(max(math.floor(position) - STENCIL // 2 + 1, 0), self.nodes.size - STENCIL)
        weights, slopes = self._interpolation(position - first)
        return first, weights, slopes / LOG_SPACING


@functools.cache
def _derivative_weights() -> Array:
    """Weights of the exponentials for D^alpha at every order node, shape (orders, 76)."""
    weights = np.vstack([kernel_weights(1.0 - order) for order in order_nodes()])
    weights.flags.writeable = False
    return weights


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
        self._gn = np.exp(log_gn_nodes)[:, None]
        self._inverse_gn = 1.0 / self._gn
        self._shape = (log_gn_nodes.size, origin_nodes.size)
        self._signal_count = log_gn_nodes.size * origin_nodes.size
        self._rates = relaxation_rates()
        self._weights = _derivative_weights()
        self._orders = np.array(order_nodes())
        self._local_scale = 1.0 / gamma(2.0 - self._orders)
        # After the law's signals, one for each order: what phi was while nobody touched; then a
        # pulse of phi in the past.
        self._free = slice(self._signal_count, self._signal_count + self._orders.size)
        columns = self._signal_count + self._orders.size + 1
        self._memory = np.zeros((self._rates.size, columns))
        self._decayed = np.empty_like(self._memory)
        self._change = np.empty(columns)
        self._memory_sum = np.zeros_like(self._memory)
        self._local_sum = np.zeros((self._orders.size, columns))
        self._last = np.zeros(columns)
        self._signals = np.zeros(columns)
        self._law_signals = self._signals[: self._signal_count].reshape(self._shape)
        self._exponent = np.empty(self._shape)
        self._linear = np.empty(self._shape)
        self._count = 0
        self._strains = [0.0] * len(self._origins)
        self._step = math.nan
        self._decay = np.empty((self._rates.size, 1))
        self._gain = np.empty((self._rates.size, 1))
        self._local = np.empty((self._orders.size, 1))

    def press(self, step: float, compression: float) -> None:
        """Take a sample in contact `step` seconds after the last."""
        strains = [self._geometry.strain(compression - origin) for origin in self._origins]
        before, self._strains = self._strains, strains
        # e^(Gn x - 1)/Gn beyond 1/Gn and x below it, both in one.
        np.multiply(self._gn, np.maximum(strains, 0.0), out=self._exponent)
        self._exponent -= 1.0
        np.minimum(self._exponent, 0.0, out=self._linear)
        np.maximum(self._exponent, 0.0, out=self._exponent)
        np.minimum(self._exponent, _MAX_EXPONENT, out=self._exponent)
        np.exp(self._exponent, out=self._exponent)
        self._exponent += self._linear
        np.multiply(self._exponent, self._inverse_gn, out=self._law_signals)
        if strains[0] < 0.0 or strains[-1] < 0.0:
            self._law_signals *= np.greater(strains, 0.0)
        self._signals[self._signal_count :] = 0.0
        self._count += 1
        if not self._advance(step):
            return
        self._memory_sum += self._decayed
        self._local_sum += self._local * self._change
        for index, (earlier, now) in enumerate(zip(before, strains, strict=True)):
            if earlier < 0.0 < now:
                self._begin_at(index, step * now / (now - earlier))

    def _begin_at(self, origin: int, duration: float) -> None:
        """Let the last step's change at one origin have begun at the touch within the step."""
        columns = slice(origin, self._signal_count, self._shape[1])
        change = self._change[columns]
        exponent = self._rates * duration
        with np.errstate(invalid="ignore"):
            gain = -np.expm1(-exponent) / exponent
        gain[0] = 1.0
        local = duration**-self._orders * self._local_scale
        self._memory[:, columns] += (gain[:, None] - self._gain) * change
        self._local_sum[:, columns] += (local[:, None] - self._local) * change

    def rest(self, step: float, free_response: Array) -> None:
        """Take a step in the air, where phi is D^-alpha of the stress so far, shape (orders,)."""
        self._signals[: self._signal_count] = 0.0
        self._signals[self._free] = free_response
        self._advance(step)

    def _advance(self, step: float) -> bool:
        if step <= 0.0:
            # The first sample of all: the memory begins here.
            return False
        if step != self._step:
            self._prepare(step)
        np.subtract(self._signals, self._last, out=self._change)
        np.copyto(self._last, self._signals)
        np.multiply(self._memory, self._decay, out=self._decayed)
        np.multiply(self._gain, self._change, out=self._memory)
        self._memory += self._decayed
        return True

    def _prepare(self, step: float) -> None:
        exponent = self._rates * step
        np.exp(-exponent, out=self._decay[:, 0])
        with np.errstate(invalid="ignore"):
            self._gain[:, 0] = -np.expm1(-exponent) / exponent
        self._gain[0, 0] = 1.0
        self._local[:, 0] = step**-self._orders * self._local_scale
        self._step = step

    def freeze(self, first: int, law: Array, pulse_duration: float) -> None:
        """Let all motion so far be remembered as that of a tissue now left behind.

        When it was left is known to a pulse of phi only, which ends now.

        Parameters
        ----------
        first : int
            First node of ln Gn that counts.
        law : ndarray, shape (k, m)
            Weights of the nodes of ln Gn from `first` on and of the origin, G included.
        pulse_duration : float
            How long the new tissue may have been there already [s].
        """
        count = self._signal_count
        start = first * self._shape[1]
        used = slice(start, start + law.size)
        self._memory[:, self._free] += (self._memory[:, used] @ law.ravel())[:, None]
        self._last[self._free] += self._last[used] @ law.ravel()
        self._memory[:, -1] = np.expm1(-self._rates * pulse_duration)
        self._memory[:, :count] = 0.0
        self._last[:count] = 0.0

    def take_block(self) -> tuple[Array, Array, Array]:
        """Return the mean responses since the last call.

        Returns
        -------
        law : ndarray, shape (n, m * orders)
            D^alpha phi at G = 1.
        free : ndarray, shape (orders,)
            D^alpha of what phi was in the air before.
        pulse : ndarray, shape (orders,)
            D^alpha of the pulse.
        """
        total = self._weights @ self._memory_sum
        total += self._local_sum
        total /= max(self._count, 1)
        self._memory_sum.fill(0.0)
        self._local_sum.fill(0.0)
        self._count = 0
        law = total[:, : self._signal_count].T.reshape(self._shape[0], -1)
        return law, np.diagonal(total[:, self._free]).copy(), total[:, -1].copy()

    def discard_block(self) -> None:
        """Forget the samples since the last block, not their memory."""
        self._memory_sum.fill(0.0)
        self._local_sum.fill(0.0)
        self._count = 0
