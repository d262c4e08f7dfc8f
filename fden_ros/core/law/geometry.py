# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From force and displacement to stress and strain: one class per geometry.

Every geometry works on the *compression* u = d / L: the displacement d into the tissue over a
characteristic length L, less the strain origin o that the estimator may refine. Strain is x(u -
o); stress is force times a constant. So one filter serves all geometries, and the apparent
stiffness in newtons per metre follows from dx/du.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.layer import LAYER_TERMS, hayes_factor, sphere_series
from fden_ros.core.parameter import TINY, parameter

#: Largest indentation of a sphere on a thick tissue, in radii [1].
_DEEPEST_SPHERE = 4.64
#: sqrt(R d) / h up to which the series of a sphere on a layer holds [1].
_THINNEST = 2.0


class Strains(NamedTuple):
    """Strains of compressions, each of their shape."""

    values: Array  #: x [1]
    slopes: Array  #: dx/du [1]
    bends: Array  #: d ln(dx/du) / du [1]


class Geometry(ABC):
    """A contact geometry: strain is a power of the compression, or a series of powers."""

    kind: ClassVar[str]  #: its name in parameters and libraries
    unit: ClassVar[str] = "N"  #: of the measured force
    exponent: ClassVar[float] = 1.0  #: the first of these powers [1]
    is_one_sided: ClassVar[bool] = True  #: the tissue can push the probe but not pull at it
    sizes: ClassVar[tuple[str, ...]] = ()  #: its parameters of `geometry`
    #: Its description in a parameter file.
    example: ClassVar[str] = "kind: flat_punch, area: 3.14e-4, thickness: 0.02"
    #: Whether its sizes are those of a probe, not placeholders, with which no estimate can
    #: converge.
    is_stated: bool

    @property
    @abstractmethod
    def length(self) -> float:
        """Characteristic length L [m]: compression is displacement / L."""

    @property
    @abstractmethod
    def stress_per_force(self) -> float:
        """Stress per force [Pa/N]."""

    @property
    def probe_radius(self) -> float:
        """Radius of the probe, or of a round one of its area [m]; 0: not known."""
        return 0.0

    @property
    def series(self) -> tuple[float, ...]:
        """The c of the factor by which a layer strains more, 1 + sum of c_k u^(k/2), k from 1."""
        return (0.0,) * LAYER_TERMS

    @property
    def most_strain(self) -> float:
        """Largest strain that is plausible [1]."""
        return 3.0

    @property
    def size_gain(self) -> float:
        """Relative error of G and Gn per relative error of the thickness or radius [1]."""
        return 1.0

    def strain(self, compression: float) -> float:
        """Return the strain x [1] at a compression from the strain origin [1].

        If the power is not 1 it is 0 above the surface: there is no contact.
        """
        power = self.exponent
        return compression if power == 1.0 else max(compression, 0.0) ** power

    def strain_slope(self, compression: float) -> float:
        """Return dx/du [1] at a compression."""
        power = self.exponent
        return 1.0 if power == 1.0 else power * max(compression, 0.0) ** (power - 1.0)

    def compression(self, strain: float) -> float:
        """Return the compression [1] at a strain in contact: the inverse of `strain`."""
        power = self.exponent
        return strain if power == 1.0 else max(strain, 0.0) ** (1.0 / power)

    def strains(self, sizes: Array) -> Strains:
        """Return strains, slopes and bends at compressions that are not negative [1]."""
        power = self.exponent
        values, slopes = sizes**power, power * sizes ** (power - 1.0)
        if power == 1.0:
            return Strains(values, slopes, np.zeros_like(sizes))
        orders = np.arange(1, LAYER_TERMS + 1)
        terms = np.array(self.series) * np.sqrt(sizes)[..., None] ** orders
        steeper = terms * (1.0 + 0.5 * orders / power)
        steep = 1.0 + steeper.sum(axis=-1)
        # At the surface they are unbounded.
        with np.errstate(divide="ignore"):
            bends = (power - 1.0 + steeper @ (0.5 * orders) / steep) / sizes
        return Strains(values * (1.0 + terms.sum(axis=-1)), slopes * steep, bends)


