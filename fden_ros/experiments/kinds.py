# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The table of experiments: the files of each, their results, and the place of their fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.experiments.result import Fit


@dataclass(frozen=True)
class Options:
    """Values that a file does not state itself."""

    stress: float | None = None  #: constant stress of a creep test [Pa]
    strain: float | None = None  #: constant strain of a relaxation test [1]
    #: Rows before this time [s] are left out; None: 1 s for creep, otherwise nothing.
    start: float | None = None
    alpha: float | None = None  #: fractional order from elsewhere
    alpha_sd: float = 0.0  #: and its deviation


class Experiment(NamedTuple):
    """One kind of experiment."""

    files: tuple[tuple[str, str], ...]  #: columns of each kind of file, and their results
    options: tuple[str, ...] = ()  #: those of ``fden fit`` that count


_ALL = "alpha, G, Gn, Gi, xb"

EXPERIMENTS = {
    "dynamic": Experiment((("omega_rad_s, storage_modulus_pa, loss_modulus_pa", "alpha, G"),)),
    "creep": Experiment((("time_s, strain [, stress_pa]", "alpha, xc, G"),), ("stress", "from")),
    "relaxation": Experiment(
        (
            ("time_s, stress_pa [, strain]", "alpha, fc, G"),
            ("or time_s, relaxation_modulus_pa", "alpha, fc, G"),
            ("or a folder of files at several strains", _ALL),
        ),
        ("strain", "from"),
    ),
    "nonlinearity": Experiment(
        (
            ("stress_pa, strain_coefficient", "G, Gn, Gi, xb"),
            ("or a folder of creep files with stress_pa", _ALL),
        ),
        ("from", "alpha", "alpha-sd"),
    ),
}


def fit_file(kind: str, path: str | Path, options: Options) -> Fit:
    """Fit the experiment `kind` to a table, or to a folder of them, or raise `InputError`."""
    from fden_ros.experiments import dynamic, nonlinearity, steps
    from fden_ros.experiments.result import undetermined

    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; give a CSV file")
    try:
        if kind == "dynamic":
            fit = dynamic.from_file(path)
        elif kind == "nonlinearity" and not path.is_dir():
            fit = nonlinearity.from_file(path, options)
        else:
            fit = steps.fit_of("creep" if kind == "nonlinearity" else kind, path, options)
    except InputError as error:
        # The fit itself does not know the file.
        named = str(path) in str(error)
        raise error if named else InputError(f"{path}: {error}") from None
    return replace(fit, warnings=(*fit.warnings, *undetermined(fit.parameters)))
