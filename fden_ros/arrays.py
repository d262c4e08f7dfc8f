# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Identify tissue from arrays: :func:`fden_ros.fit`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import StateIndex
from fden_ros.core.law import RATE_COUNT, RATES, Geometry, phi, relaxation_weights
from fden_ros.core.outputs import ContactSummary, Flag
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay_source
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.source import RowSource
from fden_ros.report.numbers import stiffness

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame  # type: ignore[import-not-found,import-untyped,unused-ignore]

_NS = 1e9


class Number(NamedTuple):
    """A value and its standard deviation; both are NaN if the value is not known."""

    value: float
    sd: float


_UNKNOWN = Number(math.nan, math.nan)


@dataclass(frozen=True, eq=False, repr=False)
class FittedContact:
    """One contact of the probe with the tissue.

    Attributes
    ----------
    start, end : float
        Touch and release, in the times that were given [s].
    summary : ContactSummary
        Everything that the pipeline says about the contact.
    samples : tuple of ndarray
        Time [s], force [N] and displacement [m] of the contact, shape (n,) each.
    """

    start: float
    end: float
    summary: ContactSummary
    samples: tuple[Array, Array, Array]
    geometry: Geometry

    def __repr__(self) -> str:
        flags = "".join(f", {name}" for name in self.flags)
        words = f"{self._stiffness_words}{'' if self.converged else ', not converged'}{flags}"
        return f"contact {self.summary.contact_id} at {self.start:.6g} s: {words}"

    @property
    def converged(self) -> bool:
        """Whether the data determine G and Gn."""
        return self.summary.converged

    @property
    def stiffness(self) -> Number:
        """Stiffness for a small motion at the deepest point [N/m]."""
        found = self.summary.apparent_stiffness
        return Number(found.value, found.sd) if found is not None else _UNKNOWN

    @property
    def G(self) -> Number:
        """Linear stiffness G [Pa s^alpha]."""
        return self._parameter(StateIndex.LOG_LINEAR_STIFFNESS, "linear_stiffness")

    @property
    def Gn(self) -> Number:
        """Nonlinear stiffness Gn [1]."""
        return self._parameter(StateIndex.LOG_NONLINEAR_STIFFNESS, "nonlinear_stiffness")

    @property
    def alpha(self) -> Number:
        """Fractional order alpha [1]."""
        return self._parameter(StateIndex.FRACTIONAL_ORDER, "fractional_order")

    @property
    def covariance(self) -> Array:
        """Covariance of (ln G, ln Gn, alpha) [1], shape (3, 3); NaN without an estimate."""
        estimate = self.summary.estimate
        return estimate.covariance if estimate is not None else np.full((3, 3), math.nan)

    @property
    def flags(self) -> tuple[str, ...]:
        """Names of the flags that were raised, such as ``"MODEL_MISMATCH"``."""
        return tuple(flag.name for flag in Flag if flag & self.summary.flags and flag.name)

    def predict(self, time: Any, displacement: Any) -> Array:
        """Return the force that the law predicts for another motion on tissue at rest.

        Parameters
        ----------
        time : array_like, shape (n,)
            Times [s]. They increase, and may start at any value.
        displacement : array_like, shape (n,)
            Depth below the untouched surface [m]. The motion begins at the surface or above it.

        Returns
        -------
        ndarray, shape (n,)
            Force [N]; NaN if G, Gn or alpha is not known.
        """
        times, depths = _arrays(time=time, displacement=displacement)
        g, gn, order = (number.value for number in (self.G, self.Gn, self.alpha))
        if not math.isfinite(g + gn + order):
            return np.full(times.size, math.nan)
        sizes = depths / self.geometry.length
        strains = np.array([self.geometry.strain(max(u, 0.0)) for u in sizes.tolist()])
        response = phi(strains, g, gn)
        *kernel, slow, fast = relaxation_weights(order)
        memory, stresses = np.zeros(RATE_COUNT), slow * response
        for i, step in enumerate(np.diff(times), start=1):
            rise, y = response[i] - response[i - 1], RATES * step
            memory = memory * np.exp(-y) - rise * np.expm1(-y) / y
            stresses[i] += kernel @ memory + fast * rise / step
        # The tissue lets go of the probe.
        return np.maximum(stresses, 0.0) / self.geometry.stress_per_force

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the measured force over displacement; return the matplotlib axes."""
        if axes is None:
            from matplotlib import pyplot

            axes = pyplot.figure().subplots()
        _, force, displacement = self.samples
        axes.plot(1e3 * displacement, force)
        axes.set(xlabel="displacement [mm]", ylabel="force [N]", title=self._stiffness_words)
        return axes

    @property
    def _stiffness_words(self) -> str:
        found = self.summary.apparent_stiffness
        return f"{stiffness(found)} N/m" if found is not None else "N/m not known"

    def _parameter(self, index: StateIndex, name: str) -> Number:
        estimate = self.summary.estimate
        if estimate is None or not estimate.knows(index):
            return _UNKNOWN
        return Number(getattr(estimate, name), getattr(estimate, f"{name}_sd"))


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """What :func:`fit` has found: the contacts in order of time, and warnings in words."""

    contacts: tuple[FittedContact, ...]
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        counts = f"contacts: {len(self.contacts)}, warnings: {len(self.warnings)}"
        return "\n".join([counts, *map(repr, self.contacts)])

    def to_dataframe(self) -> DataFrame:
        """Return a pandas table with one row per contact: each number and its sd."""
        try:
            import pandas  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError:
            raise InputError(
                f"to_dataframe needs pandas: {sys.executable} -m pip install pandas, or "
                "apt install python3-pandas"
            ) from None
        rows = []
        for one in self.contacts:
            row: dict[str, object] = {"start": one.start, "end": one.end}
            for name in ("stiffness", "G", "Gn", "alpha"):
                row[name], row[f"{name}_sd"] = getattr(one, name)
            rows.append(row | {"converged": one.converged, "flags": " ".join(one.flags)})
        return pandas.DataFrame(rows)


def fit(
    time: Any,
    force: Any,
    displacement: Any,
    geometry: Mapping[str, object] | None = None,
    **parameters: Any,
) -> Fit:
    """Identify the tissue of each contact of a recording.

    Parameters
    ----------
    time : array_like, shape (n,)
        Time of each sample [s]. It increases, and may start at any value.
    force : array_like, shape (n,)
        Force [N], which grows when the probe presses; with `torsional_rheometer` a torque [N m].
    displacement : array_like, shape (n,)
        Displacement [m], which grows into the tissue, from any zero. The recording must begin in
        the air.
    geometry : mapping, optional
        Probe and tissue, such as ``{"kind": "flat_punch", "area": 3.14e-4, "thickness": 0.02}``
        (SI units) or ``{"kind": "sphere", "radius": 0.005}``. Without it only measured slopes are
        known.
    **parameters
        Other parameters of ``config/identifier.yaml``, by their group, such as
        ``prior={"alpha": 0.131}, estimator={"kind": "ekf"}``.

    Returns
    -------
    Fit
        Its `contacts` are in order of time. Each has `stiffness` [N/m], `G` [Pa s^alpha], `Gn`
        and `alpha` as (value, sd), and `covariance`, `flags`, `converged`, `predict` and `plot`.
        A number that is not known is NaN. `warnings` is a tuple of sentences, and
        `to_dataframe()` returns a pandas table. The numbers are those of ``fden replay``, to
        the last bit.

    Raises
    ------
    InputError
        If an array or a parameter cannot be used. Its message is one line that says why.

    Examples
    --------
    >>> import numpy as np, fden_ros
    >>> t, force, mm = np.loadtxt("examples/press.csv", delimiter=",", skiprows=1).T
    >>> probe = {"kind": "flat_punch", "area": 3.14e-4, "thickness": 0.02}
    >>> found = fden_ros.fit(t, force, 1e-3 * mm, geometry=probe)
    >>> len(found.contacts)
    2
    """
    times, forces, displacements = _arrays(time=time, force=force, displacement=displacement)
    checked = check({"geometry": {} if geometry is None else geometry, **parameters})
    stamps = np.rint(_NS * times).astype(np.int64)
    inputs = {name: f"array {name}" for name in ("force", "displacement")}
    found = replay_source(RowSource((stamps, forces, displacements), checked, inputs))
    geometry_used = pipeline_config(checked).geometry
    contacts = []
    for one in found.summaries:
        own = (stamps >= one.start_ns) & (stamps <= one.end_ns)
        samples = times[own], forces[own], displacements[own]
        start, end = one.start_ns / _NS, one.end_ns / _NS
        contacts.append(FittedContact(start, end, one, samples, geometry_used))
    return Fit(tuple(contacts), found.warnings)


def _arrays(**given: Any) -> list[Array]:
    """Return what is given as arrays of floats, of one length; times increase."""
    found: list[Array] = []
    for name, values in given.items():
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise InputError(
                f"{name} is not an array of numbers: give floats in SI units"
            ) from None
        if array.ndim != 1 or array.size == 0:
            raise InputError(f"{name} has the shape {array.shape}: give one number per sample")
        if found and array.size != found[0].size:
            raise InputError(f"{name} has {array.size} samples, time has {found[0].size}")
        if not np.isfinite(array).all():
            raise InputError(
                f"{name} has NaN or infinity at sample {np.argmin(np.isfinite(array))}"
            )
        found.append(array)
    if (back := np.flatnonzero(np.diff(found[0]) <= 0.0)).size:
        raise InputError(f"time does not increase at sample {back[0] + 1}: sort and drop repeats")
    return found
