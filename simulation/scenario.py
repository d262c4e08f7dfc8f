# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Scenarios: tissue, presses and sensors; from YAML to frozen dataclasses.

The files in ``bags/`` show the format. Every key is a field of one of the dataclasses below, in SI
units; a key that is missing takes the field's default. A number may be 0 where its default is,
and negative only if it is an error or a place.
"""

from __future__ import annotations

import difflib
import functools
import math
import os
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import yaml

from fden_ros.errors import InputError
from fden_ros.parameters import parse_yaml
from fden_ros.shipped import all_shipped, shipped
from fden_ros.simulation import FdenModel, FloatArray
from simulation.contact import Stiffening
from simulation.disturbance import Disturbances
from simulation.elastic_layer import stiffening
from simulation.trajectory import TRAJECTORIES, Approach, Ramp, RampHold, Sinusoid, Trajectory

Press = Trajectory
Axis = tuple[float, float, float]


@dataclass(frozen=True)
class Distribution:
    """A truncated distribution of one tissue parameter, from the paper's Table II."""

    mean: float
    standard_deviation: float
    low: float
    high: float
    logarithmic: bool

    def draw(self, generator: np.random.Generator) -> float:
        """Return one value: normal, or log-normal of these two moments, within the range."""
        mean, spread = self.mean, self.standard_deviation
        if self.logarithmic:
            spread = math.sqrt(math.log1p((spread / mean) ** 2))
            mean = math.log(mean) - 0.5 * spread**2
        while True:
            value = float(generator.normal(mean, spread))
            value = math.exp(value) if self.logarithmic else value
            if self.low <= value <= self.high:
                return value


# Paper, Table II: G and Gn of the nonlinearity measurement (64 samples), alpha of the dynamic test
# (11 samples).
_LIVER = {
    "linear_stiffness": Distribution(544.8, 155.3, 341.8, 1294.0, logarithmic=True),
    "nonlinear_stiffness": Distribution(8.547, 1.604, 5.26, 13.18, logarithmic=True),
    "fractional_order": Distribution(0.131, 0.011, 0.118, 0.146, logarithmic=False),
}


@dataclass(frozen=True)
class Tissue:
    """The tissue of one site: parameters, or a random draw that single parameters override."""

    linear_stiffness: float | None = None  #: G in Pa·s^alpha
    nonlinear_stiffness: float | None = None  #: Gn
    fractional_order: float | None = None  #: alpha
    #: Name of the tissue whose distribution gives the other parameters: ``liver`` (Table II)
    draw: Literal["liver"] | None = None

    def __post_init__(self) -> None:
        missing = [name for name in _LIVER if getattr(self, name) is None]
        if self.draw is None and missing:
            raise InputError(f"tissue: {missing[0]} is missing; give it, or `draw: liver`")

    def model(self, generator: np.random.Generator) -> FdenModel:
        """Return the parameters, drawing those that are not given."""
        # All are drawn, used or not: giving one must not change the others.
        drawn = {name: distribution.draw(generator) for name, distribution in _LIVER.items()}
        given = {name: getattr(self, name) for name in drawn if getattr(self, name) is not None}
        return FdenModel(**(drawn | given))


#: What may be given of a geometry, by its kind.
_DIMENSIONS = {
    "flat_punch": (["area_m2", "thickness_m"], ["radius_m", "thickness_m"]),
    "sphere": (["radius_m"], ["radius_m", "thickness_m"]),
}