@dataclass(frozen=True)
class FlatPunch(Geometry):
    """A flat-ended probe on tissue of known thickness: stress F/A, strain d/h."""

    kind = "flat_punch"
    sizes = "area", "thickness", "hayes"
    area: float  #: area of the probe's face A [m^2]
    thickness: float  #: thickness of the tissue h [m]
    #: If given, stress is divided by Hayes' factor, so that G is the tissue's own and not that of
    #: the layer under a probe smaller than it; see :func:`hayes_factor`. None: no correction.
    poisson_ratio: float | None = None
    #: For that factor the base holds the tissue; otherwise the tissue slips on it.
    is_bonded: bool = True
    is_stated: bool = True

    @property
    def most_strain(self) -> float:
        """The thickness of the tissue."""
        return 1.0

    @property
    def probe_radius(self) -> float:
        """Radius of a round face of that area [m]."""
        return math.sqrt(self.area / math.pi)

    @property
    def length(self) -> float:
        """Thickness of the tissue [m]."""
        return self.thickness

    @property
    def stress_per_force(self) -> float:
        """1/A; with Hayes' correction (1 - nu^2) / (2 a kappa h), so that f = E x if elastic."""
        if self.poisson_ratio is None:
            return 1.0 / self.area
        ratio, nu = self.probe_radius / self.thickness, self.poisson_ratio
        kappa = hayes_factor(ratio, nu, is_bonded=self.is_bonded)
        return (1.0 - nu**2) / (2.0 * self.probe_radius * kappa * self.thickness)


@dataclass(frozen=True)
class Sphere(Geometry):
    r"""A spherical tip (Hertz), with representative stress and strain.

    For a viscoelastic half-space under growing contact, Lee and Radok (J. Appl. Mech. 27, 1960)
    give
    :math:`F = \tfrac43 \sqrt R\, E^*(t) * d(\delta^{3/2})`. With the representative stress
    :math:`f = 3F/(4R^2)` and strain
    :math:`x = (\delta/R)^{3/2}` this is :math:`f = D^\alpha(G x)`: the noise of the stress is that
    of the force, the memory is exact where the law is linear, and G is the plane-strain modulus in
    Pa s^alpha.

    On a layer the strain is larger by a factor of the depth, :func:`.layer.sphere_series`: 3.4 for
    an incompressible bonded layer at sqrt(R delta)/h = 0.75.
    """

    kind = "sphere"
    exponent = 1.5
    sizes = "radius", "thickness"
    example = "kind: sphere, radius: 0.005, thickness: 0.02"
    radius: float  #: radius of the tip R [m]
    thickness: float = math.inf  #: of the tissue, on a rigid base [m]; infinite: a half-space
    poisson_ratio: float = 0.5  #: of the tissue nu [1]; counts where it is bonded
    is_bonded: bool = True  #: the base holds the tissue; otherwise it slips on the base
    is_stated: bool = True

    @property
    def length(self) -> float:
        """Radius of the tip [m]."""
        return self.radius

    @property
    def probe_radius(self) -> float:
        """Radius of the tip [m]."""
        return self.radius

    @property
    def stress_per_force(self) -> float:
        """3 / (4 R^2) [1/m^2]."""
        return 0.75 / self.radius**2

    @functools.cached_property
    def series(self) -> tuple[float, ...]:
        """Coefficients of the layer's factor, by powers of sqrt(u) [1]."""
        if math.isinf(self.thickness):
            return super().series
        found = sphere_series(self.poisson_ratio, is_bonded=self.is_bonded)
        ratio = self.radius / self.thickness
        return tuple(c * ratio**k for k, c in enumerate(found, 1))

    @property
    def most_strain(self) -> float:
        """At 4.64 radii, the whole thickness, or where the layer's series ends."""
        thickness = self.thickness / self.radius
        return self.strain(min(_DEEPEST_SPHERE, thickness, (_THINNEST * thickness) ** 2))

    @property
    def size_gain(self) -> float:
        """The power of the thickness by which the strain falls, half of it deep; at least 1."""
        if math.isinf(self.thickness):
            return 1.0
        u = 0.5 * self.thickness / self.radius
        return max(2.0 * (u * self.strain_slope(u) / self.strain(u) - self.exponent), 1.0)

    def strain(self, compression: float) -> float:
        """Return (delta/R)^1.5 and the layer's part; 0 above the surface: there is no contact."""
        if compression <= 0.0:
            return 0.0
        root = math.sqrt(compression)
        return compression * root * _polynomial(root, (1.0, *self.series))

    def strain_slope(self, compression: float) -> float:
        """Return 1.5 (delta/R)^0.5 and the layer's part."""
        if compression <= 0.0:
            return 0.0
        root = math.sqrt(compression)
        slopes = ((1.0 + k / 3.0) * c for k, c in enumerate((1.0, *self.series)))
        return 1.5 * root * _polynomial(root, tuple(slopes))

    def compression(self, strain: float) -> float:
        """Return x^(2/3), or less on a layer."""
        most = max(strain, 0.0) ** (2.0 / 3.0)
        if not any(self.series) or self.strain(most) <= strain:
            return most
        from scipy.optimize import brentq  # takes 0.2 s to import, and few tissues need it

        # The series is positive throughout.
        return float(brentq(lambda u: self.strain(u) - strain, 0.0, most, xtol=1e-300, rtol=1e-14))


