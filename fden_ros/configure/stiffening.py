# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

r"""Which way is into the tissue, where the probe never leaves it: the way in which it stiffens.

Relaxation is the same both ways, so it is taken out first: the force is

.. math:: F = \int_0^t (t-s)^{-\alpha} \, d\phi(x(s)) + a + b t + c (t+t_1)^{-\alpha} + d
          (t+t_2)^{-\alpha}

with a cubic :math:`\phi` of the displacement x, a drift, and what the tissue remembers from
before the recording; and with one breath, a sine that moves the surface, at the frequency that
fits best. Real tissue relaxes by no single power: the linear part has further orders.
All but the order :math:`\alpha`, the delay of the displacement and that frequency is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.signal import fftconvolve

from fden_ros.configure.session import Mask, Session
from fden_ros.configure.statistics import Fit, fit
from fden_ros.core.arrays import Array

#: Step of the grid [s], and the most points that it has.
_STEP, _MOST = 5e-3, 20_000
#: Margin at both ends for the delay [s], and delays at which the search begins [s].
_MARGIN, _DELAYS = 0.1, (-5e-3, 20e-3)
_LARGEST_ORDER = 0.7
_CUBIC = 3
#: Real tissue relaxes by no single power: the linear part has a sum of these orders, too.
_ORDERS = (0.0, 0.3, 0.6, 0.9)
#: How long before the recording the tissue was loaded [s]: just now, and some while ago.
_BEFORE = (0.1, 2.0)
#: Frequencies of a breath or a heart [Hz], and the most of them that are tried.
_BREATHS, _MOST_BREATHS = (0.12, 1.6), 240


def stiffening(session: Session, into: Array, grows: Array) -> float:
    """Return by how many deviations the tissue is stiffer at the far end of `into`.

    Parameters
    ----------
    session : Session
        In contact throughout.
    into : Array
        Line of the displacement (j,), of either sign.
    grows : Array
        Direction in which the force grows along it (k,).
    """
    streams = session.streams
    start, end = streams.start + _MARGIN, streams.end - _MARGIN
    step = max(float(np.median(np.diff(streams.force_times))), _STEP, (end - start) / _MOST)
    times = np.arange(start, end, step)
    if times.size < 100:
        return 0.0
    columns = [np.interp(times, streams.force_times, column) for column in session.unloaded.T]
    force = np.stack(columns, axis=1) @ grows
    way = streams.position_at(times) @ into
    centre, scale = float(way.mean()), float(way.std())
    still = np.interp(times, session.times, session.turning.astype(float)) == 0.0
    if scale <= 0.0 or still.sum() < 100:
        return 0.0

    def depth_at(delay: float) -> Array:
        return (streams.position_at(times + delay) @ into - centre) / scale

    search = _Search(step, times - times[0], depth_at, force, still)
    without = search.nearest(None)
    # As fine as the recording resolves frequencies.
    count = min(
        int((_BREATHS[1] - _BREATHS[0]) * 4.0 * float(times[-1] - times[0])), _MOST_BREATHS
    )
    breath = min(
        np.linspace(*_BREATHS, max(count, 2)).tolist(),
        key=lambda frequency: search.fitted(*without, frequency).sd,
    )
    best = search.fitted(*search.nearest(breath), breath)
    low, high = np.quantile((way - centre) / scale, [0.02, 0.98])
    rise = np.zeros(best.solution.size)
    for power in range(2, _CUBIC + 1):
        rise[power - 1] = power * (high ** (power - 1) - low ** (power - 1))
    sd = float(np.sqrt(rise @ best.covariance @ rise))
    return float(rise @ best.solution) / max(sd, 1e-300)


@dataclass(frozen=True)
class _Search:
    """Least squares over all that is not linear."""

    step: float
    since: Array
    depth_at: Callable[[float], Array]
    force: Array
    still: Mask

    def fitted(self, order: float, delay: float, breath: float | None) -> Fit:
        depth = self.depth_at(delay)
        design = _columns(self.step, depth, order)
        if breath is not None:
            phase = 2.0 * np.pi * breath * self.since
            waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
            # The deeper, the stiffer: the breath shows by the slope at the depth.
            design = np.concatenate([design, waves, depth[:, None] * waves], axis=1)
        return fit(design[self.still], self.force[self.still])

    def nearest(self, breath: float | None) -> tuple[float, float]:
        """Return the order and the delay [s] that fit best."""

        def misfit(unknowns: Array) -> float:
            order, delay = _bounded(unknowns)
            away = float(np.abs(unknowns - (order, delay)).sum())
            return self.fitted(order, delay, breath).sd * (1.0 + away)

        found = [
            minimize(
                misfit,
                (0.1, delay),
                method="Nelder-Mead",
                options={
                    "initial_simplex": [[0.1, delay], [0.2, delay], [0.1, delay + 0.01]],
                    "xatol": 1e-3,
                    "fatol": 1e-4 * float(self.force.std()),
                    "maxfev": 60,
                },
            )
            for delay in _DELAYS
        ]
        return _bounded(min(found, key=lambda one: float(one.fun)).x)


def _bounded(unknowns: Array) -> tuple[float, float]:
    order = min(max(float(unknowns[0]), 1e-3), _LARGEST_ORDER)
    return order, min(max(float(unknowns[1]), -_MARGIN), _MARGIN)


def _columns(step: float, depth: Array, order: float) -> Array:
    """Return the design (n, 7) for a displacement (n,), scaled, on a grid of that step [s]."""
    count = depth.size
    edges = np.arange(count + 1.0) ** (1.0 - order)
    kernel = np.diff(edges) / (1.0 - order) * step**-order
    rises = [np.diff(depth**power, prepend=depth[0] ** power) for power in range(1, _CUBIC + 1)]
    since = step * np.arange(count)
    others = [np.diff(np.arange(count + 1.0) ** (1.0 - o)) * step**-o for o in _ORDERS]
    return np.stack(
        [
            *(fftconvolve(rise, kernel)[:count] for rise in rises),
            *(fftconvolve(rises[0], other)[:count] for other in others),
            np.ones(count),
            since / since[-1],
            *((since + before) ** -order for before in _BEFORE),
        ],
        axis=1,
    )