@dataclass(frozen=True)
class Geometry:
    """How force and displacement follow from stress and strain."""

    #: ``flat_punch``: force = stress · area, depth = strain · thickness. ``sphere``: force =
    #: stress · 4 R²/3, depth = R · strain^(2/3), which is Hertz' law where the tissue is
    #: linear; with a thickness it presses an incompressible layer,
    #: :mod:`simulation.elastic_layer`
    kind: Literal["flat_punch", "sphere"] = "flat_punch"
    #: Face of the punch, one of the two; radius of the sphere
    area_m2: float | None = None
    radius_m: float | None = None
    #: Thickness of the tissue under a flat punch, or a sphere; None: a half-space
    thickness_m: float | None = None
    bonded: bool = True  #: The base holds the layer under a sphere; otherwise it slips

    def __post_init__(self) -> None:
        every = ("area_m2", "radius_m", "thickness_m")
        given, allowed = [n for n in every if getattr(self, n) is not None], _DIMENSIONS[self.kind]
        if given not in allowed:
            right = " or ".join(" and ".join(names) for names in allowed)
            raise InputError(f"geometry: {self.kind} needs {right}, not {_listed(given)}")

    @property
    def force_per_stress(self) -> float:
        """Force over stress in m²."""
        if self.kind == "sphere":
            return 4.0 / 3.0 * (self.radius_m or 0.0) ** 2
        return math.pi * (self.radius_m or 0.0) ** 2 if self.area_m2 is None else self.area_m2

    @property
    def length_m(self) -> float:
        """Height above the surface that counts as strain -1, in m."""
        return (self.thickness_m if self.kind == "flat_punch" else self.radius_m) or 1.0

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the identifier for this geometry."""
        if self.kind == "flat_punch":
            own = {"geometry.area": self.force_per_stress, "geometry.thickness": self.length_m}
        else:
            own = {
                "geometry.radius": self.length_m,
                "geometry.thickness": self.thickness_m or 0.0,
                "geometry.bonded": self.bonded,
            }
        return {"geometry.kind": self.kind, **own}

    @functools.cached_property
    def _layer(self) -> tuple[FloatArray, FloatArray]:
        """Depths into the layer, and into a half-space of the same force, in radii."""
        layer = stiffening(0.5, is_bonded=self.bonded)
        ratio = self.length_m / (self.thickness_m or math.inf)
        places = np.linspace(0.0, layer.x[-1], 20_000)
        depths = (places / ratio) ** 2
        return depths, depths * np.cbrt(layer(places)) ** 2

    def depth_of_strain(self, strain: FloatArray) -> FloatArray:
        """Return the displacement into the tissue in m; negative above the undisturbed surface."""
        if self.kind != "sphere":
            return strain * self.length_m
        hertz = np.cbrt(np.maximum(strain, 0.0)) ** 2
        if self.thickness_m is not None:
            depths, same = self._layer
            hertz = np.interp(hertz, same, depths)
        return self.length_m * np.where(strain > 0.0, hertz, strain)

    def strain_of_depth(self, depth: float) -> float:
        """Return the strain at a displacement into the tissue in m, the inverse of the above."""
        relative = depth / self.length_m
        if self.thickness_m is not None and self.kind == "sphere" and relative > 0.0:
            relative = float(np.interp(relative, *self._layer))
        return math.sqrt(relative**3) if self.kind == "sphere" and relative > 0.0 else relative


@dataclass(frozen=True)
class Preload:
    """The recording begins in contact: the probe has rested on the first site already."""

    #: Where it rests; 0: it begins in the air. It goes no higher between the first site's
    #: presses, and leaves the tissue after the last of them
    depth_m: float = 0.0
    time_s: float = 10.0  #: How long it has rested there when the recording begins


@dataclass(frozen=True)
class ForceSensor:
    """The force stream."""

    rate_hz: float = 1000.0  #: Sampling rate
    #: Standard deviation of white noise per sample, as a stress or as a force: one of the two,
    #: or none
    noise_stress_pa: float | None = None
    noise_n: float | None = None
    #: Standard deviation of the sampling times around an even clock, cut off at 0.45 periods.
    #: The stamps are true
    jitter_s: float = 0.0
    #: Constant and growing error of the force
    bias_n: float = 0.0
    drift_n_per_s: float = 0.0
    #: Where it is published, as a wrench: force along `axis`, which pressing makes positive
    topic: str = "/force"
    axis: Axis = (0.0, 0.0, 1.0)
    frame_id: str = "force_sensor"

    def __post_init__(self) -> None:
        if self.noise_n is not None and self.noise_stress_pa is not None:
            raise InputError("force: noise_n and noise_stress_pa are both given; give one of them")


@dataclass(frozen=True)
class DisplacementSensor:
    """The tip of the probe."""

    #: As for the force
    rate_hz: float = 1000.0
    noise_m: float = 0.0  #: Standard deviation of white noise per sample and coordinate
    jitter_s: float = 0.0
    delay_s: float = 0.0  #: Delay of the samples' stamps behind the truth
    #: Where and as what it is published: ``joint_state`` (position), ``pose`` or ``point``
    #: (`axis` points into the tissue)
    topic: str = "/displacement"
    message: Literal["joint_state", "pose", "point"] = "joint_state"
    axis: Axis = (0.0, 0.0, 1.0)
    frame_id: str = "tissue"
    surface_m: float = 0.0  #: Reading at the undisturbed surface


@dataclass(frozen=True)
class Dropout:
    """A stretch of time in which a stream has no samples."""

    stream: Literal["force", "displacement", "both"]
    #: On the stamps, from the beginning of the recording
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class Slide:
    """A path sideways in contact, during the sine of a press; the recording ends with it."""

    #: Where it ends, across the approach axis; it begins at the site's position
    to_m: tuple[float, float]
    #: How many times stiffer the tissue is over the middle of the path; each place is taken to
    #: have the same past
    ratio: float = 2.0
    edge_m: float = 0.002  #: Length over which the stiffness passes from one to the other

    def stiffness_ratio(self, gone: FloatArray, start_m: tuple[float, float]) -> FloatArray:
        """Return the stiffness ratio at this part of the path from `start_m`."""
        edge = self.edge_m / max(math.dist(start_m, self.to_m), self.edge_m)
        inner = np.clip((1.0 / 6.0 - np.abs(gone - 0.5)) / edge + 0.5, 0.0, 1.0)
        ratio: FloatArray = 1.0 + (self.ratio - 1.0) * inner
        return ratio


@dataclass(frozen=True)
class Site:
    """One place on the tissue and its presses."""

    tissue: Tissue  #: Its parameters
    presses: tuple[Press, ...]  #: One or more presses, one after the other; the tissue remembers
    position_m: tuple[float, float] = (0.0, 0.0)  #: Where it lies, across the approach axis
    #: A stiffer tissue that the probe meets below the surface, if any; for a single press
    stiffening: Stiffening | None = None
    #: The path sideways in contact, if any; for a single sinusoid at the last site
    slide: Slide | None = None

    def __post_init__(self) -> None:
        if not self.presses:
            raise InputError("site: presses is empty; name at least one press")
        single = len(self.presses) == 1 and isinstance(self.presses[0], Ramp | RampHold)
        if self.stiffening is not None and not single:
            raise InputError("site: with a stiffening, presses must be one ramp or ramp_hold")
        if self.slide is not None and [type(press) for press in self.presses] != [Sinusoid]:
            raise InputError("site: with a slide, presses must be one sinusoid")


@dataclass(frozen=True)
class Scenario:
    """A whole recording: see the fields' own classes."""

    geometry: Geometry
    sites: tuple[Site, ...]
    name: str = "scenario"
    description: str = ""
    seed: int = 0
    approach: Approach = field(default_factory=Approach)
    force: ForceSensor = field(default_factory=ForceSensor)
    displacement: DisplacementSensor = field(default_factory=DisplacementSensor)
    dropouts: tuple[Dropout, ...] = ()
    disturbances: Disturbances = field(default_factory=Disturbances)
    preload: Preload = field(default_factory=Preload)

    def __post_init__(self) -> None:
        if not self.sites:
            raise InputError("scenario: sites is empty; name at least one site")
        if any(site.slide for site in self.sites[:-1]):
            raise InputError("scenario: a slide is in contact to the end; the last site has it")
        if self.disturbances.moves_tissue and any(site.stiffening for site in self.sites):
            raise InputError(
                "scenario: a stiffening does not go with surface motion, compliance, backlash or "
                "plastic set; leave one of them out"
            )

    @property
    def force_noise_n(self) -> float:
        """Standard deviation of the force noise in N."""
        if self.force.noise_stress_pa is not None:
            return self.force.noise_stress_pa * self.geometry.force_per_stress
        return self.force.noise_n or 0.0


