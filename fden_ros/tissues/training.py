# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Tissue libraries from tables of contacts: mean, covariance and count by class.

The estimates of a class scatter by its spread and by their own errors, so the mean of the stated
covariances is subtracted from the sample covariance of (ln G, ln Gn, alpha). The rest is shrunk to
a default spread worth :math:`k = 4` contacts, and the error of the mean is added. So the library
holds Student's t for a new contact, with :math:`n - 1 + k` degrees of freedom.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from fden_ros.core.arrays import Array
from fden_ros.core.classification import UNKNOWN, Tissue, TissueLibrary
from fden_ros.errors import InputError
from fden_ros.tissues.library import FORMAT

#: The default spread is worth this many contacts: a class of three has one.
SHRINKAGE = 4.0
#: Spread without data: of the paper's liver, alpha wider.
_DEFAULT_SD = np.array([0.28, 0.19, 0.02])
#: Of alpha where the contacts do not determine it, as wide as soft tissue is.
_ANY_ALPHA_SD = 0.12
#: Spread of the unknown about the classes: as wide as soft tissue is, a factor of 4 in G.
_UNKNOWN_SPREAD = np.diag(np.square([1.4, 0.6, _ANY_ALPHA_SD]))
_UNKNOWN_PRIOR = 0.1

_NAMES = ("g", "g_n", "alpha")
_CORRELATIONS = {
    (0, 1): "g_g_n_correlation",
    (0, 2): "g_alpha_correlation",
    (1, 2): "g_n_alpha_correlation",
}


class Contacts(NamedTuple):
    """Estimates of one class.

    Parameters
    ----------
    mean : Array
        (ln G, ln Gn, alpha) of each, (n, 3).
    covariance : Array
        As stated of each, (n, 3, 3).
    is_order_learned : bool
        Whether alpha was learned in each of them.
    """

    mean: Array
    covariance: Array
    is_order_learned: bool = True


def read_contacts(path: str | Path) -> Contacts:
    """Return the converged contacts in a table of ``fden batch``.

    Raises
    ------
    InputError
        If it is no such table, of several configurations, or no contact in it has converged.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        used = [row for row in rows if row["converged"] == "True"]
        of_other = len({row["configuration"] for row in rows}) > 1
        values = [[float(row[name]) for name in _NAMES] for row in used]
        means = [[math.log(g), math.log(g_n), alpha] for g, g_n, alpha in values]
        covariances = [_covariance(row) for row in used]
        is_learned = all(row["alpha_source"] == "learned" for row in used)
    except (OSError, UnicodeDecodeError, csv.Error, KeyError, ValueError):
        raise InputError(f"{path} is not a table of fden batch (CSV)") from None
    if of_other:
        raise InputError(f"{path} has rows of several configurations: run fden batch again")
    if not used:
        raise InputError(
            f"{path}: none of its {len(rows)} contacts has converged; fden replay says what they "
            "lack"
        )
    return Contacts(np.array(means), np.array(covariances), is_learned)


def _covariance(row: Mapping[str, str]) -> Array:
    sds = np.array([float(row[f"{name}_sd"]) for name in _NAMES])
    sds[:2] /= [float(row["g"]), float(row["g_n"])]
    correlation = np.eye(3)
    for (i, j), name in _CORRELATIONS.items():
        correlation[i, j] = correlation[j, i] = float(row[name])
    return np.asarray(correlation * np.outer(sds, sds))


def learn(name: str, contacts: Contacts, prior: float = 1.0) -> Tissue:
    """Return the prediction for a new contact with a class, from its contacts."""
    count, mean = len(contacts.mean), contacts.mean.mean(axis=0)
    error = contacts.covariance.mean(axis=0)
    about = (contacts.mean - mean) / _DEFAULT_SD
    scale = np.outer(_DEFAULT_SD, _DEFAULT_SD)
    # In units of the default spread, where the rest after the errors may not be negative.
    sizes, axes = np.linalg.eigh(about.T @ about - (count - 1) * error / scale)
    scatter = axes * np.maximum(sizes, 0.0) @ axes.T
    freedom = count - 1 + SHRINKAGE
    spread = scale * (scatter + SHRINKAGE * np.eye(3)) / freedom
    spread += (spread + error) / count
    if not contacts.is_order_learned:
        spread[2] = spread[:, 2] = 0.0
        spread[2, 2] = _ANY_ALPHA_SD**2
    return Tissue(name, mean, 0.5 * (spread + spread.T), prior, freedom)


def library_of(
    classes: Mapping[str, Contacts], name: str = "learned", units: str = "Pa", geometry: str = ""
) -> TissueLibrary:
    """Return the library of classes of equal probability, and the unknown about them.

    Parameters
    ----------
    classes : mapping
        Contacts by the name of their class.
    name, units, geometry
        As in :class:`~fden_ros.core.classification.classifier.TissueLibrary`.
    """
    prior = (1.0 - _UNKNOWN_PRIOR) / len(classes)
    tissues = tuple(learn(tissue, contacts, prior) for tissue, contacts in classes.items())
    means = np.array([tissue.mean for tissue in tissues])
    about = means - means.mean(axis=0)
    wide = _UNKNOWN_SPREAD + about.T @ about / len(means)
    unknown = Tissue(UNKNOWN, means.mean(axis=0), wide, _UNKNOWN_PRIOR)
    return TissueLibrary(name, tissues, unknown, units, geometry)


_HEAD = """\
# Tissue library, learned by `fden train`: (ln G, ln Gn, alpha) of a new contact, G in {} s^alpha.
# `prior` may be changed: the probability of meeting a tissue, up to a common factor.
"""


def library_text(library: TissueLibrary, geometry: Mapping[str, Any]) -> str:
    """Return a library as YAML, with the geometry that its contacts were identified with."""
    unknown = {key: value for key, value in _entry(library.unknown).items() if key != "name"}
    content: dict[str, Any] = {"format": FORMAT, "name": library.name, "units": library.units}
    content |= {"geometry": dict(geometry)} if geometry else {}
    content |= {"tissues": [_entry(tissue) for tissue in library.tissues], "unknown": unknown}
    return _HEAD.format(library.units) + yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, width=96, allow_unicode=True
    )


def _entry(tissue: Tissue) -> dict[str, Any]:
    distribution: dict[str, Any] = {
        "mean": tissue.mean.tolist(),
        "covariance": tissue.covariance.tolist(),
    }
    if math.isfinite(tissue.degrees_of_freedom):
        distribution["degrees_of_freedom"] = tissue.degrees_of_freedom
    return {"name": tissue.name, "prior": round(tissue.prior, 6), "distribution": distribution}
