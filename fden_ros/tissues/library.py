# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tissue libraries, read from and written to YAML files.

``docs/classification.md`` describes the format. Version 2 added units, geometry and learned
distributions; files of version 1 are in pascals.
"""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

import numpy as np
import yaml

from fden_ros.core.classification import UNKNOWN, Tissue, TissueLibrary
from fden_ros.core.law import FlatPunch, Geometry
from fden_ros.errors import InputError

FORMAT = 2
#: Units of the stress behind G: of a stress, or of a force where the probe's area is not known.
UNITS = ("Pa", "N")
#: A flat punch of this area stands for one of unknown area [m^2].
_NO_AREA = 1.0


def load_library(path: str | Path | None = None) -> TissueLibrary:
    """Read a tissue library; without a path the built-in one, the paper's liver.

    Raises
    ------
    InputError
        If the file cannot be read, or something in it is missing or not allowed.
    """
    if path is None:
        source = resources.files("fden_ros.tissues") / "tissues.yaml"
        return parse_library(source.read_text(encoding="utf-8"), "built-in library")
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"{path}: cannot read the tissue library: {reason}") from error
    return parse_library(text, str(path))


def units_of(geometry: Geometry) -> str:
    """Return the unit of a geometry's stress.

    A flat punch of 1 m^2 stands for a probe of unknown area: stress is force, in N.
    """
    return "N" if isinstance(geometry, FlatPunch) and geometry.area == _NO_AREA else "Pa"


def library_for(path: str, geometry: Geometry) -> TissueLibrary | None:
    """Return the library at `path`, or the built-in one, if it fits the geometry.

    None where the built-in library does not: nothing is classified then.

    Raises
    ------
    InputError
        If the file cannot be read, or is in other units or of another geometry.
    """
    library = load_library(path or None)
    units, kind = units_of(geometry), geometry.kind
    if library.units != units:
        if not path:
            return None
        raise InputError(
            f"{path}: G is in {library.units} s^alpha, but the estimates are in {units} s^alpha"
            f"{' (geometry.area is 1)' if units == 'N' else ''}; use a library in {units}, or "
            f"{'state the area of the probe' if units == 'N' else 'set geometry.area to 1'}"
        )
    if library.geometry and library.geometry != kind:
        raise InputError(
            f"{path}: was made with geometry.kind {library.geometry}, but the estimates are made "
            f"with {kind}; train one with this probe, or set the same geometry"
        )
    return library


def parse_library(text: str, where: str) -> TissueLibrary:
    """Return the library in a text.

    Raises
    ------
    InputError
        In one line that begins with `where`.
    """
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"{where}: not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or content.get("format") not in range(1, FORMAT + 1):
        raise InputError(
            f"{where}: not a tissue library of format 1 or {FORMAT} (first key "
            f"`format: {FORMAT}`); a newer one needs a newer fden_ros"
        )
    entries = content.get("tissues")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{where}: `tissues` must be a list with at least one tissue")
    tissues = tuple(_tissue(entry, f"{where}: tissue {i + 1}") for i, entry in enumerate(entries))
    names = [tissue.name for tissue in tissues]
    if len(set(names)) != len(names) or UNKNOWN in names:
        raise InputError(f"{where}: tissue names must differ, and none may be `{UNKNOWN}`")
    unknown = _tissue(
        {"name": UNKNOWN, **_mapping(content, "unknown", where, "`mean` and `sd`")},
        f"{where}: unknown",
    )
    units = content.get("units", UNITS[0])
    if units not in UNITS:
        raise InputError(f"{where}: `units` is {units!r}, must be {' or '.join(UNITS)}")
    return TissueLibrary(
        str(content.get("name", where)), tissues, unknown, units, _geometry(content, where)
    )


def _geometry(content: dict[str, object], where: str) -> str:
    if "geometry" not in content:
        return ""
    return str(_mapping(content, "geometry", where, "`kind`").get("kind", ""))


def _tissue(entry: object, where: str) -> Tissue:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str) or not entry["name"]:
        raise InputError(f"{where}: needs a `name`")
    prior = _positive(entry.get("prior", 1.0), f"{where}: `prior`")
    if "distribution" in entry:
        return _learned(entry, prior, where)
    means, variances = np.empty(3), np.empty(3)
    for i, key in enumerate(("linear_stiffness", "nonlinear_stiffness")):
        mean, sd = _mean_and_sd(entry, key, where)
        # Moments of the log-normal distribution with this mean and standard deviation.
        variances[i] = math.log1p((sd / mean) ** 2)
        means[i] = math.log(mean) - 0.5 * variances[i]
    means[2], sd = _mean_and_sd(entry, "fractional_order", where)
    variances[2] = sd**2
    return Tissue(entry["name"], means, np.diag(variances), prior)


def _learned(entry: dict[str, object], prior: float, where: str) -> Tissue:
    own = _mapping(entry, "distribution", where, "`mean` and `covariance`")
    where = f"{where}: `distribution"
    mean = _numbers(own.get("mean"), (3,), f"{where}: mean`", "(ln G, ln Gn, alpha)")
    covariance = _numbers(
        own.get("covariance"), (3, 3), f"{where}: covariance`", "three rows of three"
    )
    symmetric = np.allclose(covariance, covariance.T, rtol=1e-6, atol=0.0)
    if not symmetric or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise InputError(f"{where}: covariance` must be symmetric and positive definite")
    degrees = math.inf
    if "degrees_of_freedom" in own:
        degrees = _positive(own["degrees_of_freedom"], f"{where}: degrees_of_freedom`")
    return Tissue(str(entry["name"]), mean, 0.5 * (covariance + covariance.T), prior, degrees)


def _numbers(
    value: object, shape: tuple[int, ...], where: str, words: str
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise InputError(f"{where} is {value!r}, must be {words}, all numbers")
    return array


def _mean_and_sd(entry: dict[str, object], key: str, where: str) -> tuple[float, float]:
    moments = _mapping(entry, key, where, "`mean` and `sd`")
    return (
        _positive(moments.get("mean"), f"{where}: `{key}: mean`"),
        _positive(moments.get("sd"), f"{where}: `{key}: sd`"),
    )


def _mapping(entry: dict[str, object], key: str, where: str, words: str) -> dict[str, object]:
    value = entry.get(key)
    if not isinstance(value, dict):
        raise InputError(f"{where}: needs `{key}` with {words}")
    return value


def _positive(value: object, where: str) -> float:
    usable = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not usable or not math.isfinite(value) or value <= 0.0:  # type: ignore[arg-type,operator]
        raise InputError(f"{where} is {value!r}, must be a positive number")
    return float(value)  # type: ignore[arg-type]