def ramp_scenario(
    *,
    strain_rate: float = 0.1,
    max_strain: float = 0.3,
    hold_s: float = 0.0,
    tissue: Tissue | None = None,
    sites: int = 1,
    rate_hz: float = 1000.0,
    noise_stress_pa: float = 3.0,
    seed: int = 0,
) -> Scenario:
    """Return ramps, or ramps and holds, of one site each; by default on liver of alpha 0.131."""
    press = RampHold(strain_rate, max_strain, hold_s) if hold_s else Ramp(strain_rate, max_strain)
    tissue = tissue or Tissue(draw="liver", fractional_order=0.131)
    return Scenario(
        name="ramp_hold" if hold_s else "ramp",
        seed=seed,
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=tuple(Site(tissue, (press,), (0.02 * index, 0.0)) for index in range(sites)),
        force=ForceSensor(rate_hz=rate_hz, noise_stress_pa=noise_stress_pa),
        displacement=DisplacementSensor(rate_hz=rate_hz),
    )


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario by its name (see :func:`scenario_names`), or the path of a YAML file."""
    path, text = Path(name_or_path), str(name_or_path)
    if not path.is_file():
        if path.suffix in (".yaml", ".yml") or os.sep in text:
            words = "no such file; give the path of a scenario or a name from `fden bag --list`"
            raise InputError(f"{text}: {words}")
        _require("scenario", text, scenario_names())
        path = shipped(f"bags/{text}.yaml")
    try:
        data = parse_yaml(path.read_text(encoding="utf-8"))
        return scenario_of_mapping({"name": path.stem} | _mapping(data, "scenario"))
    except (OSError, InputError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None


def scenario_of_mapping(data: Mapping[str, Any]) -> Scenario:
    """Return the scenario that a mapping (as read from YAML) describes."""
    return _build(Scenario, data, "scenario")


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the package, sorted."""
    return sorted({path.stem for bags in all_shipped("bags") for path in bags.glob("*.yaml")})