def _polynomial(x: float, coefficients: tuple[float, ...]) -> float:
    """Return c_0 + c_1 x + ... by Horner's rule."""
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * x + coefficient
    return value


@dataclass(frozen=True)
class TorsionalRheometer(Geometry):
    """A cylinder twisted between plates (paper, Appendix A): torque [N m] and angle [rad].

    Stress f = T / (pi R^3), strain x = R theta / (2 d): the means over the sample, half of the
    outer values.
    """

    kind = "torsional_rheometer"
    unit = "N m"
    is_one_sided = False
    sizes = "radius", "thickness"
    example = "kind: torsional_rheometer, radius: 0.01, thickness: 0.005"
    #: Radius of the sample R [m]. The paper prints 20 mm for a sample of 20 mm in diameter: a
    #: factor of 8 in stress.
    radius: float
    height: float  #: height of the sample d [m]
    is_stated: bool = True

    @property
    def length(self) -> float:
        """Angle at a mean strain of 1 [rad]."""
        return 2.0 * self.height / self.radius

    @property
    def probe_radius(self) -> float:
        """Radius of the sample [m]."""
        return self.radius

    @property
    def stress_per_force(self) -> float:
        """Mean stress per torque [Pa / (N m)]."""
        return 1.0 / (math.pi * self.radius**3)


@dataclass(frozen=True)
class PassThrough(Geometry):
    """Inputs that are stress [Pa] and strain [1] already."""

    kind = "pass_through"
    unit = "Pa"
    length: float = 1.0
    stress_per_force: float = 1.0
    is_stated: bool = True


_KINDS = FlatPunch, Sphere, TorsionalRheometer, PassThrough


@dataclass(frozen=True)
class GeometryConfig:
    """How probe and tissue are stated."""

    kind: str = parameter(
        "geometry.kind",
        FlatPunch.kind,
        "How force and displacement become stress and strain.",
        choices=tuple(one.kind for one in _KINDS),
    )
    area: float = parameter(
        "geometry.area",
        0.0,
        "flat_punch: area of the probe's face; 0: not stated, so nothing is converged.",
        "m^2",
        TINY,
        1.0,
        may_be_zero=True,
    )
    thickness: float = parameter(
        "geometry.thickness",
        0.0,
        "flat_punch, sphere: thickness of the tissue on its rigid base; torsional_rheometer: "
        "height of the sample; 0: not stated, which under a sphere means thick.",
        "m",
        1e-9,
        1.0,
        may_be_zero=True,
    )
    radius: float = parameter(
        "geometry.radius",
        0.0,
        "sphere: radius of the tip; torsional_rheometer: radius of the sample; 0: not stated.",
        "m",
        1e-9,
        1.0,
        may_be_zero=True,
    )
    hayes: bool = parameter(
        "geometry.hayes",
        False,
        "flat_punch: divide by Hayes' factor, for a probe smaller than the tissue around it.",
    )
    bonded: bool = parameter(
        "geometry.bonded",
        True,
        "The tissue sticks to its base; false: it slips. Used with hayes, and under a sphere "
        "with a thickness.",
    )
    poisson_ratio: float = parameter(
        "geometry.poisson_ratio",
        0.5,
        "Poisson's ratio of a layer that sticks to its base; used with hayes, or under a sphere "
        "with a thickness.",
        "1",
        0.0,
        0.5,
    )

    def build(self) -> Geometry:
        """Return the geometry.

        It is not stated where a size that its kind needs is 0; a placeholder then replaces it.
        """
        area, radius, thickness = self.area or 1e-4, self.radius or 0.005, self.thickness or 0.02
        has_thickness, has_radius = self.thickness > 0.0, self.radius > 0.0
        if self.kind == Sphere.kind:
            depth = self.thickness or math.inf
            return Sphere(radius, depth, self.poisson_ratio, self.bonded, is_stated=has_radius)
        if self.kind == TorsionalRheometer.kind:
            return TorsionalRheometer(radius, thickness, is_stated=has_radius and has_thickness)
        if self.kind == PassThrough.kind:
            return PassThrough()
        poisson_ratio = self.poisson_ratio if self.hayes else None
        is_stated = self.area > 0.0 and has_thickness
        return FlatPunch(area, thickness, poisson_ratio, self.bonded, is_stated=is_stated)
