# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The motion of the tissue at one site, remembered so that any law can be tried on it."""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np

from fden_ros.control.left_out import Hold, Slope
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Along, Estimate
from fden_ros.core.law import Geometry, StressMoments, creep_weights

#: Samples of a contact that are kept [1]: of more than that the older half is thinned out, so that
#: what is long ago is coarse.
MOST_SAMPLES = 1000


class Motion(NamedTuple):
    """A contact so far, and how its motion goes on; arrays of shape (n,)."""

    times: Array  #: [s]
    steps: Array  #: since the sample before [s]
    compressions: Array  #: [1]
    moments: Array  #: of the stress before the contact [Pa s], shape (n, RATE_COUNT)
    seen: int  #: samples so far

    def stress(self, law: Along) -> tuple[Array, Array]:
        """Return a law's stress [Pa] at the samples so far, and while the motion goes on."""
        stress = law.stress(self.steps, self.compressions, self.moments)
        return stress[: self.seen], stress[self.seen :]


class TissueMemory:
    """The present contact, and what is left of those before, in bounded memory.

    Parameters
    ----------
    geometry : Geometry
        As the identifier's.

    Attributes
    ----------
    strain : float
        Present strain [1]; 0 in the air.
    longest_hold : float
        That the site has borne [s].
    """

    def __init__(self, geometry: Geometry) -> None:
        self._geometry = geometry
        self._moments = StressMoments()
        #: Of the stress before the present contact, and when that began [s].
        self._before, self._touched = self._moments, 0.0
        #: Times [s], compressions [1] and stresses [Pa] of it.
        self._samples: list[tuple[float, float, float]] = []
        self._hold = Hold()
        self._time = self._stress = self.strain = 0.0
        self.longest_hold = 0.0

    @property
    def compression(self) -> float:
        """Compression at the present strain [1]."""
        return self._geometry.compression(self.strain)

    def copy(self) -> TissueMemory:
        """Return the memory as it is now."""
        own = copy.copy(self)
        own._moments, own._samples = copy.copy(self._moments), self._samples.copy()
        own._hold = self._hold.copy()
        return own

    def press(self, step: float, strain: float, stress: float) -> None:
        """Take a sample in contact, `step` seconds after the last: strain [1] and stress [Pa]."""
        samples = self._samples
        if not samples:
            self._before, self._touched = copy.copy(self._moments), self._time
            samples.append((self._time, 0.0, 0.0))
        self._pass(step, stress)
        samples.append((self._time, self._geometry.compression(strain), stress))
        if len(samples) > MOST_SAMPLES:
            del samples[1 : MOST_SAMPLES // 2 : 2]
        self.strain = strain
        if self._hold.is_due(step, strain):
            self._hold.keep(self._time, stress)
        self.longest_hold = max(self.longest_hold, self._hold.time)

    def rest(self, step: float) -> None:
        """Take `step` seconds in the air."""
        self._pass(step, 0.0)
        self._samples.clear()
        self._hold.end()
        self.strain = 0.0

    def _pass(self, step: float, stress: float) -> None:
        self._moments.add(step, self._stress, stress)
        self._time, self._stress = self._time + step, stress

    def is_free(self, step: float, strain: float, estimate: Estimate) -> bool:
        """Whether the tissue would have to pull at the probe `step` seconds from the present."""
        moments = copy.copy(self._moments)
        moments.add(step, self._stress, 0.0)
        free = float(creep_weights(estimate.fractional_order) @ moments.values)
        return estimate.is_above_surface(strain, free)

    def motion(self, times: Array, compressions: Array) -> Motion:
        """Return the contact so far, and a motion that goes on from it.

        Parameters
        ----------
        times : ndarray, shape (n,)
            Since the last sample [s], positive, increasing.
        compressions : ndarray, shape (n,)
            By then [1], linear in between.
        """
        past = np.array([sample[:2] for sample in self._samples]).reshape(-1, 2)
        instants = np.append(past[:, 0], self._time + times)
        return Motion(
            instants,
            np.diff(instants, prepend=past[0, 0] if past.size else self._time),
            np.append(past[:, 1], compressions),
            self._before.after(np.maximum(instants - self._touched, 0.0)),
            len(past),
        )

    def slope(self, age: float) -> Slope | None:
        """Return how the slope of what the law leaves out follows from the present hold.

        Parameters
        ----------
        age : float
            Of the loading [s].

        Returns
        -------
        Slope or None
            None where there is no hold, or too little of it was seen.
        """
        return self._hold.slope(self._time, age)