def _require(what: str, value: object, choices: Iterable[str]) -> None:
    """Raise InputError unless `value` is one of `choices`."""
    if value not in (options := sorted(choices)):
        near = difflib.get_close_matches(str(value), options, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {_listed(options)}"
        raise InputError(f"{what} {value!r} is unknown; {hint}")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "nothing"


#: Numbers that may be negative.
_SIGNED = ("bias_n", "drift_n_per_s", "surface_m", "delay_s", "creep_n", "thermal_n")

T = TypeVar("T")


def _build(cls: type[T], data: object, where: str) -> T:
    """Make a dataclass of a mapping, refusing unknown keys and naming missing ones."""
    mapping = _mapping(data, where)
    hints = typing.get_type_hints(cls)
    known = {item.name: item for item in fields(cls)}  # type: ignore[arg-type]
    for key in mapping:
        _require(f"{where}: key", key, known)
    for name, item in known.items():
        if name not in mapping and item.default is MISSING and item.default_factory is MISSING:
            raise InputError(f"{where}: {name} is missing")
    values = {
        key: _convert(value, hints[key], f"{where}: {key}") for key, value in mapping.items()
    }
    for name, value in values.items():
        if type(value) in (int, float) and name not in _SIGNED:
            may_be_zero = known[name].default == 0
            if value < 0 or (value == 0 and not may_be_zero):
                words = "0 or positive" if may_be_zero else "positive"
                raise InputError(f"{where}: {name} is {value}; it must be {words}")
    return cls(**values)


def _mapping(data: object, where: str) -> dict[str, Any]:
    if not isinstance(data, Mapping) or not all(isinstance(key, str) for key in data):
        raise InputError(f"{where}: must be a mapping of keys to values, not {data!r}")
    return dict(data)


_WORDS = {bool: "true or false", int: "a whole number", float: "a finite number", str: "text"}


def _convert(value: Any, hint: Any, where: str) -> Any:
    """Return `value` as the type that a field asks for."""
    if hint is Trajectory:
        return _press(value, where)
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        (hint,) = (option for option in typing.get_args(hint) if option is not type(None))
    if typing.get_origin(hint) is tuple:
        return _convert_list(value, typing.get_args(hint), where)
    if typing.get_origin(hint) is Literal:
        _require(where, value, typing.get_args(hint))
        return value
    if hint not in _WORDS:
        return _build(hint, value, where.rpartition(": ")[2])
    # A bool is an int, too, but not meant as one.
    kinds = (float, int) if hint is float else (hint,)
    if type(value) not in kinds or (hint is float and not math.isfinite(value)):
        raise InputError(f"{where} is {value!r}; it must be {_WORDS[hint]}")
    return hint(value)


def _convert_list(value: object, hints: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    if hints[-1] is Ellipsis and isinstance(value, list):
        hints = hints[:1] * len(value)
    if not isinstance(value, list) or len(value) != len(hints):
        raise InputError(f"{where} is {value!r}; it must be a list of {len(hints)}")
    names = [f"{where} {index}" for index in range(1, len(hints) + 1)]
    values = tuple(map(_convert, value, hints, names))
    if hints == typing.get_args(Axis) and abs(math.hypot(*values) - 1.0) > 1e-6:
        raise InputError(f"{where} is {value}; it must be a unit vector such as [0, 0, -1]")
    return values


def _press(value: object, where: str) -> Press:
    mapping = _mapping(value, where)
    kind = mapping.pop("kind", None)
    _require(f"{where}: kind", kind, TRAJECTORIES)
    return _build(TRAJECTORIES[kind], mapping, f"{where}: {kind}")
