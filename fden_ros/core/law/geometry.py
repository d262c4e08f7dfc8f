# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From force and displacement to stress and strain: one class a geometry.

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
from typing import ClassVar

import numpy as np


class Geometry(ABC):
    """A contact geometry: strain is a power of the compression.

    Attributes
    ----------
    kind : str
        Its name in parameters and libraries.
    unit : str
        Of what is measured as the force.
    exponent : float
        Of that power [1].
    is_one_sided : bool
        The tissue lets go of the probe, and cannot pull at it.
    most_strain : float
        The largest that is plausible [1].
    example : str
        How it is stated in a parameter file.
    is_stated : bool
        Whether its sizes are those of a probe, not numbers that stand in for them: else nothing
        can be converged.
    """

    kind: ClassVar[str]
    unit: ClassVar[str] = "N"
    exponent: ClassVar[float] = 1.0
    is_one_sided: ClassVar[bool] = True
    most_strain: ClassVar[float] = 3.0
    example: ClassVar[str] = "kind: flat_punch, area: 3.14e-4, thickness: 0.02"
    is_stated: bool

    @property
    @abstractmethod
    def length(self) -> float:
        """Characteristic length L [m]: compression is displacement / L."""

    @property
    @abstractmethod
    def stress_per_force(self) -> float:
        """Stress per force [Pa/N]."""

    def strain(self, compression: float) -> float:
        """Return the strain x [1] at a compression from the strain origin [1]."""
        return compression

    def strain_slope(self, compression: float) -> float:
        """Return dx/du [1] there."""
        return 1.0

    def compression(self, strain: float) -> float:
        """Return the compression [1] at a strain in contact: the inverse of `strain`."""
        return strain


@dataclass(frozen=True)
class FlatPunch(Geometry):
    """A flat-ended probe on tissue of known thickness: stress F/A, strain d/h.

    Parameters
    ----------
    area : float
        Area of the probe's face A [m^2].
    thickness : float
        Thickness of the tissue h [m].
    poisson_ratio : float or None
        Given, stress is divided by Hayes' factor, so that G is the tissue's own and not that of
        the layer under a probe smaller than it; see :func:`hayes_factor`. None: no correction.
    """

    kind = "flat_punch"
    #: It cannot go deeper than the tissue is thick.
    most_strain = 1.0
    area: float
    thickness: float
    poisson_ratio: float | None = None
    is_stated: bool = True

    @property
    def length(self) -> float:
        """Thickness of the tissue [m]."""
        return self.thickness

    @property
    def stress_per_force(self) -> float:
        """1/A; with Hayes' correction (1 - nu^2) / (2 a kappa h), so that f = E x if elastic."""
        if self.poisson_ratio is None:
            return 1.0 / self.area
        radius = math.sqrt(self.area / math.pi)
        kappa = hayes_factor(radius / self.thickness, self.poisson_ratio)
        return (1.0 - self.poisson_ratio**2) / (2.0 * radius * kappa * self.thickness)


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

    Parameters
    ----------
    radius : float
        Radius of the tip R [m].
    """

    kind = "sphere"
    exponent = 1.5
    #: 4.6 radii deep.
    most_strain = 10.0
    example = "kind: sphere, radius: 0.005"
    radius: float
    is_stated: bool = True

    @property
    def length(self) -> float:
        """Radius of the tip [m]."""
        return self.radius

    @property
    def stress_per_force(self) -> float:
        """3 / (4 R^2) [1/m^2]."""
        return 0.75 / self.radius**2

    def strain(self, compression: float) -> float:
        """Return (delta/R)^1.5; 0 above the surface, where there is no contact."""
        return compression * math.sqrt(compression) if compression > 0.0 else 0.0

    def strain_slope(self, compression: float) -> float:
        """Return 1.5 (delta/R)^0.5."""
        return 1.5 * math.sqrt(compression) if compression > 0.0 else 0.0

    def compression(self, strain: float) -> float:
        """Return x^(2/3)."""
        return max(strain, 0.0) ** (2.0 / 3.0)


@dataclass(frozen=True)
class TorsionalRheometer(Geometry):
    """A cylinder twisted between plates (paper, Appendix A): torque [N m] and angle [rad].

    Stress f = T / (pi R^3), strain x = R theta / (2 d): the means over the sample, half of the
    outer values.

    Parameters
    ----------
    radius : float
        Radius of the sample R [m]. The paper prints 20 mm for a sample of 20 mm in diameter: a
        factor of 8 in stress.
    height : float
        Height of the sample d [m].
    """

    kind = "torsional_rheometer"
    unit = "N m"
    is_one_sided = False
    example = "kind: torsional_rheometer, radius: 0.01, thickness: 0.005"
    radius: float
    height: float
    is_stated: bool = True

    @property
    def length(self) -> float:
        """Angle at a mean strain of 1 [rad]."""
        return 2.0 * self.height / self.radius

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


@functools.lru_cache(maxsize=64)
def hayes_factor(aspect_ratio: float, poisson_ratio: float) -> float:
    r"""Return Hayes' factor kappa of a rigid flat punch on an elastic layer bonded to its base.

    :math:`F = 2 a \kappa E d / (1 - \nu^2)`; kappa is 1 for a half-space (Hayes, Keer, Herrmann
    and Mockros, J. Biomech. 5 (1972) 541). Found here from the integral equation itself,
    :math:`\varphi(\xi) - \tfrac1\pi \int_{-1}^{1} M(\xi-\eta)\,\varphi(\eta)\,d\eta = 1`,
    :math:`M(\xi) = \tfrac{a}{h}\int_0^\infty (1-L(u)) \cos(u \xi a/h)\,du`, :math:`\kappa =
    \int_0^1 \varphi`, with L the layer's compliance relative to a half-space.

    Parameters
    ----------
    aspect_ratio : float
        Probe radius over thickness a/h [1], positive; meant for up to about 4.
    poisson_ratio : float
        Poisson's ratio nu [1], 0 to 0.5.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    unit_wave, unit_weights = np.polynomial.legendre.leggauss(400)
    wave, wave_weights = 15.0 * (unit_wave + 1.0), 15.0 * unit_weights
    kolosov = 3.0 - 4.0 * poisson_ratio
    # Divided by e^(2u) throughout, so that nothing overflows.
    decay, decay2 = np.exp(-2.0 * wave), np.exp(-4.0 * wave)
    compliance = (kolosov * (1.0 - decay2) - 4.0 * wave * decay) / (
        kolosov * (1.0 + decay2) + (4.0 * wave**2 + 1.0 + kolosov**2) * decay
    )
    distance = np.abs(nodes[:, None] - nodes[None, :])
    kernel = np.cos(aspect_ratio * distance[:, :, None] * wave) @ (
        (1.0 - compliance) * wave_weights
    )
    system = np.eye(nodes.size) - aspect_ratio / math.pi * kernel * weights
    return float(0.5 * weights @ np.linalg.solve(system, np.ones(nodes.size)))
