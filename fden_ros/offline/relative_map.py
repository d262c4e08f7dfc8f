# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Sites of a table of results, each against those around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.classification.classifier import Likelihood
from fden_ros.core.classification.relative import (
    RelativeConfig,
    compare,
    neighbours,
    without_prior,
)
from fden_ros.core.law.apparent_stiffness import LogStiffness, log_stiffness
from fden_ros.errors import InputError
from fden_ros.offline.labelled import Columns, Source, read_rows, read_source
from fden_ros.parameters import Parameters

#: Rows need a label to be read as contacts: any.
_ANY = "site"


def compare_sites(
    path: Path, parameters: Parameters, config: RelativeConfig
) -> list[dict[str, Any]]:
    """Return a row a site: place, ratio with its interval, probability, deviations and label.

    Parameters
    ----------
    path : Path
        CSV or Parquet, as `fden batch` and `fden report --csv` write.
    parameters : mapping
        Checked parameter values: the prior in them is taken out.
    config : RelativeConfig

    Raises
    ------
    InputError
        If the table cannot be read, or `config.distance` needs positions that it lacks.
    """
    rows, names = read_rows(path)
    if "site" not in names:
        raise InputError(f"{path}: column site is missing; a row a contact, with its site")
    contacts = read_source(Source(path, _ANY), parameters, columns=Columns("", "site"))
    # What was not converged has been left out: the row is told by its name.
    where = [rows[int(name.rsplit(" ", 1)[1]) - 1] for name in contacts.names]
    last = {(str(row.get("bag", "")), str(row["site"])): i for i, row in enumerate(where)}
    chosen = list(last.values())
    if not chosen:
        raise InputError(f"{path}: no site with a converged estimate")
    places = [_position(where[i]) for i in chosen]
    if config.distance > 0.0 and any(place is None for place in places):
        raise InputError(f"{path}: --distance needs the columns x, y and z of every site")
    positions = np.array([place or (0.0, 0.0, 0.0) for place in places])
    values = [_stiffness(contacts.likelihood, i, config) for i in chosen]
    value = np.array([float(one.value) for one in values])
    variance = np.array([float(one.variance) for one in values])
    result = []
    for index, (one, place, i) in enumerate(zip(values, places, chosen, strict=True)):
        near = neighbours(positions, index, config.distance)
        near = near[np.isfinite(value[near])]
        compared = (
            compare(one, LogStiffness(value[near], variance[near]))
            if math.isfinite(value[index])
            else None
        )
        x, y, z = place or (None, None, None)
        row = {"site": where[i]["site"], "x": x, "y": y, "z": z}
        row |= dict.fromkeys(("ratio", "ratio_low", "ratio_high", "probability", "deviations"))
        row["label"] = ""
        if compared is not None:
            low, high = compared.interval()
            row |= {
                "ratio": compared.ratio,
                "ratio_low": low,
                "ratio_high": high,
                "probability": compared.probability_stiffer(config.ratio),
                "deviations": compared.deviations,
                "label": compared.classes(config.ratio).label,
            }
        result.append(row)
    return result


def _stiffness(likelihood: Likelihood, index: int, config: RelativeConfig) -> LogStiffness:
    own = without_prior(
        Likelihood(
            likelihood.centre[index], likelihood.score[index], likelihood.information[index]
        )
    )
    if own is None:
        # alpha was given, or not seen: the time scale is that of the contact itself.
        information = likelihood.information[index][:2, :2]
        if float(np.linalg.eigvalsh(information)[0]) <= 0.0:
            return LogStiffness(np.array(math.nan), np.array(math.nan))
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = np.linalg.inv(information)
        centre = likelihood.centre[index]
        own = centre + covariance @ likelihood.score[index], covariance
    return log_stiffness(*own, config.strain, config.time_scale)


def _position(row: Mapping[str, Any]) -> tuple[float, float, float] | None:
    try:
        x, y, z = (float(row[name]) for name in "xyz")
    except (KeyError, TypeError, ValueError):
        return None
    return x, y, z
