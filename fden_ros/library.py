"""Tissue libraries: YAML files in, :class:`~fden_ros.core.classifier.TissueLibrary` out."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

import numpy as np
import yaml

from fden_ros.core.classifier import UNKNOWN, Tissue, TissueLibrary
from fden_ros.errors import InputError

FORMAT = 1


def load_library(path: str | Path | None = None) -> TissueLibrary:
    """Read a tissue library; without a path the built-in one, the paper's liver.

    Raises
    ------
    InputError
        If the file cannot be read, or something in it is missing or not allowed.
    """
    if path is None:
        source = resources.files("fden_ros") / "tissues.yaml"
        return _library(source.read_text(encoding="utf-8"), "built-in library")
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"{path}: cannot read the tissue library: {reason}") from error
    return _library(text, str(path))


def _library(text: str, where: str) -> TissueLibrary:
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"{where}: not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(
            f"{where}: not a tissue library of format {FORMAT} (first key `format: {FORMAT}`)"
        )
    entries = content.get("tissues")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{where}: `tissues` must be a list with at least one tissue")
    tissues = tuple(_tissue(entry, f"{where}: tissue {i + 1}") for i, entry in enumerate(entries))
    names = [tissue.name for tissue in tissues]
    if len(set(names)) != len(names) or UNKNOWN in names:
        raise InputError(f"{where}: tissue names must differ, and none may be `{UNKNOWN}`")
    unknown = _tissue(
        {"name": UNKNOWN, **_mapping(content, "unknown", where)}, f"{where}: unknown"
    )
    return TissueLibrary(str(content.get("name", where)), tissues, unknown)


def _tissue(entry: object, where: str) -> Tissue:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str) or not entry["name"]:
        raise InputError(f"{where}: needs a `name`")
    means, variances = np.empty(3), np.empty(3)
    for i, key in enumerate(("linear_stiffness", "nonlinear_stiffness")):
        mean, sd = _mean_and_sd(entry, key, where)
        # Moments of the log-normal distribution with this mean and standard deviation.
        variances[i] = math.log1p((sd / mean) ** 2)
        means[i] = math.log(mean) - 0.5 * variances[i]
    means[2], sd = _mean_and_sd(entry, "fractional_order", where)
    variances[2] = sd**2
    prior = _positive(entry.get("prior", 1.0), f"{where}: `prior`")
    return Tissue(entry["name"], means, np.diag(variances), prior)


def _mean_and_sd(entry: dict[str, object], key: str, where: str) -> tuple[float, float]:
    moments = _mapping(entry, key, where)
    return (
        _positive(moments.get("mean"), f"{where}: `{key}: mean`"),
        _positive(moments.get("sd"), f"{where}: `{key}: sd`"),
    )


def _mapping(entry: dict[str, object], key: str, where: str) -> dict[str, object]:
    value = entry.get(key)
    if not isinstance(value, dict):
        raise InputError(f"{where}: needs `{key}` with `mean` and `sd`")
    return value


def _positive(value: object, where: str) -> float:
    usable = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not usable or not math.isfinite(value) or value <= 0.0:  # type: ignore[arg-type,operator]
        raise InputError(f"{where} is {value!r}, must be a positive number")
    return float(value)  # type: ignore[arg-type]
